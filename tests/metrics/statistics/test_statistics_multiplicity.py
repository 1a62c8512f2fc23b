"""Differences that are listed together, with one error rate."""

from __future__ import annotations

import numpy as np
import pytest

from relocbench.arrays import Array
from relocbench.metrics import Difference, Interval, controlled

ROADS = 12
CLEAR = Interval(0.001, 1.0, 0.95)


def by_road(of_roads: Array) -> Difference:
    return Difference(float(of_roads.mean()), CLEAR, 0.0001, dict(enumerate(of_roads.tolist())))


def test_a_single_difference_has_the_exact_p_value_of_its_signs() -> None:
    five = np.zeros(ROADS)
    five[:5] = 0.01, 0.02, 0.01, 0.03, 0.01
    all_ = np.linspace(0.01, 0.3, ROADS)
    for of_roads, p in ((five, 2 / 2**5), (all_, 2 / 2**ROADS), (np.zeros(ROADS), 1.0), (-all_, 2 / 2**ROADS)):
        (found,) = controlled([by_road(of_roads)])
        assert found.adjusted_p == pytest.approx(p)
        assert found.significant == (p < 0.05)


def test_copies_cost_nothing_and_others_raise_the_p_value() -> None:
    rng = np.random.default_rng(0)
    clear, weak = rng.random(ROADS), rng.normal(0.8, 1.0, ROADS)
    (alone,) = controlled([by_road(weak)])
    copied = controlled([by_road(weak)] * 30)
    many = controlled([by_road(weak), *(by_road(rng.normal(size=ROADS)) for _ in range(30)), by_road(clear)])
    assert alone.adjusted_p is not None
    assert [each.adjusted_p for each in copied] == [alone.adjusted_p] * 30
    assert many[0].adjusted_p is not None
    assert many[0].adjusted_p > 5 * alone.adjusted_p
    assert many[-1].significant


def test_equal_methods_seldom_have_a_star_anywhere_on_a_page() -> None:
    stars = []
    for seed in range(100):
        methods = np.random.default_rng(seed).binomial(312, 0.99, (8, ROADS)) / 312
        page = controlled([by_road(methods[0] - other) for other in methods[1:]])
        stars.append(any(each.significant for each in page))
    assert np.mean(stars) <= 0.08


def test_few_roads_are_tested_by_their_intervals_with_holms_factors() -> None:
    page = [Difference(0.1, CLEAR, p, {"town": 0.1}) for p in (0.02, 0.01, 0.6)] + [Difference(0.5, None)]
    found = controlled(page)
    assert [each.adjusted_p for each in found] == [pytest.approx(0.04), pytest.approx(0.03), pytest.approx(0.6), None]
    assert [each.significant for each in found] == [True, True, False, False]


def test_more_roads_than_can_be_gone_through_are_drawn_by_the_seed() -> None:
    of_roads = np.random.default_rng(1).normal(0.4, 1.0, 40)
    first, again, other = (controlled([by_road(of_roads)], seed=seed)[0].adjusted_p for seed in (0, 0, 1))
    assert first is not None
    assert other is not None
    assert first == again != other
    assert first == pytest.approx(other, abs=0.01)
    assert controlled([]) == []
