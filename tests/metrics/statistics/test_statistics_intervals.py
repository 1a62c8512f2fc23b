"""Intervals that cover the true value, and none where nothing can be said."""

from __future__ import annotations

import numpy as np
import pytest
from autoregression import autoregressive
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from relocbench.metrics import mean_interval, median_interval, paired_difference
from relocbench.metrics.statistics.intervals import MANY_ROADS, Interval

some_shares = st.lists(st.floats(0, 1), min_size=1, max_size=60)


def covers(interval: Interval | None, true: float) -> bool | None:
    return None if interval is None else interval.low - 1e-12 <= true <= interval.high + 1e-12


@pytest.mark.parametrize(("n", "rho"), [(64, 0.0), (360, 0.8), (1000, 0.9)])
@pytest.mark.parametrize("share", [0.5, 0.95, 0.99, 1.0])
def test_the_interval_of_a_share_covers_it(n: int, rho: float, share: float) -> None:
    found = []
    for seed in range(150):
        x = autoregressive(np.random.default_rng(seed), n, rho)
        right = (x < stats.norm.ppf(share)).astype(float)
        found += [covers(mean_interval([right], [np.exp(x)]), share)]
        assert found[-1] == covers(mean_interval([1 - right], [np.exp(x)]), 1 - share)
    given_ = [each for each in found if each is not None]
    assert len(given_) > 100
    assert np.mean(given_) >= 0.92


@pytest.mark.parametrize(("n", "rho"), [(64, 0.0), (1000, 0.9)])
@pytest.mark.parametrize("spread", [0.5, 2.0])
def test_the_interval_of_an_area_covers_it(n: int, rho: float, spread: float) -> None:
    true = np.mean(np.maximum(0, 1 - np.exp(spread * (stats.norm.ppf((np.arange(10**5) + 0.5) / 10**5) - 1))))
    found = []
    for seed in range(150):
        error = np.exp(spread * (autoregressive(np.random.default_rng(seed), n, rho) - 1))
        found.append(covers(mean_interval([np.maximum(0, 1 - error)], [error]), float(true)))
    assert np.mean([each for each in found if each is not None]) >= 0.92


def test_the_interval_of_a_median_covers_it() -> None:
    found: list[bool] = []
    for seed in range(200):
        error = np.exp(autoregressive(np.random.default_rng(seed), 500, 0.8))
        interval = median_interval(np.where(error > 2, np.inf, error))
        assert interval is not None
        found.append(not interval.excludes(1.0))
    assert np.mean(found) >= 0.92


def test_independent_successes_have_clopper_and_pearsons_interval() -> None:
    values = np.array([1.0] * 37 + [0.0] * 3)
    found = mean_interval([values], independent=True)
    expected = stats.binomtest(37, 40).proportion_ci(method="exact")
    assert found is not None
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=1e-9)


def test_where_all_succeed_the_interval_has_a_width() -> None:
    found = mean_interval([np.ones(100)], independent=True)
    assert found is not None
    assert found.high == 1.0
    assert found.low == pytest.approx(0.025 ** (1 / 100))
    none = mean_interval([np.zeros(100)], independent=True)
    assert none is not None
    assert (none.low, none.high) == pytest.approx((0.0, 1 - found.low))


def test_where_all_succeed_on_a_drive_its_errors_say_how_much_that_is_worth() -> None:
    rng = np.random.default_rng(0)
    widths = []
    for rho in (0.0, 0.8, 0.95):
        found = mean_interval([np.ones(2000)], [np.exp(autoregressive(rng, 2000, rho))])
        assert found is not None
        widths.append(found.high - found.low)
    assert widths[0] < widths[1] < widths[2]


@pytest.mark.parametrize(("n", "rho"), [(9, 0.0), (16, 0.0), (100, 0.95)])
def test_fewer_than_ten_effective_pairs_have_no_interval(n: int, rho: float) -> None:
    x = autoregressive(np.random.default_rng(3), n, rho)
    assert mean_interval([(x < 0).astype(float)], [x]) is None
    assert median_interval(x) is None
    difference = paired_difference([(x < 0).astype(float)], [np.zeros(n)])
    assert difference.interval is None
    assert not difference.significant


@given(some_shares)
def test_an_interval_lies_in_the_range_and_holds_the_value(values: list[float]) -> None:
    found = mean_interval([values], independent=True)
    assert (found is None) == (len(values) < 10)
    if found is not None:
        assert 0 <= found.low <= np.mean(values) + 1e-9
        assert np.mean(values) - 1e-9 <= found.high <= 1


@given(some_shares, some_shares)
def test_what_is_not_reached_mirrors_what_is(first: list[float], second: list[float]) -> None:
    found = mean_interval([first, second], independent=True)
    other = mean_interval([1 - np.array(first), 1 - np.array(second)], independent=True)
    assert (found is None) == (other is None)
    if found is not None and other is not None:
        assert (1 - other.high, 1 - other.low) == pytest.approx((found.low, found.high), abs=1e-6)


