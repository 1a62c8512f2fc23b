"""Coarse-to-fine direct alignment: the levels one after another, and several starts against each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.direct.levenberg import minimise_level
from baselines.alignment.direct.settings import Settings
from baselines.alignment.shared.depth_map import LevelPoints
from baselines.alignment.shared.levels import LevelOutcome, best_of, coarse_to_fine, trouble_of
from baselines.alignment.shared.pyramid import Level, camera_intrinsics
from relocbench.errors import MethodError
from relocbench.geometry import compose

Array = NDArray[np.float64]


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
    abandoned: bool = False
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
        query: maps of each level, finest first.
        T_start: (4, 4) first guess of T_query_ref.
        settings: robust loss, iterations, brightness.
        rival: the best alignment so far from another start; this one is abandoned on the first level whose root mean
            energy is 1.5 times the rival's or more.

    Raises:
        MethodError: maps or points have more than one channel.
    """
    if any(points.values.shape[1] != 1 for points in reference) or any(level.channels != 1 for level in query):
        raise MethodError("direct alignment takes maps and points of one channel, feature alignment takes more")
    T, light = np.array(T_start, dtype=np.float64), np.zeros(2)

    def minimise(level: int) -> tuple[LevelOutcome, str]:
        nonlocal T, light
        T, light, outcome = _minimise(reference[level], query[level], level, T, light, settings)
        return outcome, trouble_of(outcome, T, light)

    coarsest = min(len(reference), len(query)) - 1
    walk = coarse_to_fine(coarsest, minimise, rival.outcomes if rival else ())
    size = len(reference[0])
    return Alignment(compose(T), light[0], light[1], walk.outcomes, size, walk.trouble, walk.abandoned)


def align_best(
    reference: Sequence[LevelPoints], query: Sequence[Level], starts: Sequence[Array], settings: Settings
) -> Alignment:
    """Align from every start; the lowest final energy wins. An alignment with trouble only if all have it.

    Raises:
        ValueError: no start.
    """
    return best_of(starts, lambda start, rival: align(reference, query, start, settings, rival))


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
        settings.cutoff_of(level),
        settings.affine,
        settings.iterations_of(level),
    )
    return T, light, LevelOutcome(level, iterations, energy, valid, saturated, factor, end)
