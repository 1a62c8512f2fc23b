"""How many independent pairs correlated pairs are worth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from autoregression import autoregressive
from hypothesis import given
from hypothesis import strategies as st

from relocbench.metrics.statistics.effective_size import (
    PRIOR_CORRELATION,
    difference_inflation,
    inflation_of,
    inflation_of_runs,
    series_inflation,
)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8, 0.95])
def test_a_long_autoregression_has_the_inflation_of_its_formula(rho: float) -> None:
    x = np.stack([autoregressive(np.random.default_rng(seed), 20000, rho) for seed in range(5)])
    true = (1 + rho) / (1 - rho)
    found = series_inflation([x[None]]).likely
    assert np.all(found > 0.95 * true)
    assert np.median(found) < 1.4 * true


@pytest.mark.parametrize(("n", "rho"), [(100, 0.0), (100, 0.5), (400, 0.9)])
def test_the_inflation_of_a_short_drive_is_seldom_too_small(n: int, rho: float) -> None:
    x = np.stack([autoregressive(np.random.default_rng(seed), n, rho) for seed in range(300)])
    found = series_inflation([x[None]])
    true = (1 + rho) / (1 - rho)
    assert np.mean(found.likely < true) < 0.16
    assert np.mean(found.cautious < true) < 0.02
    assert np.all(found.cautious >= found.likely)


def test_slow_changes_behind_noise_are_found() -> None:
    rng = np.random.default_rng(0)
    x = np.stack([autoregressive(rng, 5000, 0.95) + rng.normal(size=5000) for _ in range(20)])
    # Lag-one autocorrelation is 0.475 and alone would give 2.8; the true inflation is 1/2 + 39/2 = 20.
    assert np.median(series_inflation([x[None]]).likely) > 15


def test_several_short_sets_are_estimated_together() -> None:
    sets = [np.stack([autoregressive(np.random.default_rng((s, k)), 40, 0.5) for k in range(50)]) for s in range(25)]
    assert np.median(series_inflation([x[None] for x in sets]).likely) == pytest.approx(3.0, rel=0.3)


def test_a_constant_series_has_no_inflation_of_its_own() -> None:
    x = np.stack([np.ones(50), np.arange(50.0)])
    found = series_inflation([x[None]]).likely
    assert np.isnan(found[0])
    assert found[1] > 5


def test_the_errors_tell_how_alike_neighbours_are_where_all_succeed() -> None:
    x = autoregressive(np.random.default_rng(1), 2000, 0.8)
    prior = (1 + PRIOR_CORRELATION) / (1 - PRIOR_CORRELATION)
    assert inflation_of([np.ones(2000)]).likely[0] == pytest.approx(prior)
    assert inflation_of([np.ones(2000)], [np.exp(x)]).likely[0] == pytest.approx(9.0, rel=0.5)
    assert inflation_of([np.ones(2000)], [np.full(2000, np.inf)]).likely[0] == pytest.approx(prior)
    assert inflation_of([np.ones(2000)], [x], independent=True).likely[0] == 1.0


@given(st.integers(20, 200), st.integers(0, 1000))
def test_neither_scale_nor_offset_nor_direction_of_the_drive_matters(n: int, seed: int) -> None:
    x = autoregressive(np.random.default_rng(seed), n, 0.6)
    found = series_inflation([np.stack([x, 5 * x + 3])[None]])
    assert found.likely[0] == pytest.approx(found.likely[1], rel=1e-6)
    errors = np.exp(x)
    assert inflation_of([x], [errors]).likely == pytest.approx(inflation_of([x], [errors**3]).likely)


def test_differences_have_the_inflation_of_their_series() -> None:
    rng = np.random.default_rng(2)
    sets = [np.stack([autoregressive(rng, n, rho) for rho in (0.0, 0.5, 0.9)]) for n in (300, 500)]
    found = difference_inflation([x[None] for x in sets], np.ones((3, 3), dtype=bool))
    assert np.isnan(np.diag(found.likely)).all()
    assert np.allclose(found.likely, found.likely.T, equal_nan=True)
    assert found.likely[0, 2] > found.likely[0, 1] > 1
    same = difference_inflation([np.stack([x[0], x[0], x[1]])[None] for x in sets], np.ones((3, 3), dtype=bool))
    assert np.isnan(same.likely[0, 1])
    assert same.likely[0, 2] == pytest.approx(same.likely[1, 2])


def test_a_few_runs_tell_little_of_their_length() -> None:
    """Of one run of one pair, the mean of its geometric law is below 1 / -ln(0.95) with a probability of 95 %."""
    alone = np.arange(300) == 7
    assert inflation_of_runs([alone]) == pytest.approx(2 / -math.log(0.95) - 1)
    assert inflation_of_runs([~alone & False]) == 1.0
    rng = np.random.default_rng(0)
    runs = rng.geometric(0.25, 20000)
    many = np.repeat(np.arange(2 * len(runs)) % 2 == 0, np.stack([runs, np.full_like(runs, 9)], axis=1).ravel())
    assert inflation_of_runs([many]) == pytest.approx(2 * 4 - 1, rel=0.03)
    # Who has seen one long run knows no less than who has seen none.
    assert inflation_of_runs([np.arange(300) // 9 == 3]) == pytest.approx(
        (1 + PRIOR_CORRELATION) / (1 - PRIOR_CORRELATION)
    )
    # A run ends with the road.
    assert inflation_of_runs([many, many]) < inflation_of_runs([many[:9]])
