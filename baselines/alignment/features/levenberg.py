"""Levenberg-Marquardt on one level of feature maps, compiled as a whole; its loop allocates nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.features.kernel import (
    COUNT,
    ENERGY,
    NOT_FINITE,
    SATURATED,
    STATISTICS,
    linearize_features,
    working_room,
)
from baselines.alignment.shared.compiled import FloatArray
from baselines.alignment.shared.levenberg import (
    CONVERGED,
    CUTOFF_FACTOR_LIMIT,
    ITERATIONS_SPENT,
    NO_RESIDUALS,
    SATURATED_SHARE,
    SINGULAR,
    damped_step,
    length,
    moved_pose,
    room_for_steps,
)
from relocbench.kernels import njit

Array = NDArray[np.float64]

FEATURES_NOT_FINITE = 4
"""how a level ended, beside those of ``shared.levenberg``"""


@njit(cache=True)
def minimise_feature_level(
    level_map: FloatArray,
    points: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    intrinsics: Array,
    T_start: Array,
    huber: float,
    base_cutoff: float,
    per_channel: bool,
    max_iterations: int,
    damping_schedule: tuple[float, float, float, float, float, float],
) -> tuple[Array, Array, Array, int, float, int]:
    """Minimise the mean energy of one level from a start.

    Arguments as for :func:`baselines.alignment.features.kernel.linearize_features`; ``damping_schedule`` holds the
    fields of :class:`baselines.alignment.shared.damping.Damping` in their order. While more than 60 % of the
    residuals are saturated the cutoff is doubled. Features that are not finite where a point looks end the level.

    Returns:
        T_query_ref (4, 4), H (6, 6) and statistics (6,) there, iterations, the factor by which the cutoff was
        raised, how it ended (CONVERGED, ITERATIONS_SPENT, SINGULAR, NO_RESIDUALS, FEATURES_NOT_FINITE).
    """
    damping, accepted, rejected, floor, extrapolate_below, smallest_step = damping_schedule
    room = working_room(points)
    H, g, now = np.zeros((6, 6)), np.zeros(6), np.zeros(STATISTICS)
    trial_H, trial_g, trial = np.zeros((6, 6)), np.zeros(6), np.zeros(STATISTICS)
    T, trial_T, step, step_room = T_start.copy(), np.empty((4, 4)), np.empty(6), room_for_steps(6)

    factor = 1.0
    linearize_features(
        level_map, points, values, weights, intrinsics, T, huber, base_cutoff, per_channel, room, H, g, now
    )
    while now[SATURATED] > SATURATED_SHARE * now[COUNT] and factor < CUTOFF_FACTOR_LIMIT:
        factor *= 2.0
        cutoff = base_cutoff * factor
        linearize_features(
            level_map, points, values, weights, intrinsics, T, huber, cutoff, per_channel, room, H, g, now
        )
    cutoff = base_cutoff * factor
    if now[COUNT] == 0:
        return T, H, now, 0, factor, NO_RESIDUALS
    if now[NOT_FINITE] > 0:
        return T, H, now, 0, factor, FEATURES_NOT_FINITE

    for iteration in range(max_iterations):
        if not damped_step(H, g, damping, extrapolate_below, step_room, step):
            return T, H, now, iteration, factor, SINGULAR
        moved_pose(step, T, step_room, trial_T)
        linearize_features(
            level_map,
            points,
            values,
            weights,
            intrinsics,
            trial_T,
            huber,
            cutoff,
            per_channel,
            room,
            trial_H,
            trial_g,
            trial,
        )
        if trial[NOT_FINITE] > 0:
            return trial_T, trial_H, trial, iteration + 1, factor, FEATURES_NOT_FINITE
        if trial[ENERGY] < now[ENERGY]:
            T, trial_T = trial_T, T
            H, trial_H = trial_H, H
            g, trial_g = trial_g, g
            now, trial = trial, now
            damping *= accepted
        else:
            damping = max(rejected * damping, floor)
        if not length(step) > smallest_step:
            return T, H, now, iteration + 1, factor, CONVERGED
    return T, H, now, max_iterations, factor, ITERATIONS_SPENT
