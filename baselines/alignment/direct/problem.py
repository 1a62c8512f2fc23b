"""The problem that Levenberg-Marquardt solves on one level of intensities."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload

from baselines.alignment.direct.kernel import linearize
from baselines.alignment.shared.compiled import FloatArray
from baselines.alignment.shared.levenberg import COUNT, ENERGY, SATURATED, linearize_at
from relocbench.arrays import Array


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
