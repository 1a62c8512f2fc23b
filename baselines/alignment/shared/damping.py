"""The damping schedule of Levenberg-Marquardt."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from functools import cached_property

from relocbench.errors import MethodError


@dataclass(frozen=True)
class Damping:
    """How lambda changes in (H + lambda diag H) d = -g. The defaults are those of DSO's tracker.

    Raises:
        MethodError: damping would not decrease after success and increase after failure, or a number is negative.
    """

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

    def __post_init__(self) -> None:
        if not (self.first > 0 and 0 < self.accepted <= 1 < self.rejected and self.floor > 0):
            raise MethodError("damping needs first > 0, floor > 0, 0 < accepted <= 1 and rejected > 1")
        if not (self.extrapolate_below >= 0 and self.smallest_step >= 0):
            raise MethodError("damping needs extrapolate_below and smallest_step of at least 0")

    @cached_property
    def schedule(self) -> tuple[float, float, float, float, float, float]:
        """The fields in their order, for compiled functions."""
        first, accepted, rejected, floor, extrapolate_below, smallest_step = astuple(self)
        return first, accepted, rejected, floor, extrapolate_below, smallest_step


DSO_DAMPING = Damping()
