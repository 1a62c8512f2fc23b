"""Near-copies count once, and neither they nor methods that fail everywhere move the rank of another method."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from autoregression import autoregressive

from relocbench.arrays import Array
from relocbench.metrics import families_of, rank_with_ties, same_answers

Errors = dict[str, list[Array]]
"""(2, N) of each set, by method"""


def drawn(rng: np.random.Generator, methods: int, roads: int, sets: int = 4, pairs: int = 52) -> Errors:
    """Errors of methods from good to bad, of which the pairs of a set have a part in common."""
    out: Errors = {f"m{m}": [] for m in range(methods)}
    for _ in range(roads * sets):
        hard = autoregressive(rng, pairs, 0.5)
        for m, of in enumerate(out.values()):
            x = 0.8 * hard + 0.6 * rng.normal(size=pairs) + 0.25 * m
            of.append(np.exp(np.stack([x, x + 0.3 * rng.normal(size=pairs)])))
    return out


def right(errors: Errors) -> Errors:
    return {name: [(e[0] < 3).astype(float) for e in of] for name, of in errors.items()}


def ranks_of(errors: Errors, roads: int) -> dict[str, int | None]:
    of_sets = [road for road in range(roads) for _ in range(4)]
    return rank_with_ties(right(errors), np.random.default_rng(0), errors, roads=of_sets)


def without_one(e: Array, rng: np.random.Generator) -> Array:
    out = e.copy()
    out[:, rng.integers(e.shape[1])] = np.inf
    return out


def with_noise(e: Array, rng: np.random.Generator) -> Array:
    noisy: Array = e * np.exp(0.05 * rng.normal(size=e.shape))
    return noisy


@pytest.mark.thorough
@pytest.mark.parametrize("roads", [1, 12])
@pytest.mark.parametrize("change", [without_one, with_noise])
def test_no_rank_moves_by_copies_of_another_method(
    roads: int, change: Callable[[Array, np.random.Generator], Array]
) -> None:
    for seed in range(2):
        rng = np.random.default_rng(seed)
        errors = drawn(rng, 6, roads)
        before = ranks_of(errors, roads)
        for original in ("m0", "m3", "m5"):
            copies = {f"a-copy-{c}": [change(e, rng) for e in errors[original]] for c in range(5)}
            after = ranks_of({**errors, **copies}, roads)
            assert {name: after[name] for name in before} == before
            shares = {name: np.mean([x.mean() for x in of]) for name, of in right({**errors, **copies}).items()}
            in_order = sorted(shares, key=lambda name: (-shares[name], after[name] or 0))
            assert [after[name] for name in in_order] == sorted(after[name] or 0 for name in in_order)


@pytest.mark.parametrize("roads", [1, 12])
def test_no_rank_moves_by_methods_that_do_worse_whatever_they_are(roads: int) -> None:
    rng = np.random.default_rng(3)
    errors = drawn(rng, 5, roads)
    before = ranks_of(errors, roads)
    failing = {f"a{i}": [np.full_like(e, np.inf) for e in errors["m0"]] for i in range(5)}
    nearly = {
        f"b{i}": [np.where(np.arange(52) == rng.integers(52), 1.0, np.full_like(e, np.inf)) for e in errors["m0"]]
        for i in range(3)
    }
    after = ranks_of({**failing, **nearly, **errors}, roads)
    assert {name: after[name] for name in before} == before
    assert all((after[name] or 0) > max(rank or 0 for rank in before.values()) for name in failing) or roads == 1


def test_five_copies_without_one_pair_a_set_hide_nobody_over_twelve_roads() -> None:
    """Copies of one method that is better than another count for one, on the other's rank and in its comparisons."""
    rng = np.random.default_rng(0)
    errors: Errors = {"leader": [], "second": [], "behind": []}
    for road in range(12):
        lost = 0.02 + 0.12 * (road % 4 == 0) + 0.04 * (road % 3 == 0)  # behind on all roads, and unequally so
        for _ in range(6):
            own = np.exp(rng.normal(size=(3, 2, 52)) - 5)
            for name, e, share in zip(errors, own, (0.001, 0.01, 0.01 + lost), strict=True):
                errors[name].append(np.where(rng.random(52) < share, np.inf, e))
    of_sets = [road for road in range(12) for _ in range(6)]
    copies = {f"a{c}": [without_one(e, rng) for e in errors["second"]] for c in range(5)}
    for methods in (errors, {**errors, **copies}):
        values = {name: [np.isfinite(e[0]).astype(float) for e in of] for name, of in methods.items()}
        ranks = rank_with_ties(values, np.random.default_rng(0), methods, roads=of_sets)
        assert (ranks["leader"], ranks["behind"]) == (1, 3)


def test_equal_methods_that_fail_on_stretches_of_other_lengths_share_a_rank() -> None:
    """A method whose failures are all in a row may be right on a whole drive, and is then no better than others."""
    different = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        x = [autoregressive(rng, 200, 0.95 if m % 2 else 0.0) for m in range(6)]
        values = {str(m): [(of < 1.28).astype(float)] for m, of in enumerate(x)}
        ranks = rank_with_ties(values, rng, {str(m): [np.exp(of)[None]] for m, of in enumerate(x)})
        different += len(set(ranks.values())) > 1
    assert different <= 2


def of_share(share: float) -> list[Array]:
    return [(np.arange(400) < 400 * share).astype(float)]


def test_a_family_is_represented_by_what_came_first_unless_that_is_clearly_worse() -> None:
    values = {name: of_share(x) for name, x in {"old": 0.9, "better": 0.98, "copy": 0.9025, "other": 0.9}.items()}
    alike = {("better", "old"), ("copy", "old")}
    found = families_of(values, lambda a, b: (a, b) in alike)
    assert found == {"old": "old", "better": "better", "copy": "old", "other": "other"}


def test_a_later_method_between_two_others_joins_one_and_makes_no_family_of_both() -> None:
    near = {("between", "a"), ("between", "b")}
    values = {name: of_share(x) for name, x in {"a": 0.9, "b": 0.8, "between": 0.85}.items()}
    assert families_of(values, lambda x, y: (x, y) in near) == {"a": "a", "b": "b", "between": "a"}


def test_answers_are_the_same_on_half_of_the_pairs_that_either_answered() -> None:
    rng = np.random.default_rng(1)
    a, b = (np.exp(rng.normal(size=(2, 200))) for _ in range(2))
    assert not same_answers([a], [b])  # equally accurate, but not the same
    assert same_answers([a], [1.1 * a])
    mixed = np.where(np.arange(200) < 110, a, b)
    assert same_answers([a], [mixed])
    assert not same_answers([a], [np.where(np.arange(200) < 70, a, b)])
    failed = np.full((2, 200), np.inf)
    assert not same_answers([failed], [failed])  # nothing says that they would answer the same
    assert not same_answers([a], [None])
