"""Levenberg-Marquardt on one pyramid level, with the damping schedule of DSO's tracker, compiled as a whole."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.direct.kernel import linearize
from baselines.alignment.shared.compiled import FloatArray
from baselines.alignment.shared.damping import DSO_DAMPING
from baselines.alignment.shared.levenberg import (
    CONVERGED,
    CUTOFF_FACTOR_LIMIT,
    ITERATIONS_SPENT,
    NO_RESIDUALS,
    SATURATED_SHARE,
    SCALE,
    SINGULAR,
    damped_step,
    length,
    moved_pose,
    room_for_steps,
)
from relocbench.kernels import njit

Array = NDArray[np.float64]

FIRST, ACCEPTED, REJECTED, FLOOR, EXTRAPOLATE_BELOW, SMALLEST_STEP = astuple(DSO_DAMPING)


@njit(cache=True)
def minimise_level(
    level_map: FloatArray,
    points: FloatArray,
    values: FloatArray,
    intrinsics: Array,
    T_start: Array,
    light_start: Array,
    huber: float,
    base_cutoff: float,
    affine: bool,
    max_iterations: int,
) -> tuple[Array, Array, float, int, int, int, float, int]:
    """Minimise the mean energy of one level from a start.

    Arguments as for :func:`baselines.alignment.direct.kernel.linearize`; ``light_start`` is (a, b), the gain being
    exp(a); without ``affine`` both stay. While more than 60 % of the residuals are saturated the cutoff is doubled.

    Returns:
        T_query_ref (4, 4), (a, b), mean energy, valid residuals, saturated ones, iterations, the factor by which
        the cutoff was raised, how it ended (CONVERGED, ITERATIONS_SPENT, SINGULAR, NO_RESIDUALS).
    """
    n = 8 if affine else 6
    H, g, step, room = np.zeros((8, 8)), np.zeros(8), np.zeros(n), room_for_steps(n)
    trial_H, trial_g = np.zeros((8, 8)), np.zeros(8)
    T, trial_T = T_start.copy(), np.empty((4, 4))
    light, trial_light = light_start.copy(), light_start.copy()
    gain_offset = np.array([np.exp(light[0]), light[1]])

    factor = 1.0
    energy, valid, saturated = linearize(
        level_map, points, values, intrinsics, T, gain_offset, huber, base_cutoff, H, g
    )
    while saturated > SATURATED_SHARE * valid and factor < CUTOFF_FACTOR_LIMIT:
        factor *= 2.0
        cutoff = base_cutoff * factor
        energy, valid, saturated = linearize(level_map, points, values, intrinsics, T, gain_offset, huber, cutoff, H, g)
    cutoff = base_cutoff * factor
    if valid == 0:
        return T, light, energy, valid, saturated, 0, factor, NO_RESIDUALS

    damping = FIRST
    for iteration in range(max_iterations):
        if not damped_step(H, g, damping, EXTRAPOLATE_BELOW, room, step):
            return T, light, energy, valid, saturated, iteration, factor, SINGULAR
        moved_pose(step, T, room, trial_T)
        if affine:
            trial_light[0] = light[0] + SCALE[6] * step[6]
            trial_light[1] = light[1] + SCALE[7] * step[7]
        gain_offset[0], gain_offset[1] = np.exp(trial_light[0]), trial_light[1]
        trial_energy, trial_valid, trial_saturated = linearize(
            level_map, points, values, intrinsics, trial_T, gain_offset, huber, cutoff, trial_H, trial_g
        )
        if trial_energy < energy:
            energy, valid, saturated = trial_energy, trial_valid, trial_saturated
            T, trial_T = trial_T, T
            light, trial_light = trial_light, light
            H, trial_H = trial_H, H
            g, trial_g = trial_g, g
            damping *= ACCEPTED
        else:
            damping = max(REJECTED * damping, FLOOR)
        if not length(step) > SMALLEST_STEP:
            return T, light, energy, valid, saturated, iteration + 1, factor, CONVERGED
    return T, light, energy, valid, saturated, max_iterations, factor, ITERATIONS_SPENT
