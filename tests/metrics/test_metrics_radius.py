"""The offset at which half of the starts succeed."""

from __future__ import annotations

import numpy as np
import pytest

from relocbench.metrics import radius_of, radius_ratio, success_radius

OFFSETS = (0.0, 1.0, 2.0, 4.0, 8.0)


@pytest.mark.parametrize(
    ("shares", "radius", "beyond"),
    [
        ((1, 1, 1, 0, 0), 3.0, False),  # half-way between 2 and 4
        ((1, 0.75, 0.25, 0, 0), 1.5, False),
        ((1, 1, 0.5, 0.25, 0), 2.0, False),  # exactly a half still counts
        ((1, 0.4, 1, 1, 1), 5 / 6, False),  # the first fall, whatever comes behind it
        ((0.4, 1, 1, 1, 1), 0.0, False),
        ((1, 1, 1, 1, 0.5), 8.0, True),
        ((0, 0, 0, 0, 0), 0.0, False),
    ],
)
def test_the_radius_is_where_the_line_falls_below_a_half(
    shares: tuple[float, ...], radius: float, beyond: bool
) -> None:
    found = success_radius(OFFSETS, shares)
    assert found.value == pytest.approx(radius)
    assert found.beyond is beyond
    assert found.interval is None


def test_a_relative_radius_measures_the_width_of_a_low_basin() -> None:
    low = success_radius(OFFSETS, (0.2, 0.2, 0.2, 0.0, 0.0), relative=True)
    assert low.value == pytest.approx(success_radius(OFFSETS, (1, 1, 1, 0, 0)).value)
    assert success_radius(OFFSETS, (0, 0.5, 0, 0, 0), relative=True).value == 0.0


@pytest.mark.parametrize(
    ("offsets", "shares"),
    [((0, 1), (1, 1, 0)), ((1, 0), (1, 0)), ((0,), (1,)), ((0, 1), (1, np.nan)), ((-1, 1), (1, 0))],
)
def test_what_is_no_curve_is_refused(offsets: tuple[float, ...], shares: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="offsets"):
        success_radius(offsets, shares)


def basins(limits: np.ndarray) -> np.ndarray:
    """(K, N): each pair succeeds up to its own limit."""
    return (np.array(OFFSETS)[:, None] <= limits).astype(float)


def test_the_interval_over_drives_covers_the_radius_of_the_street() -> None:
    """Success at 0, 1, 2, 4, 8 has chances 1, 0.9, 0.6, 0.3, 0: the true radius is 2 + 2/3."""
    covered = 0
    for trial in range(100):
        rng = np.random.default_rng(trial)
        limits = rng.choice([0.5, 1.5, 3.0, 6.0], size=160, p=[0.1, 0.3, 0.3, 0.3])
        interval = radius_of([basins(limits[:80]), basins(limits[80:])], OFFSETS).interval
        assert interval is not None
        covered += not interval.excludes(2 + 2 / 3)
    assert 88 <= covered <= 100


def test_few_pairs_give_no_interval() -> None:
    assert radius_of([basins(np.array([1.0, 2.0, 4.0]))], OFFSETS).interval is None


def test_a_pair_set_counts_the_same_whatever_its_size() -> None:
    sets = [basins(np.full(30, 8.0)), basins(np.full(3, 0.0))]
    assert radius_of(sets, OFFSETS).value == pytest.approx(8.0)  # shares 1, then a half
    sets = [*sets, basins(np.full(3, 0.0))]
    assert radius_of(sets, OFFSETS).value == pytest.approx(0.75)  # 1, then a third


def test_the_ratio_is_paired() -> None:
    """Where A always reaches as far as B the ratio is 1 with no spread, however different the pairs are."""
    limits = np.random.default_rng(1).choice([0.0, 1.0, 2.0, 4.0], size=60)
    same = radius_ratio([basins(limits)], [basins(limits)], OFFSETS)
    assert same.value == 1.0
    assert same.interval is not None
    assert (same.interval.low, same.interval.high) == (1.0, 1.0)
    twice = radius_ratio([basins(2 * limits)], [basins(limits)], OFFSETS)
    assert 1.3 < twice.value < 2.5
    assert twice.interval is not None
    assert twice.interval.low > 1.0


def test_a_ratio_to_no_basin_at_all() -> None:
    none, some = [np.zeros((5, 30))], [basins(np.full(30, 2.0))]
    assert radius_ratio(some, none, OFFSETS).value == np.inf
    nothing = radius_ratio(none, none, OFFSETS)
    assert np.isnan(nothing.value)
    assert nothing.interval is None


def test_shares_that_do_not_fit_the_offsets_are_refused() -> None:
    with pytest.raises(ValueError, match="shares"):
        radius_of([np.zeros((4, 10))], OFFSETS)
