"""Coarse to fine over the levels, for both engines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.alignment.shared.levenberg import NO_RESIDUALS, SINGULAR
from relocbench.arrays import Array

ABANDON_FACTOR = 1.5
"""a start is given up when its root mean energy on a level exceeds the best one's by this factor (DSO)"""


@dataclass(frozen=True)
class LevelOutcome:
    """How the alignment of one level ended."""

    level: int
    iterations: int
    energy: float
    """mean over the valid residuals"""
    valid: int
    saturated: int
    cutoff_factor: float
    """factor by which the cutoff was raised because too many residuals were saturated"""
    end: int
    """CONVERGED, ITERATIONS_SPENT, SINGULAR, NO_RESIDUALS or NOT_FINITE of ``shared.levenberg``"""


def failure_of(outcome: LevelOutcome, *estimate: Array) -> str:
    """Why the alignment failed on a level, in words; empty if it did not.

    Args:
        outcome: of the level.
        estimate: the arrays that were estimated, which must be finite.
    """
    if outcome.end == NO_RESIDUALS:
        return f"no point falls into the query on level {outcome.level}"
    if outcome.end == SINGULAR:
        return f"the normal equations are singular on level {outcome.level}"
    if not (np.isfinite(outcome.energy) and all(np.all(np.isfinite(part)) for part in estimate)):
        return f"the estimate is not finite on level {outcome.level}"
    return ""


class Descent:
    """One alignment on its way from a coarse level to the finest, one level after another.

    The first level whose cutoff had to be raised is repeated once. The way ends at the first failure.

    Args:
        coarsest: number of the first level; -1: there is no level.
    """

    def __init__(self, coarsest: int) -> None:
        self.level = coarsest
        """that is worked on next; -1 at the end"""
        self.outcomes: list[LevelOutcome] = []
        """in the order of work"""
        self.failure = ""
        """why the finest level was not reached; empty if it was, or while it still can be"""
        self.abandoned = False
        """whether the failure is that another start fits better"""
        self._repeated = False

    @property
    def ended(self) -> bool:
        return bool(self.failure) or self.level < 0

    def advance(self, outcome: LevelOutcome, failure: str) -> None:
        """Go on after the alignment of a level.

        Args:
            outcome: of the level.
            failure: in words why it failed, or an empty string.
        """
        self.failure = failure
        self.outcomes.append(outcome)
        if outcome.cutoff_factor > 1 and not self._repeated:
            self._repeated = True
        else:
            self.level -= 1

    def give_up(self) -> None:
        """End here, since another start fits better."""
        self.failure, self.abandoned = "another start fits better", True
