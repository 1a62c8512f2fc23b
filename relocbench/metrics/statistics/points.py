"""A difference of shares as people read it, in percentage points."""

from __future__ import annotations

from relocbench.metrics.statistics.intervals import Difference

_CLOSE = 0.05
"""percentage points from zero within which one decimal could hide on which side of it a number lies"""
_ZERO = 1e-9
"""percentage points that are rounding errors"""


def in_points(difference: Difference) -> str:
    """``+1.5 [-0.02, +3.0] *``: the mean, the interval where there is one, and a star where it is significant among all
    differences of its page (:func:`relocbench.metrics.controlled`).

    Numbers have one decimal, and two within 0.05 of zero; an end of the interval has as many as show its sign, and what
    is rounded to zero has no sign.
    """
    interval = difference.interval
    text = _signed(difference.mean, most=2)
    if interval is None:
        return text
    star = " *" if difference.adjusted_p is not None and difference.significant else ""
    return f"{text} [{_signed(interval.low)}, {_signed(interval.high)}]{star}"


def _signed(share: float, *, most: int = 9) -> str:
    """A share in percentage points with its sign, and at most so many decimals."""
    points = 100 * share
    decimals = 2 if _ZERO < abs(points) < _CLOSE else 1
    while decimals < most and abs(points) > _ZERO and round(points, decimals) == 0:
        decimals += 1
    text = f"{points:+.{decimals}f}"
    return text if float(text) else text[1:]
