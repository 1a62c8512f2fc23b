"""Differences in percentage points, whose text says on which side of zero each end lies."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from relocbench.metrics import Difference, Interval, in_points

numbers = st.floats(-1, 1) | st.floats(-1e-3, 1e-3) | st.sampled_from([0.0, -0.0, 5e-4, -5e-4, 1e-10])
shares = numbers.map(lambda share: share if abs(share) > 1e-11 else 0.0)  # less is a rounding error


@given(shares, shares, shares, st.none() | st.floats(0, 1))
def test_the_text_of_a_difference_has_its_numbers_signs_and_star(a: float, b: float, c: float, p: float | None) -> None:
    low, mean, high = sorted((a, b, c))
    difference = Difference(mean, Interval(low, high, 0.95), 0.01, adjusted_p=p)
    text = in_points(difference)
    shown = re.fullmatch(r"([-+]?\d+\.\d+) \[([-+]?\d+\.\d+), ([-+]?\d+\.\d+)\]( \*)?", text)
    assert shown is not None, text
    assert (shown[4] is not None) == (p is not None and difference.significant)
    for number, share in zip(shown.groups()[:3], (mean, low, high), strict=True):
        points = 100 * share
        assert float(number) == pytest.approx(points, abs=0.05 if abs(points) >= 0.05 else 0.005)
        assert (number[0] in "+-") == (float(number) != 0)
    for number, share in ((shown[2], low), (shown[3], high)):
        assert share == 0 or float(number) * share > 0, "an end is on its side of zero"


@pytest.mark.parametrize(
    ("mean", "ends", "text"),
    [
        (0.015, (-0.0002, 0.03), "+1.5 [-0.02, +3.0]"),
        (0.0004, (0.0001, 0.5), "+0.04 [+0.01, +50.0]"),
        (0.0, (-0.00001, 0.0), "0.0 [-0.001, 0.0]"),
        (-0.4, None, "-40.0"),
    ],
)
def test_differences_as_they_are_printed(mean: float, ends: tuple[float, float] | None, text: str) -> None:
    assert in_points(Difference(mean, ends and Interval(*ends, 0.95))) == text