def test_sets_of_unequal_length_are_as_unsure_of_rare_failures() -> None:
    """A set that is cut into stretches of one and two pairs has a value everywhere, which is no failure."""

    def far_end(lengths: tuple[int, ...]) -> float:
        sets = [np.ones(n) for n in lengths]
        for values in sets:
            values[[len(values) // 10, len(values) // 2]] = 0.0
        found = paired_difference(sets, [np.ones(n) for n in lengths])
        assert found.interval is not None
        return found.interval.low

    assert far_end((290, 300, 310)) == pytest.approx(far_end((300, 300, 300)), rel=0.1)


def test_rare_failures_in_one_stretch_may_be_more_than_rare_ones_here_and_there() -> None:
    def far_end(failures: list[int], *, independent: bool = False) -> float:
        values = np.ones(1000)
        values[failures] = 0.0
        found = paired_difference([values], [np.ones(1000)], independent=independent)
        assert found.interval is not None
        return found.interval.low

    scattered = [100, 300, 500, 900]
    assert far_end([500, 501, 502, 503]) < 2 * far_end(scattered)
    # Four lone failures do not say that failures come alone.
    assert far_end(scattered) < 2 * far_end(scattered, independent=True)


def test_each_pair_set_counts_the_same_whatever_its_size() -> None:
    a = [np.zeros(1000), np.ones(60)]
    b = [np.full(1000, 0.1), np.zeros(60)]
    assert paired_difference(a, b).mean == pytest.approx((-0.1 + 1.0) / 2)
    rng = np.random.default_rng(0)
    small, large = (rng.random(n).round() for n in (40, 40000))
    alone = mean_interval([small], independent=True)
    both = mean_interval([small, large], roads=["small", "large"], independent=True)
    assert both is not None
    assert alone is not None
    # The large set is known exactly: half of the uncertainty of the small one remains.
    assert both.high - both.low == pytest.approx((alone.high - alone.low) / 2, rel=0.1)


def test_many_roads_that_differ_have_the_interval_over_roads() -> None:
    means = np.linspace(0.2, 0.8, MANY_ROADS)
    sets = [np.repeat([1.0, 0.0], [round(1000 * m), 1000 - round(1000 * m)]) for m in means]
    found = mean_interval(sets, roads=range(MANY_ROADS), independent=True)
    few = mean_interval(sets[:-1], roads=range(MANY_ROADS - 1), independent=True)
    half = stats.t.ppf(0.975, MANY_ROADS - 1) * means.std(ddof=1) / np.sqrt(MANY_ROADS)
    assert found is not None
    assert few is not None
    assert 0.5 - half - 0.01 < found.low <= 0.5 - half + 1e-9
    assert few.high - few.low < 0.05


def test_a_median_may_be_infinite_above() -> None:
    errors = np.concatenate([np.linspace(0, 1, 45), np.full(55, np.inf)])
    found = median_interval(np.random.default_rng(0).permutation(errors), independent=True)
    assert found is not None
    assert 0 < found.low < 1
    assert found.high == np.inf


def test_two_methods_of_equal_skill_seldom_differ() -> None:
    significant = []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        a, b = ((autoregressive(rng, 400, 0.5) < 0).astype(float) for _ in range(2))
        significant.append(paired_difference([a], [b]).significant)
    assert np.mean(significant) <= 0.08


def test_pairing_finds_a_small_difference_that_separate_intervals_hide() -> None:
    rng = np.random.default_rng(4)
    hard = autoregressive(rng, 1000, 0.9)
    a, b = (hard < 0.1).astype(float), (hard < -0.1).astype(float)
    of_a, of_b = mean_interval([a], [hard]), mean_interval([b], [hard])
    assert of_a is not None
    assert of_b is not None
    assert of_a.low < of_b.high
    assert paired_difference([a], [b]).significant
    swapped = paired_difference([b], [a])
    assert swapped.significant
    assert swapped.mean == -paired_difference([a], [b]).mean


def test_a_method_does_not_differ_from_itself_but_another_pair_might() -> None:
    values = (autoregressive(np.random.default_rng(0), 600, 0.5) > 0).astype(float)
    difference = paired_difference([values], [values])
    assert difference.mean == 0.0
    assert difference.interval is not None
    assert -0.1 < difference.interval.low < 0 < difference.interval.high < 0.1
    assert not difference.significant


@pytest.mark.parametrize("wins", [1, 2, 5])
def test_where_few_pairs_differ_more_may_have_been_missed_than_seen_too_many(wins: int) -> None:
    values = np.zeros(1000)
    values[:wins] = 1
    found = paired_difference([values], [np.zeros(1000)], independent=True).interval
    share = stats.binomtest(wins, 1000).proportion_ci(method="exact")
    assert found is not None
    assert found.high >= share.high - 1e-9
    assert found.high - wins / 1000 > wins / 1000 - found.low
    turned = paired_difference([np.zeros(1000)], [values], independent=True).interval
    assert turned is not None
    assert (-turned.high, -turned.low) == (found.low, found.high)


def test_different_pairs_cannot_be_compared() -> None:
    with pytest.raises(ValueError, match="pairs"):
        paired_difference([np.ones(10)], [np.ones(11)])
    with pytest.raises(ValueError, match="pairs"):
        mean_interval([np.ones(10)], [np.ones((2, 11))])


@pytest.mark.parametrize("values", [[], [[]], [[np.inf, 1.0]], [[np.nan]], [[1.5]], [[-0.1]]])
def test_values_that_are_no_shares_are_refused(values: list[list[float]]) -> None:
    with pytest.raises(ValueError, match=r"pair set|finite|0\.\.1"):
        mean_interval(values)


@pytest.mark.parametrize("level", [0.0, 1.0, 95.0])
def test_an_impossible_level_is_refused(level: float) -> None:
    with pytest.raises(ValueError, match="level"):
        mean_interval([np.ones(20)], level=level)
    with pytest.raises(ValueError, match="NaN"):
        median_interval([np.nan, 1.0])
