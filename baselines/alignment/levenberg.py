"""Levenberg-Marquardt on one pyramid level, with the damping schedule of DSO's tracker, compiled as a whole."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from baselines.alignment.kernel import FloatArray, linearize

Array = NDArray[np.float64]

CONVERGED, ITERATIONS_SPENT, SINGULAR, NO_RESIDUALS = 0, 1, 2, 3
"""how a level ended"""

FIRST_DAMPING = 0.01
DAMPING_LIMIT = 0.001
"""below it steps are extrapolated; a rejected step damps at least so much"""
SMALLEST_STEP = 1e-3
"""norm of the scaled step at which a level is done"""
SATURATED_SHARE = 0.6
"""with more residuals saturated the cutoff is doubled"""
CUTOFF_FACTOR_LIMIT = 50.0
SCALE = (1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 10.0, 1000.0)
"""unit of each unknown: translation (m), rotation (rad), a (log gain), b (offset)"""


@njit(cache=True)
def se3_exp(xi: Array) -> Array:
    """exp of a twist (rho, phi): [[exp(phi^), V(phi) rho], [0, 1]], (6,) -> (4, 4)."""
    out = np.empty((4, 4))
    se3_exp_into(xi, out)
    return out


@njit(cache=True)
def se3_exp_into(xi: Array, out: Array) -> None:
    """As :func:`se3_exp`, written to ``out`` (4, 4); allocates nothing."""
    theta2 = xi[3] * xi[3] + xi[4] * xi[4] + xi[5] * xi[5]
    theta = np.sqrt(theta2)
    if theta < 1e-3:  # sin(t)/t, (1 - cos t)/t^2 and (t - sin t)/t^3 to the last bit
        a, b, c = 1 - theta2 / 6 * (1 - theta2 / 20), 0.5 - theta2 / 24, 1 / 6 - theta2 / 120
    else:
        a = np.sin(theta) / theta
        b = 2 * (np.sin(theta / 2) / theta) ** 2
        c = (theta - np.sin(theta)) / (theta2 * theta)
    W = ((0.0, -xi[5], xi[4]), (xi[5], 0.0, -xi[3]), (-xi[4], xi[3], 0.0))
    for i in range(4):
        for j in range(4):
            out[i, j] = 1.0 if i == j else 0.0
    for i in range(3):
        for j in range(3):
            w2 = W[i][0] * W[0][j] + W[i][1] * W[1][j] + W[i][2] * W[2][j]
            out[i, j] += a * W[i][j] + b * w2
            out[i, 3] += (b * W[i][j] + c * w2) * xi[j]
        out[i, 3] += xi[i]


@njit(cache=True)
def _product(A: Array, B: Array) -> Array:
    out = np.empty((4, 4))
    product_into(A, B, out)
    return out


@njit(cache=True)
def product_into(A: Array, B: Array, out: Array) -> None:
    """A @ B, all (4, 4), written to ``out``, which is neither of the two."""
    for i in range(4):
        for j in range(4):
            out[i, j] = 0.0
            for k in range(4):
                out[i, j] += A[i, k] * B[k, j]


@njit(cache=True)
def solve_cholesky(A: Array, b: Array, n: int, x: Array) -> bool:
    """Solve the leading n x n part of A x = b, A symmetric. False when A is not positive definite."""
    return solve_cholesky_with(A, b, n, np.empty((n, n)), x)


@njit(cache=True)
def solve_cholesky_with(A: Array, b: Array, n: int, L: Array, x: Array) -> bool:
    """As :func:`solve_cholesky`; the lower triangle of L (n, n) is room to work in."""
    for i in range(n):
        for j in range(i + 1):
            rest = A[i, j]
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            if i != j:
                L[i, j] = rest / L[j, j]
            elif rest > 0.0:  # false for NaN as well
                L[i, i] = np.sqrt(rest)
            else:
                return False
    for i in range(n):
        x[i] = b[i]
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]
    return True


@njit(cache=True)
def _damped_step(H: Array, g: Array, damping: float, n: int, step: Array) -> bool:
    """Solve (S H S + damping diag) d = -S g, S = diag(SCALE), into step[:n]; extrapolated at low damping."""
    A = np.empty((8, 8))
    negative = np.empty(8)
    for i in range(n):
        for j in range(n):
            A[i, j] = SCALE[i] * H[i, j] * SCALE[j]
        A[i, i] *= 1.0 + damping
        negative[i] = -SCALE[i] * g[i]
    if not solve_cholesky(A, negative, n, step):
        return False
    if damping < DAMPING_LIMIT:
        extrapolation = (DAMPING_LIMIT / damping) ** 0.25
        for i in range(n):
            step[i] *= extrapolation
    return True


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
    per_channel: bool,
    affine: bool,
    max_iterations: int,
) -> tuple[Array, Array, float, int, int, int, float, int]:
    """Minimise the mean energy of one level from a start.

    Arguments as for :func:`baselines.alignment.kernel.linearize`; ``light_start`` is (a, b), the gain being exp(a);
    without ``affine`` both stay. While more than 60 % of the residuals are saturated the cutoff is doubled.

    Returns:
        T_query_ref (4, 4), (a, b), mean energy, valid residuals, saturated ones, iterations, the factor by which
        the cutoff was raised, how it ended (CONVERGED, ITERATIONS_SPENT, SINGULAR, NO_RESIDUALS).
    """
    n = 8 if affine else 6
    H, g, step, xi = np.zeros((8, 8)), np.zeros(8), np.zeros(8), np.zeros(6)
    trial_H, trial_g = np.zeros((8, 8)), np.zeros(8)
    T, light = T_start.copy(), light_start.copy()
    gain_offset = np.array([np.exp(light[0]), light[1]])

    factor = 1.0
    energy, valid, saturated = linearize(
        level_map, points, values, intrinsics, T, gain_offset, huber, base_cutoff, per_channel, H, g
    )
    while saturated > SATURATED_SHARE * valid and factor < CUTOFF_FACTOR_LIMIT:
        factor *= 2.0
        cutoff = base_cutoff * factor
        energy, valid, saturated = linearize(
            level_map, points, values, intrinsics, T, gain_offset, huber, cutoff, per_channel, H, g
        )
    cutoff = base_cutoff * factor
    if valid == 0:
        return T, light, energy, valid, saturated, 0, factor, NO_RESIDUALS

    damping = FIRST_DAMPING
    for iteration in range(max_iterations):
        if not _damped_step(H, g, damping, n, step):
            return T, light, energy, valid, saturated, iteration, factor, SINGULAR
        for i in range(6):
            xi[i] = SCALE[i] * step[i]
        trial_T = _product(se3_exp(xi), T)
        trial_light = light.copy()
        if affine:
            trial_light[0] += SCALE[6] * step[6]
            trial_light[1] += SCALE[7] * step[7]
        gain_offset[0], gain_offset[1] = np.exp(trial_light[0]), trial_light[1]
        trial_energy, trial_valid, trial_saturated = linearize(
            level_map,
            points,
            values,
            intrinsics,
            trial_T,
            gain_offset,
            huber,
            cutoff,
            per_channel,
            trial_H,
            trial_g,
        )
        if trial_energy < energy:
            T, light = trial_T, trial_light
            energy, valid, saturated = trial_energy, trial_valid, trial_saturated
            H, trial_H = trial_H, H
            g, trial_g = trial_g, g
            damping *= 0.5
        else:
            damping = max(4.0 * damping, DAMPING_LIMIT)
        if not np.linalg.norm(step[:n]) > SMALLEST_STEP:
            return T, light, energy, valid, saturated, iteration + 1, factor, CONVERGED
    return T, light, energy, valid, saturated, max_iterations, factor, ITERATIONS_SPENT
