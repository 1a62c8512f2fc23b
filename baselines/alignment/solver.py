"""Coarse-to-fine direct alignment: the levels one after another, and several starts against each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.depth_map import LevelPoints
from baselines.alignment.levenberg import NO_RESIDUALS, SINGULAR, minimise_level
from baselines.alignment.pyramid import Level
from relocbench.errors import MethodError
from relocbench.geometry import Camera, compose

Array = NDArray[np.float64]

ABANDON_FACTOR = 1.5
"""a start whose residual on a level is so much above the best one's is given up (DSO)"""


@dataclass(frozen=True)
class Settings:
    """What the solver can be told; the defaults are DSO's but for ``cutoff_levels``.

    Raises:
        MethodError: the cutoff is below the Huber threshold: a saturated residual would cost less than one that fits.
    """

    huber: float = 9.0
    """in units of the values: below it the loss is quadratic, above linear"""
    cutoff: float = 20.0
    """in units of the values: above it a residual has constant energy and no say in the step"""
    cutoff_levels: int = 1
    """the cutoff holds on so many of the finest levels; coarser ones have none. DSO has it on all: there the start is
    a motion model's. From a start metres off, half of the right residuals would be cut off before they could pull"""
    iterations: tuple[int, ...] = (10, 20, 50, 50, 50)
    """at most so many, finest level first; the last holds for all coarser levels"""
    affine: bool = True
    """estimate gain and offset of the brightness; one channel only"""
    per_channel: bool = False
    """with several channels: robust loss on each channel's residual, else on the norm over all channels"""

    def __post_init__(self) -> None:
        if not 0 < self.huber <= self.cutoff:
            raise MethodError(f"cutoff ({self.cutoff}) must be at least huber ({self.huber}), both positive")


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
    """CONVERGED, ITERATIONS_SPENT, SINGULAR or NO_RESIDUALS of ``levenberg``"""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where the alignment ended."""

    T_query_ref: Array
    """(4, 4)"""
    a: float
    """log gain: I_query = exp(a) I_ref + b"""
    b: float
    """offset, in units of the values"""
    outcomes: tuple[LevelOutcome, ...]
    """in the order of work, coarsest level first; a level repeated with the base cutoff comes twice"""
    points: int
    """of the finest level, valid or not"""
    trouble: str = ""
    """why there is no answer; empty if there is one"""
    abandoned: bool = field(default=False)
    """given up because another start was clearly better"""

    @property
    def final(self) -> LevelOutcome:
        """The last level worked on."""
        return self.outcomes[-1]


def align(
    reference: Sequence[LevelPoints],
    query: Sequence[Level],
    T_start: Array,
    settings: Settings,
    rival: Alignment | None = None,
) -> Alignment:
    """Align from one start, coarsest common level first.

    Args:
        reference: points of each level, finest first.
        query: maps of each level, finest first, with as many channels.
        T_start: (4, 4) first guess of T_query_ref.
        settings: robust loss, iterations, brightness.
        rival: the best alignment so far from another start; this one is abandoned on the first level whose root mean
            energy is 1.5 times the rival's or more.
    """
    T, light = np.array(T_start, dtype=np.float64), np.zeros(2)

    def minimise(level: int) -> tuple[LevelOutcome, str]:
        nonlocal T, light
        T, light, outcome = _minimise(reference[level], query[level], level, T, light, settings)
        return outcome, _trouble(outcome, T, light)

    coarsest = min(len(reference), len(query)) - 1
    walk = coarse_to_fine(coarsest, minimise, rival.outcomes if rival else ())
    size = len(reference[0])
    return Alignment(compose(T), light[0], light[1], walk.outcomes, size, walk.trouble, walk.abandoned)


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


def align_best(
    reference: Sequence[LevelPoints], query: Sequence[Level], starts: Sequence[Array], settings: Settings
) -> Alignment:
    """Align from every start; the lowest final energy wins. An alignment with trouble only if all have it.

    Raises:
        ValueError: no start.
    """
    return best_of(starts, lambda start, rival: align(reference, query, start, settings, rival))


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


def camera_intrinsics(camera: Camera) -> Array:
    """(4,) fx, fy, cx, cy."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float64)


def _minimise(
    reference: LevelPoints, query: Level, level: int, T: Array, light: Array, settings: Settings
) -> tuple[Array, Array, LevelOutcome]:
    T, light, energy, valid, saturated, iterations, factor, end = minimise_level(
        query.map,
        reference.points,
        reference.values,
        camera_intrinsics(query.camera),
        T,
        light,
        settings.huber,
        settings.cutoff if level < settings.cutoff_levels else np.inf,
        settings.per_channel,
        settings.affine,
        settings.iterations[min(level, len(settings.iterations) - 1)],
    )
    return T, light, LevelOutcome(level, iterations, energy, valid, saturated, factor, end)


def _trouble(outcome: LevelOutcome, T: Array, light: Array) -> str:
    if outcome.end == NO_RESIDUALS:
        return f"no point falls into the query on pyramid level {outcome.level}"
    if outcome.end == SINGULAR:
        return f"the normal equations are singular on pyramid level {outcome.level}"
    if not (np.all(np.isfinite(T)) and np.all(np.isfinite(light)) and np.isfinite(outcome.energy)):
        return f"the estimate is not finite on pyramid level {outcome.level}"
    return ""
