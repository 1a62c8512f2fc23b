"""The damping schedule of Levenberg-Marquardt."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from functools import cached_property


@dataclass(frozen=True)
class Damping:
    """How lambda changes in (H + lambda diag H) d = -g. The defaults are those of DSO's tracker."""

    first: float = 0.01
    """lambda at the start of each level"""
    accepted: float = 0.5
    """factor of lambda after a step that lowered the mean energy"""
    rejected: float = 4.0
    """factor of lambda after a step that did not"""
    floor: float = 0.001
    """the smallest lambda after a rejected step"""
    extrapolate_below: float = 0.001
    """below this lambda, steps are lengthened by (this / lambda)^(1/4); 0 disables it"""
    smallest_step: float = 1e-3
    """norm of the step, in metres and half radians, at which a level has converged"""

    @cached_property
    def schedule(self) -> tuple[float, float, float, float, float, float]:
        """The fields in their order, for compiled functions."""
        first, accepted, rejected, floor, extrapolate_below, smallest_step = astuple(self)
        return first, accepted, rejected, floor, extrapolate_below, smallest_step


DSO_DAMPING = Damping()
