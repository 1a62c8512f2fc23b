"""Pair sets of one road count as one series: what they have in common does not average out."""

from __future__ import annotations

import numpy as np
import pytest
from autoregression import autoregressive
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtri

from relocbench.arrays import Array
from relocbench.metrics import Interval, by_place, mean_interval, paired_difference, rank_with_ties
from relocbench.metrics.statistics.intervals import MANY_ROADS
from relocbench.metrics.statistics.ranks import different_methods
from relocbench.metrics.statistics.roads import aligned, by_road

lengths = st.lists(st.integers(1, 40), min_size=1, max_size=5)


def sets_of_one_road(rng: np.random.Generator, sets: int, n: int, common: float, rho: float = 0.5) -> list[Array]:
    """Errors in normal scores, a share ``common`` of whose variance the sets have in common."""
    shared = np.sqrt(common) * autoregressive(rng, n, rho)
    return [shared + np.sqrt(1 - common) * autoregressive(rng, n, rho) for _ in range(sets)]


def successes(x: Array, share: float = 0.5) -> Array:
    return (x < ndtri(share)).astype(float)


def width(interval: Interval | None) -> float:
    assert interval is not None
    return interval.high - interval.low


def test_a_road_with_one_set_is_that_set() -> None:
    x = np.random.default_rng(0).random(50)
    (series,) = by_road([x])
    assert np.array_equal(series, x)
    a, b = by_road([x, x[:20]], ["north", "south"])
    assert np.array_equal(a, x)
    assert np.array_equal(b, x[:20])


def test_sets_of_equal_length_are_averaged_pair_by_pair() -> None:
    rng = np.random.default_rng(1)
    x = rng.random((3, 2, 30))
    (series,) = by_road([*x])
    np.testing.assert_allclose(series, x.mean(axis=0), rtol=0, atol=1e-15)
    interleaved = by_road([x[0], x[1], x[2]], ["a", "b", "a"])
    np.testing.assert_allclose(interleaved[0], (x[0] + x[2]) / 2, rtol=0, atol=1e-15)
    assert np.array_equal(interleaved[1], x[1])


