"""Differences over places and seeds: intervals that cover, whichever of the two varies more."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from relocbench.arrays import Array
from relocbench.metrics import Difference, crossed_difference, paired_difference

SEEDS = 3


def drawn(rng: np.random.Generator, places: int, *spread: float, seeds: int = SEEDS) -> Array:
    """(S, P) differences: a place's part, a seed's and a residual, with these variances; the seed's is times P."""
    of_places, of_seeds, of_residuals = np.sqrt(spread)
    out: Array = of_places * rng.normal(size=(1, places))
    out = out + of_seeds / math.sqrt(places) * rng.normal(size=(seeds, 1))
    return np.asarray(out + of_residuals * rng.normal(size=(seeds, places)))


def coverage(found: list[Difference], true: float) -> float:
    return float(np.mean([f.interval is not None and not f.interval.excludes(true) for f in found]))


@pytest.mark.parametrize("places", [30, 90])
@pytest.mark.parametrize(
    "spread",
    [(1, 0, 0.01), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 3, 1), (1, 10, 1), (0, 30, 1)],
    ids=str,
)
def test_the_interval_covers_whatever_varies(places: int, spread: tuple[float, float, float]) -> None:
    rng = np.random.default_rng([places, *(round(100 * s) for s in spread)])
    found = []
    for _ in range(600):
        d = 0.02 * drawn(rng, places, *spread)
        found.append(crossed_difference(0.1 + d, np.zeros_like(d)))
    assert coverage(found, 0.1) >= 0.915


def test_an_interval_by_places_alone_does_not_cover_where_seeds_vary() -> None:
    rng = np.random.default_rng(0)
    crossed, by_places = [], []
    for _ in range(300):
        d = 0.02 * drawn(rng, 90, 0, 3, 1)
        crossed.append(crossed_difference(d, np.zeros_like(d)))
        by_places.append(paired_difference([d.mean(axis=0)], [np.zeros(90)], independent=True))
    assert coverage(crossed, 0.0) >= 0.92
    assert coverage(by_places, 0.0) < 0.85


@pytest.mark.parametrize(("of_seeds", "share"), [(0.0, 0.2), (0.3, 0.2), (0.3, 0.6)])
def test_the_difference_of_two_recalls_is_covered(of_seeds: float, share: float) -> None:
    """Images are found or not: six of each place, by a place's difficulty, a training's luck and chance."""
    rng = np.random.default_rng(7)
    found = []
    for _ in range(300):
        hard = 0.7 * rng.normal(size=(1, 1, 90, 1))
        lucky = of_seeds * rng.normal(size=(2, SEEDS, 1, 1))
        chance = math.sqrt(1 - 0.7**2) * rng.normal(size=(2, SEEDS, 90, 6))
        right = hard + lucky + chance < stats.norm.ppf(share) * math.sqrt(1 + of_seeds**2)
        found.append(crossed_difference(*right.mean(axis=-1)))
    assert coverage(found, 0.0) >= 0.93


def test_without_differences_of_seeds_beyond_chance_the_interval_is_that_by_places() -> None:
    rng = np.random.default_rng(1)
    d = drawn(rng, 90, 0.01, 0, 0.01)
    d -= d.mean(axis=1, keepdims=True) - d.mean()  # seeds agree exactly
    found = crossed_difference(d, np.zeros_like(d)).interval
    by_places = paired_difference([d.mean(axis=0)], [np.zeros(90)], independent=True).interval
    assert found is not None
    assert by_places is not None
    assert (found.low, found.high) == pytest.approx((by_places.low, by_places.high), rel=0.01)


