"""The problem that Levenberg-Marquardt solves on one level of feature maps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from numba import types
from numba.extending import overload

from baselines.alignment.features.kernel import linearize_features
from baselines.alignment.shared.compiled import FloatArray
from baselines.alignment.shared.levenberg import linearize_at
from relocbench.arrays import Array


class FeatureProblem(NamedTuple):
    """One level; the fields are arguments of :func:`baselines.alignment.features.kernel.linearize_features`."""

    level_map: FloatArray
    points: FloatArray
    values: FloatArray
    weights: FloatArray
    intrinsics: Array
    huber: float
    per_channel: bool
    workspace: tuple[FloatArray, FloatArray, FloatArray]


@overload(linearize_at)
def _linearize_features(
    problem: Any, T_query_ref: Any, brightness: Any, cutoff: Any, H: Any, g: Any, statistics: Any
) -> Callable[..., None] | None:
    if not (isinstance(problem, types.NamedTuple) and problem.instance_class is FeatureProblem):
        return None

    def compiled(problem: Any, T_query_ref: Any, brightness: Any, cutoff: Any, H: Any, g: Any, statistics: Any) -> None:
        level_map, points, values, weights, intrinsics, huber, per_channel, workspace = problem
        linearize_features(
            level_map, points, values, weights, intrinsics, T_query_ref, huber, cutoff, per_channel, workspace,
            H, g, statistics,
        )  # fmt: skip

    return compiled