@given(lengths, st.integers(0, 1000))
def test_sets_of_unequal_lengths_keep_the_mean_of_their_means(of: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    sets = [rng.random((2, n)) for n in of]
    (series,) = by_road(sets)
    assert series.shape == (2, min(of))
    np.testing.assert_allclose(series.mean(axis=1), np.mean([x.mean(axis=1) for x in sets], axis=0), atol=1e-12)
    (each,) = aligned(sets)
    np.testing.assert_allclose(each.mean(axis=2), [x.mean(axis=1) for x in sets], atol=1e-12)


def test_a_longer_set_is_cut_into_stretches_along_the_road() -> None:
    slow = np.sin(np.linspace(0, 6, 1000))
    (series,) = by_road([slow[::10], slow, slow[::2]])
    assert np.corrcoef(series, slow[::10])[0, 1] > 0.999
    assert series.std() == pytest.approx(slow.std(), rel=0.02)


@pytest.mark.parametrize("rho", [0.0, 0.6])
def test_two_identical_sets_say_as_much_as_one(rho: float) -> None:
    x = autoregressive(np.random.default_rng(2), 300, rho)
    values, errors = successes(x), np.exp(x)[None]
    one, two = mean_interval([values], [errors]), mean_interval([values] * 2, [errors] * 2)
    assert one is not None
    assert two is not None
    assert (two.low, two.high) == pytest.approx((one.low, one.high), abs=1e-9)
    other = successes(autoregressive(np.random.default_rng(3), 300, rho))
    alone, twice = paired_difference([values], [other]), paired_difference([values] * 2, [other] * 2)
    assert alone.interval is not None
    assert twice.interval is not None
    assert (twice.interval.low, twice.interval.high) == pytest.approx((alone.interval.low, alone.interval.high))


def test_only_what_sets_have_not_in_common_averages_out() -> None:
    widths = {}
    for common in (0.0, 0.5, 1.0):
        rng = np.random.default_rng(4)
        x = sets_of_one_road(rng, 4, 1000, common)
        widths[common] = width(mean_interval([successes(of) for of in x], [np.exp(of)[None] for of in x]))
        if common == 1.0:
            alone = width(mean_interval([successes(x[0])], [np.exp(x[0])[None]]))
    assert widths[0.0] < widths[0.5] < widths[1.0]
    assert widths[0.0] == pytest.approx(alone / 2, rel=0.25)
    assert widths[1.0] == pytest.approx(alone)


@pytest.mark.thorough
@given(st.permutations(range(5)), st.integers(0, 50))
def test_the_order_of_sets_and_the_names_of_roads_change_nothing(order: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = [rng.normal(size=n) for n in (40, 50, 45, 60, 41)]
    roads: list[str] = ["a", "b", "a", "b", "a"]
    renamed = {"a": 7, "b": 3}

    def both(of: list[int], names: list[str] | list[int]) -> list[Interval | None]:
        values, errors = [successes(x[i]) for i in of], [np.exp(x[i])[None] for i in of]
        ahead = paired_difference(values, [successes(x[i] + 0.5) for i in of], roads=names)
        return [mean_interval(values, errors, roads=names), ahead.interval]

    straight = both([0, 1, 2, 3, 4], roads)
    permuted = both(order, [renamed[roads[i]] for i in order])
    for one, other in zip(straight, permuted, strict=True):
        assert (one is None) == (other is None)
        if one is not None and other is not None:
            assert (one.low, one.high) == pytest.approx((other.low, other.high), abs=1e-9)


def test_intervals_cover_on_roads_whose_sets_err_together() -> None:
    covered = {"road": 0, "sets": 0}
    for seed in range(100):
        rng = np.random.default_rng(seed)
        x = sets_of_one_road(rng, 6, 200, 0.5)
        values, errors = [successes(of, 0.7) for of in x], [np.exp(of)[None] for of in x]
        for name, roads in (("road", None), ("sets", range(6))):
            interval = mean_interval(values, errors, roads=roads)
            assert interval is not None
            covered[name] += not interval.excludes(0.7)
    assert covered["road"] >= 92
    assert covered["sets"] < 90  # the simulation tells the two apart


@pytest.mark.thorough
@pytest.mark.parametrize("roads", [1, 4, 12])
def test_equal_methods_share_a_rank_where_sets_of_a_road_err_together(roads: int) -> None:
    of_sets = [road for road in range(roads) for _ in range(6)]
    different = {"roads": 0, "sets": 0}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        of_methods = {
            str(m): [successes(x) for _ in range(roads) for x in sets_of_one_road(rng, 6, 80, 0.5)] for m in range(6)
        }
        for name, unit in (("roads", of_sets), ("sets", range(len(of_sets)))):
            ranks = rank_with_ties(of_methods, np.random.default_rng(0), roads=unit)
            different[name] += len(set(ranks.values())) > 1
    assert different["roads"] <= 4
    assert different["sets"] >= 8  # the simulation tells the two apart


@pytest.mark.thorough
def test_many_roads_that_suit_methods_by_chance_are_no_evidence() -> None:
    different = {MANY_ROADS - 1: 0, 2 * MANY_ROADS: 0}
    for roads in different:
        for seed in range(30):
            rng = np.random.default_rng(seed)
            of_methods = {
                str(m): [successes(rng.normal(size=100) + rng.normal()) for _ in range(roads)] for m in range(5)
            }
            ranks = rank_with_ties(of_methods, rng, roads=range(roads), independent=True)
            different[roads] += len(set(ranks.values())) > 1
    assert different[2 * MANY_ROADS] <= 4
    assert different[MANY_ROADS - 1] >= 15  # few roads speak of themselves only


def test_a_method_that_is_better_on_every_road_is_told_apart_on_eight() -> None:
    rng = np.random.default_rng(0)
    sets = [rng.random((2, 200)) for _ in range(MANY_ROADS)]
    values = [np.stack([x[0] < 0.7, x[1] < 0.5]).astype(float) for x in sets]
    assert different_methods(values, rng, roads=range(MANY_ROADS), independent=True)[0, 1]


def test_values_by_place_have_the_mean_of_the_sets_means() -> None:
    found = by_place([[1.0, 0.0, 1.0], [0.0, 1.0]], [["b", "a", "c"], ["c", "d"]])
    assert found.shape == (4,)
    assert found.mean() == pytest.approx((2 / 3 + 1 / 2) / 2)
    assert found[0] < found[1]
    same = np.random.default_rng(0).random((3, 8))
    np.testing.assert_allclose(by_place([*same], [np.arange(8)] * 3), same.mean(axis=0), atol=1e-12)


def test_what_makes_no_series_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\b2\b.*\b1\b"):
        mean_interval([np.ones(20), np.ones(20)], roads=["a"])
    with pytest.raises(ValueError, match="pair"):
        by_road([np.zeros(0), np.zeros(3)])
    with pytest.raises(ValueError, match="place"):
        by_place([[1.0, 2.0]], [["a"]])
    with pytest.raises(ValueError, match="sets"):
        by_place([], [])
