"""Intervals that cover, differences that are real, and ranks that share a place otherwise."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from relocbench.metrics import (
    automatic_block_length,
    bootstrap_interval,
    common_block_length,
    paired_difference,
    rank_with_ties,
)
from relocbench.metrics.statistics.significance import _resampled_means

Array = NDArray[np.float64]


def autoregressive(rng: np.random.Generator, n: int, rho: float) -> Array:
    """Stationary AR(1) with unit innovations."""
    x = np.empty(n)
    x[0] = rng.normal() / np.sqrt(1 - rho**2)
    for i, innovation in enumerate(rng.normal(size=n - 1), start=1):
        x[i] = rho * x[i - 1] + innovation
    return x


def drive(rng: np.random.Generator, n: int, rho: float) -> Array:
    """0/1 recalls, 0.5 in the mean, of a drive whose good and bad stretches are correlated."""
    return (autoregressive(rng, n, rho) > 0).astype(float)


def coverage(block_length: int | None, n: int, rho: float) -> float:
    rng = np.random.default_rng(11)
    hits = 0
    for _ in range(300):
        interval = bootstrap_interval([drive(rng, n, rho)], rng, block_length=block_length, resamples=300)
        assert interval is not None
        hits += not interval.excludes(0.5)
    return hits / 300


def test_interval_covers_the_truth_of_independent_pairs() -> None:
    assert 0.91 <= coverage(None, 600, 0.0) <= 0.98
    assert 0.91 <= coverage(1, 600, 0.0) <= 0.98


def test_interval_covers_the_truth_of_a_correlated_drive_where_single_pairs_do_not() -> None:
    assert 0.9 <= coverage(None, 2000, 0.8) <= 0.98
    assert coverage(1, 2000, 0.8) <= 0.7


def test_interval_of_independent_pairs_has_the_width_of_the_normal_law() -> None:
    values = np.random.default_rng(2).normal(size=4000)
    interval = bootstrap_interval([values], np.random.default_rng(3), block_length=1, resamples=4000)
    assert interval is not None
    assert interval.high - interval.low == pytest.approx(2 * 1.96 * values.std() / np.sqrt(4000), rel=0.05)
    assert interval.low < values.mean() < interval.high


def test_every_pair_is_drawn_equally_often_also_at_the_ends_of_the_drive() -> None:
    # Indicators of the first, a middle and the last of 20 pairs, in blocks of 7 (which does not divide 20).
    indicators = np.eye(20)
    means = _resampled_means(indicators, 7, np.random.default_rng(0), 20000)
    np.testing.assert_allclose(means.mean(axis=1), 1 / 20, rtol=0.05)
    np.testing.assert_allclose(means.sum(axis=0), 1.0, atol=1e-12)  # each resample holds exactly 20 pairs


def test_blocks_are_runs_of_neighbours_around_the_circle() -> None:
    means = _resampled_means(np.eye(6), 3, np.random.default_rng(0), 200)
    drawn = np.rint(means.T * 6).astype(int)
    runs = np.array([np.roll([1, 1, 1, 0, 0, 0], s) for s in range(6)])
    sums = {tuple(a + b) for a in runs for b in runs}
    assert {tuple(row) for row in drawn} <= sums


def test_a_method_does_not_differ_from_itself() -> None:
    values = drive(np.random.default_rng(0), 300, 0.8)
    difference = paired_difference([values], [values], np.random.default_rng(0))
    assert difference.mean == 0.0
    assert difference.interval is not None
    assert (difference.interval.low, difference.interval.high) == (0.0, 0.0)
    assert not difference.significant


def test_two_methods_of_equal_skill_differ_about_one_time_in_twenty() -> None:
    rng = np.random.default_rng(7)
    significant = [
        paired_difference([drive(rng, 400, 0.5)], [drive(rng, 400, 0.5)], rng, resamples=300).significant
        for _ in range(300)
    ]
    assert 0.01 <= np.mean(significant) <= 0.11


def test_pairing_finds_a_small_difference_that_separate_intervals_hide() -> None:
    rng = np.random.default_rng(4)
    hard = autoregressive(rng, 500, 0.9)
    a, b = hard + rng.normal(0.1, 0.3, 500), hard + rng.normal(0, 0.3, 500)
    of_a, of_b = bootstrap_interval([a], rng), bootstrap_interval([b], rng)
    assert of_a is not None
    assert of_b is not None
    assert of_a.low < of_b.high
    difference = paired_difference([a], [b], rng)
    assert difference.significant
    assert difference.mean == pytest.approx(np.mean(a - b))
    swapped = paired_difference([b], [a], rng)
    assert swapped.significant
    assert swapped.mean == -difference.mean


def test_same_seed_same_interval() -> None:
    values = drive(np.random.default_rng(0), 300, 0.8)
    first, again = (bootstrap_interval([values], np.random.default_rng(5)) for _ in range(2))
    assert first == again
    assert first != bootstrap_interval([values], np.random.default_rng(6))


def test_fewer_than_six_blocks_say_nothing() -> None:
    ones, zeros = np.ones(5), np.zeros(5)
    difference = paired_difference([ones], [zeros], np.random.default_rng(0))
    assert difference.interval is None
    assert not difference.significant
    assert paired_difference([np.ones(6)], [np.zeros(6)], np.random.default_rng(0)).significant
    assert bootstrap_interval([np.arange(50.0)], np.random.default_rng(0), block_length=10) is None
    assert bootstrap_interval([np.arange(60.0)], np.random.default_rng(0), block_length=10) is not None


def test_ranks_share_a_place_when_the_difference_is_not_significant() -> None:
    rng = np.random.default_rng(8)
    hard = rng.random(800)
    values = {
        "worst": [(hard < 0.2).astype(float)],
        "b": [((hard < 0.6) ^ (rng.random(800) < 0.05)).astype(float)],
        "a": [((hard < 0.6) ^ (rng.random(800) < 0.05)).astype(float)],
        "best": [(hard < 0.9).astype(float)],
    }
    assert rank_with_ties(values, np.random.default_rng(0)) == {"worst": 4, "b": 2, "a": 2, "best": 1}
    assert rank_with_ties(values, np.random.default_rng(0), higher_is_better=False) == {
        "worst": 1,
        "b": 2,
        "a": 2,
        "best": 4,
    }


def test_ranks_do_not_depend_on_the_order_of_the_methods() -> None:
    rng = np.random.default_rng(9)
    values = {name: [drive(rng, 200, 0.7), drive(rng, 90, 0.7)] for name in "abcdef"}
    ranks = rank_with_ties(values, np.random.default_rng(0))
    backwards = rank_with_ties(dict(reversed(values.items())), np.random.default_rng(0))
    assert ranks == backwards
    assert min(r for r in ranks.values() if r is not None) == 1


def test_method_with_a_missing_set_has_no_rank_and_moves_nobody() -> None:
    good, bad = np.ones(100), np.zeros(100)
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


def test_each_pair_set_counts_the_same_whatever_its_size() -> None:
    a = [np.zeros(1000), np.ones(60)]
    b = [np.full(1000, 0.1), np.zeros(60)]
    difference = paired_difference(a, b, np.random.default_rng(0))
    assert difference.mean == pytest.approx((-0.1 + 1.0) / 2)
    assert rank_with_ties({"a": a, "b": b}, np.random.default_rng(0)) == {"a": 1, "b": 2}


def test_different_pairs_cannot_be_compared() -> None:
    with pytest.raises(ValueError, match="same pairs"):
        paired_difference([np.ones(10)], [np.ones(11)], np.random.default_rng(0))
    with pytest.raises(ValueError, match="same pairs"):
        rank_with_ties({"a": [np.ones(10)], "b": [np.ones(11)]}, np.random.default_rng(0))


@pytest.mark.parametrize("values", [[], [[]], [[np.inf, 1.0]], [[np.nan]]])
def test_values_that_have_no_mean_are_refused(values: list[list[float]]) -> None:
    with pytest.raises(ValueError, match=r"at least one pair set|finite numbers"):
        bootstrap_interval(values, np.random.default_rng(0))


@pytest.mark.parametrize("rho", [0.3, 0.6, 0.8])
def test_automatic_block_length_is_the_optimum_of_an_autoregressive_drive(rho: float) -> None:
    # For AR(1): G = 2 rho R0 / (1 - rho)^2, g = (1 + rho) R0 / (1 - rho), b = (2 G^2 / (4/3 g^2) N)^(1/3).
    n = 4000
    G, g = 2 * rho / (1 - rho) ** 2, (1 + rho) / (1 - rho)
    optimum = (2 * G**2 / (4 / 3 * g**2) * n) ** (1 / 3)
    rng = np.random.default_rng(1)
    chosen = np.median([automatic_block_length(autoregressive(rng, n, rho)) for _ in range(40)])
    assert chosen == pytest.approx(optimum, rel=0.2)


def test_automatic_block_length_is_short_for_independent_pairs_and_sane_for_odd_ones() -> None:
    rng = np.random.default_rng(1)
    assert np.median([automatic_block_length(rng.normal(size=1000)) for _ in range(40)]) <= 2
    assert automatic_block_length(np.ones(100)) == 1
    for n in range(1, 12):
        for x in (np.arange(float(n)), np.ones(n), np.arange(n) % 2.0):
            assert 1 <= automatic_block_length(x) <= max(1, n // 3)
    assert automatic_block_length(np.arange(1000.0)) <= 3 * np.sqrt(1000) + 1


def test_common_block_length_is_the_longest_wanted_that_leaves_six_blocks() -> None:
    rng = np.random.default_rng(3)
    smooth, rough = autoregressive(rng, 2000, 0.9), rng.normal(size=2000)
    assert common_block_length(np.stack([rough, smooth])) >= automatic_block_length(smooth)
    assert common_block_length(np.arange(60.0)[None]) == 10


def test_all_methods_are_resampled_together_with_a_draw_a_block() -> None:
    """What a ranking costs: 1000 resamples of 2000 pairs draw blocks, not pairs, and once, not for each method."""

    class Counting:
        def __init__(self) -> None:
            self.rng, self.drawn = np.random.default_rng(0), 0

        def integers(self, high: int, size: tuple[int, ...]) -> Any:
            self.drawn += int(np.prod(size))
            return self.rng.integers(high, size=size)

    rng = np.random.default_rng(3)
    values = {name: [drive(rng, 2000, 0.9)] for name in "abcde"}
    counting = Counting()
    rank_with_ties(values, cast(np.random.Generator, counting), resamples=1000)
    length = common_block_length(np.stack([values[name][0] for name in "abcde"]))
    assert length > 10
    assert counting.drawn <= 1000 * -(-2000 // length)
