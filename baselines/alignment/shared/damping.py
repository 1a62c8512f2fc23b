"""The damping schedule of Levenberg-Marquardt."""

from __future__ import annotations

from dataclasses import dataclass

from relocbench.errors import MethodError


@dataclass(frozen=True)
class Damping:
    """Levenberg-Marquardt's schedule: (H + lambda diag H) d = -g. The defaults are those of DSO's tracker.

    Raises:
        MethodError: a factor that does not damp less after success and more after failure, or a negative number.
    """

    first: float = 0.01
    """lambda at the start of each level"""
    accepted: float = 0.5
    """lambda is multiplied by it when the mean energy fell"""
    rejected: float = 4.0
    """and by it when it did not"""
    floor: float = 0.001
    """a rejected step damps at least so much"""
    extrapolate_below: float = 0.001
    """with lambda below it the step is lengthened by (this / lambda)^(1/4); 0 for never"""
    smallest_step: float = 1e-3
    """norm of the step, in metres and half radians, at which a level is done"""

    def __post_init__(self) -> None:
        if not (self.first > 0 and 0 < self.accepted <= 1 < self.rejected and self.floor > 0):
            raise MethodError("damping needs first > 0, floor > 0, 0 < accepted <= 1 and rejected > 1")
        if not (self.extrapolate_below >= 0 and self.smallest_step >= 0):
            raise MethodError("damping needs extrapolate_below and smallest_step of at least 0")


DSO_DAMPING = Damping()
