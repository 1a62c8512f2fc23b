"""The levels one after another, and several starts against each other, whatever the engine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.shared.levenberg import NO_RESIDUALS, SINGULAR

Array = NDArray[np.float64]

ABANDON_FACTOR = 1.5
"""a start whose residual on a level is so much above the best one's is given up (DSO)"""


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
    """by which the cutoff was raised because too many residuals were saturated"""
    end: int
    """CONVERGED, ITERATIONS_SPENT, SINGULAR or NO_RESIDUALS of ``shared.levenberg``, or what an engine adds"""


def trouble_of(outcome: LevelOutcome, *estimate: Array) -> str:
    """Why the way ends on a level: nothing to see, nothing to solve, or an estimate that is not finite; else empty."""
    if outcome.end == NO_RESIDUALS:
        return f"no point falls into the query on level {outcome.level}"
    if outcome.end == SINGULAR:
        return f"the normal equations are singular on level {outcome.level}"
    if not (np.isfinite(outcome.energy) and all(np.all(np.isfinite(part)) for part in estimate)):
        return f"the estimate is not finite on level {outcome.level}"
    return ""


@dataclass(frozen=True)
class Walk:
    """How the way down the levels went."""

    outcomes: tuple[LevelOutcome, ...]
    """in the order of work"""
    trouble: str
    """why it ended early; empty if it reached the finest level"""
    abandoned: bool
    """the trouble is that a rival fits clearly better"""


def coarse_to_fine(
    coarsest: int, minimise: Callable[[int], tuple[LevelOutcome, str]], rival: Sequence[LevelOutcome] = ()
) -> Walk:
    """Work on one level after another, from ``coarsest`` to 0.

    The first level whose cutoff had to be raised is repeated once. The way ends at the first trouble, or on a level
    where the root mean energy is 1.5 times the rival's or more.

    Args:
        coarsest: number of the first level; -1 leaves nothing to do.
        minimise: aligns one level from where the last one ended; its outcome, and its trouble or an empty string.
        rival: outcomes of the best alignment so far from another start.
    """
    rival_energy = {outcome.level: outcome.energy for outcome in rival}
    outcomes: list[LevelOutcome] = []
    repeated = False
    level = coarsest
    while level >= 0:
        outcome, trouble = minimise(level)
        outcomes.append(outcome)
        if trouble:
            return Walk(tuple(outcomes), trouble, abandoned=False)
        if outcome.energy > ABANDON_FACTOR**2 * rival_energy.get(level, np.inf):
            return Walk(tuple(outcomes), "another start fits clearly better", abandoned=True)
        if outcome.cutoff_factor > 1 and not repeated:
            repeated = True
            continue
        level -= 1
    return Walk(tuple(outcomes), "", abandoned=False)


class Attempt(Protocol):
    """What an alignment from one start tells those from other starts."""

    @property
    def trouble(self) -> str: ...
    @property
    def final(self) -> LevelOutcome: ...


AnyAttempt = TypeVar("AnyAttempt", bound=Attempt)
AnyStart = TypeVar("AnyStart")


def best_of(starts: Sequence[AnyStart], attempt: Callable[[AnyStart, AnyAttempt | None], AnyAttempt]) -> AnyAttempt:
    """Attempt every start, telling each the best so far; the lowest final energy wins, trouble loses to any answer.

    Raises:
        ValueError: no start.
    """
    if not starts:
        raise ValueError("an alignment needs at least one start")
    best = attempt(starts[0], None)
    for start in starts[1:]:
        candidate = attempt(start, None if best.trouble else best)
        if not candidate.trouble and (best.trouble or candidate.final.energy < best.final.energy):
            best = candidate
    return best
