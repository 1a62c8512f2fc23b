"""Coarse-to-fine direct alignment from one start, and the best of several starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload

from baselines.alignment.direct.kernel import linearize
from baselines.alignment.direct.settings import Settings
from baselines.alignment.shared.compiled import FloatArray
from baselines.alignment.shared.damping import DSO_DAMPING
from baselines.alignment.shared.depth_map import LevelPoints
from baselines.alignment.shared.levels import ABANDON_FACTOR, Descent, LevelOutcome, failure_of
from baselines.alignment.shared.levenberg import COUNT, ENERGY, SATURATED, linearize_at, minimise_level
from baselines.alignment.shared.pyramid import Level, camera_intrinsics
from relocbench.arrays import Array
from relocbench.errors import MethodError
from relocbench.geometry import compose


class DirectProblem(NamedTuple):
    """One level; the fields are arguments of :func:`baselines.alignment.direct.kernel.linearize`."""

    level_map: FloatArray
    points: FloatArray
    values: FloatArray
    intrinsics: Array
    huber: float
    gain_offset: Array
    """(2,) workspace for exp(a) and b"""


@overload(linearize_at)
def _linearize_direct(
    problem: Any, T_query_ref: Any, brightness: Any, cutoff: Any, H: Any, g: Any, statistics: Any
) -> Callable[..., None] | None:
    if not (isinstance(problem, types.NamedTuple) and problem.instance_class is DirectProblem):
        return None

    def compiled(problem: Any, T_query_ref: Any, brightness: Any, cutoff: Any, H: Any, g: Any, statistics: Any) -> None:
        level_map, points, values, intrinsics, huber, gain_offset = problem
        gain_offset[0], gain_offset[1] = np.exp(brightness[0]), brightness[1]
        statistics[ENERGY], statistics[COUNT], statistics[SATURATED] = linearize(
            level_map, points, values, intrinsics, T_query_ref, gain_offset, huber, cutoff, H, g
        )

    return compiled


@dataclass(frozen=True, eq=False)
class Alignment:
    """The result of an alignment."""

    T_query_ref: Array
    """(4, 4)"""
    a: float
    """log gain in I_query = exp(a) I_ref + b"""
    b: float
    """offset, in units of the values"""
    outcomes: tuple[LevelOutcome, ...]
    """in the order of work, coarsest level first; a level that is repeated with the base cutoff occurs twice"""
    points: int
    """number on the finest level, valid or not"""
    failure: str = ""
    """why there is no pose; empty if there is one"""
    abandoned: bool = False
    """the alignment was given up because another start was clearly better"""

    @property
    def final(self) -> LevelOutcome:
        """The outcome of the last level worked on."""
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
        query: maps of each level, finest first.
        T_start: (4, 4) first guess of T_query_ref.
        rival: the best alignment so far from another start; this one is abandoned on the first level whose root mean
            energy is 1.5 times the rival's or more.

    Raises:
        MethodError: maps or points have more than one channel.
    """
    if any(points.values.shape[1] != 1 for points in reference) or any(level.channels != 1 for level in query):
        raise MethodError("direct alignment takes maps and points of one channel, feature alignment takes more")
    T, brightness = np.array(T_start, dtype=np.float64), np.zeros(2)
    rival_energy = {outcome.level: outcome.energy for outcome in rival.outcomes} if rival else {}
    walk = Descent(min(len(reference), len(query)) - 1)
    while not walk.ended:
        level = walk.level
        T, brightness, outcome = _minimise(reference[level], query[level], level, T, brightness, settings)
        walk.advance(outcome, failure_of(outcome, T, brightness))
        if not walk.failure and outcome.energy > ABANDON_FACTOR**2 * rival_energy.get(level, np.inf):
            walk.give_up()
    size = len(reference[0])
    return Alignment(compose(T), brightness[0], brightness[1], tuple(walk.outcomes), size, walk.failure, walk.abandoned)


def align_best(
    reference: Sequence[LevelPoints], query: Sequence[Level], starts: Sequence[Array], settings: Settings
) -> Alignment:
    """Align from every start and return the alignment of lowest final energy.

    A failed alignment is returned only if all of them failed.

    Raises:
        ValueError: there is no start.
    """
    if not starts:
        raise ValueError("an alignment needs at least one start")
    best = align(reference, query, starts[0], settings)
    for start in starts[1:]:
        found = align(reference, query, start, settings, None if best.failure else best)
        if not found.failure and (best.failure or found.final.energy < best.final.energy):
            best = found
    return best


def _minimise(
    reference: LevelPoints, query: Level, level: int, T: Array, brightness: Array, settings: Settings
) -> tuple[Array, Array, LevelOutcome]:
    problem = DirectProblem(
        query.map, reference.points, reference.values, camera_intrinsics(query.camera), settings.huber, np.empty(2)
    )
    T, brightness, _, statistics, iterations, factor, end = minimise_level(
        problem,
        T,
        brightness,
        (8 if settings.affine else 6, 8),
        settings.cutoff_of(level),
        settings.iterations_of(level),
        DSO_DAMPING.schedule,
    )
    valid, saturated = int(statistics[COUNT]), int(statistics[SATURATED])
    return T, brightness, LevelOutcome(level, iterations, float(statistics[ENERGY]), valid, saturated, factor, end)