def test_where_only_seeds_differ_the_interval_is_students_over_the_seeds() -> None:
    of_seeds = np.array([0.02, 0.10, 0.06])
    d = np.repeat(of_seeds[:, None], 5000, axis=1)
    found = crossed_difference(d, np.zeros_like(d))
    half = stats.t.ppf(0.975, 2) * of_seeds.std(ddof=1) / math.sqrt(3)
    assert found.mean == pytest.approx(0.06)
    assert found.interval is not None
    assert (found.interval.low, found.interval.high) == pytest.approx((0.06 - half, 0.06 + half), abs=1e-4)
    assert not found.significant


def test_the_interval_by_hand() -> None:
    """The components of a table of ten places and two seeds, as the docstring's formulas give them."""
    d = np.array([[3, 1, 4, 1, 5, 9, 2, 6, 5, 3], [2, 7, 1, 8, 2, 8, 1, 8, 2, 8]]) / 10
    of_places = d.mean(axis=0)
    mean = of_places.mean() * 10 / 12
    with_added = np.append(of_places, [of_places.max(), -of_places.max()])
    unbiased = 10 * (of_places.var() * 10 / 9) - 10 * of_places.var()
    v_a = (with_added.var() + unbiased / 12) / 12
    v_b = d.mean(axis=1).var(ddof=1) / 2
    residuals = d - of_places - d.mean(axis=1, keepdims=True) + d.mean()
    v_e = (residuals**2).sum() / 9 / 20
    v = v_e + max(v_a - v_e, 0) + max(v_b - v_e, 0)
    freedom = v**2 / (v_a**2 / 9 + v_b**2 / 1 + v_e**2 / 9)
    half = stats.t.ppf(0.975, min(max(freedom, 1), 9)) * math.sqrt(v)
    found = crossed_difference(d, np.zeros_like(d)).interval
    assert found is not None
    assert (found.low, found.high) == pytest.approx((mean - half, mean + half))


@settings(max_examples=30)
@given(st.integers(2, 5), st.integers(10, 40), st.integers(0, 2**32 - 1))
def test_it_is_no_narrower_than_by_places_and_turns_with_the_methods(seeds: int, places: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = (rng.random((2, seeds, places)) < rng.random((2, seeds, 1))).astype(float)
    found, turned = crossed_difference(a, b), crossed_difference(b, a)
    by_places = paired_difference([a.mean(axis=0)], [b.mean(axis=0)], independent=True)
    assert found.interval is not None
    assert turned.interval is not None
    assert by_places.interval is not None
    assert found.mean == pytest.approx(by_places.mean)
    assert found.interval.low <= by_places.interval.low + 1e-9
    assert found.interval.high >= by_places.interval.high - 1e-9
    assert (turned.interval.low, turned.interval.high) == pytest.approx((-found.interval.high, -found.interval.low))
    order = rng.permutation(places)
    again = crossed_difference(a[::-1, order], b[::-1, order]).interval
    assert again is not None
    assert (again.low, again.high) == pytest.approx((found.interval.low, found.interval.high))


def test_equal_answers_are_no_proof_of_equality() -> None:
    same = np.ones((SEEDS, 90))
    found = crossed_difference(same, same)
    assert found.mean == 0.0
    assert found.interval is not None
    assert -0.1 < found.interval.low < 0 < found.interval.high < 0.1
    assert not found.significant


@pytest.mark.parametrize("shape", [(1, 90), (3, 9)])
def test_one_seed_or_few_places_have_no_interval(shape: tuple[int, int]) -> None:
    found = crossed_difference(np.full(shape, 0.75), np.full(shape, 0.25))
    assert found == Difference(0.5, None)
    assert not found.significant


def test_what_cannot_be_compared_is_refused() -> None:
    for a, b in ((np.ones((3, 20)), np.ones((2, 20))), (np.ones(20), np.ones(20)), (np.ones((3, 0)), np.ones((3, 0)))):
        with pytest.raises(ValueError, match=r"\(S, P\)"):
            crossed_difference(a, b)
    with pytest.raises(ValueError, match="finite"):
        crossed_difference(np.full((3, 20), np.nan), np.ones((3, 20)))
