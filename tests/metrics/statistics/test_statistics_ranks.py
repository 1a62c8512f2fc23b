"""Ranks that methods share unless they differ, with one error rate over all comparisons."""

from __future__ import annotations

import numpy as np
import pytest
from autoregression import autoregressive
from scipy.special import ndtri

from relocbench.arrays import Array
from relocbench.metrics import generator, rank_with_ties
from relocbench.metrics.statistics.ranks import different_methods


def drive(rng: np.random.Generator, n: int, rho: float, share: float = 0.5) -> Array:
    """0/1 successes of a drive whose good and bad stretches are correlated."""
    return (autoregressive(rng, n, rho) < ndtri(share)).astype(float)


@pytest.mark.parametrize(("n", "rho"), [(16, 0.9), (60, 0.0), (150, 0.5)])
def test_ten_equal_methods_on_four_sets_share_a_rank(n: int, rho: float) -> None:
    different = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        values = {str(m): [drive(rng, n, rho) for _ in range(4)] for m in range(10)}
        different.append(len(set(rank_with_ties(values, rng).values())) > 1)
    assert np.mean(different) <= 0.07


def test_a_method_that_is_better_by_ten_points_is_told_apart() -> None:
    apart = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        values = {str(m): [drive(rng, 1000, 0.5, 0.6 if m == 0 else 0.5) for _ in range(4)] for m in range(10)}
        ranks = rank_with_ties(values, rng)
        apart.append(ranks["0"] == 1 and all(ranks[str(m)] == 2 for m in range(1, 10)))
    assert np.mean(apart) >= 0.8


def test_ranks_count_the_methods_that_are_better() -> None:
    rng = np.random.default_rng(8)
    hard = rng.random(800)
    values = {
        "worst": [(hard < 0.2).astype(float)],
        "b": [((hard < 0.6) ^ (rng.random(800) < 0.05)).astype(float)],
        "a": [((hard < 0.6) ^ (rng.random(800) < 0.05)).astype(float)],
        "best": [(hard < 0.9).astype(float)],
    }
    assert rank_with_ties(values, np.random.default_rng(0)) == {"worst": 4, "b": 2, "a": 2, "best": 1}
    backwards = rank_with_ties(values, np.random.default_rng(0), higher_is_better=False)
    assert backwards == {"worst": 1, "b": 2, "a": 2, "best": 4}


def test_nobody_stands_behind_a_method_with_a_lower_mean() -> None:
    for seed in range(30):
        rng = np.random.default_rng(seed)
        hard = rng.random(200)
        values = {str(m): [((hard < 0.5 + m / 30) ^ (rng.random(200) < m / 40)).astype(float)] for m in range(9)}
        ranks = rank_with_ties(values, rng)
        order = sorted(values, key=lambda name: -float(np.mean(values[name][0])))
        in_order = [ranks[name] for name in order]
        assert in_order[0] == 1
        assert in_order == sorted(in_order, key=lambda rank: rank or 0)


def test_ranks_do_not_depend_on_the_order_of_the_methods_and_follow_from_the_seed() -> None:
    rng = np.random.default_rng(9)
    values = {name: [drive(rng, 200, 0.3, 0.3 + 0.05 * i), drive(rng, 90, 0.3)] for i, name in enumerate("abcdef")}
    ranks = rank_with_ties(values, generator(0, "town", "recall"))
    assert ranks == rank_with_ties(dict(reversed(values.items())), generator(0, "town", "recall"))
    assert generator(0, "town", "recall").random() != generator(1, "town", "recall").random()


def test_copies_of_a_method_share_its_rank_and_differ_from_nothing() -> None:
    good = drive(np.random.default_rng(0), 500, 0.2, 0.9)
    bad = drive(np.random.default_rng(1), 500, 0.2, 0.3)
    ranks = rank_with_ties({"a": [good], "b": [good], "c": [bad]}, np.random.default_rng(0))
    assert ranks == {"a": 1, "b": 1, "c": 3}
    assert not different_methods([np.stack([good, good])], np.random.default_rng(0)).any()
    assert rank_with_ties({"alone": [good]}, np.random.default_rng(0)) == {"alone": 1}


def test_a_method_with_a_missing_set_has_no_rank_and_moves_nobody() -> None:
    rng = np.random.default_rng(0)
    good, bad = drive(rng, 200, 0.0, 0.95), drive(rng, 200, 0.0, 0.1)
    values: dict[str, list[Array | None]] = {
        "good": [good, good],
        "missing": [good, None],
        "bad": [bad, bad],
        "absent": [None, None],
    }
    ranks = rank_with_ties(values, np.random.default_rng(0))
    assert ranks == {"good": 1, "missing": None, "bad": 2, "absent": None}
    assert list(ranks) == list(values)
    assert rank_with_ties({"missing": [None]}, np.random.default_rng(0)) == {"missing": None}


def test_a_method_that_is_always_right_is_better_than_one_that_never_is_if_the_drive_is_worth_enough() -> None:
    values = {"always": [np.ones(300)], "never": [np.zeros(300)]}
    lone = autoregressive(np.random.default_rng(0), 300, 0.2)
    slow = autoregressive(np.random.default_rng(0), 300, 0.97)
    never = np.full(300, np.inf)
    for error, rank in ((lone, 2), (slow, 1)):
        ranks = rank_with_ties(values, np.random.default_rng(0), {"always": [error], "never": [never]})
        assert ranks == {"always": 1, "never": rank}
    # Without errors, a correlation of 0.95 is assumed, and 300 pairs are worth 8.
    assert rank_with_ties(values, np.random.default_rng(0)) == {"always": 1, "never": 1}
    longer = {name: [np.tile(v[0], 2)] for name, v in values.items()}
    assert rank_with_ties(longer, np.random.default_rng(0)) == {"always": 1, "never": 2}


def test_a_few_neighbouring_failures_are_one_event() -> None:
    """Fifteen failures in a row on 1000 pairs do not tell two methods apart, fifteen scattered ones do."""
    perfect, stretch, scattered = np.ones(1000), np.ones(1000), np.ones(1000)
    stretch[500:515] = 0
    scattered[30::65] = 0
    assert stretch.sum() == scattered.sum()
    ranks = rank_with_ties({"perfect": [perfect], "stretch": [stretch]}, np.random.default_rng(0))
    assert ranks == {"perfect": 1, "stretch": 1}
    ranks = rank_with_ties({"perfect": [perfect], "scattered": [scattered]}, np.random.default_rng(0))
    assert ranks == {"perfect": 1, "scattered": 2}


def test_few_pairs_say_nothing_and_other_pairs_are_refused() -> None:
    ranks = rank_with_ties({"a": [np.ones(9)], "b": [np.zeros(9)]}, np.random.default_rng(0), independent=True)
    assert ranks == {"a": 1, "b": 1}
    with pytest.raises(ValueError, match="pairs"):
        rank_with_ties({"a": [np.ones(10)], "b": [np.ones(11)]}, np.random.default_rng(0))
    with pytest.raises(ValueError, match="finite"):
        rank_with_ties({"a": [[np.nan]]}, np.random.default_rng(0))
