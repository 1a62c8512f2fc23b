"""Levenberg-Marquardt on one pyramid level, compiled as a whole; both engines use it with their own residuals.

With the mean energy E, its normal equations H, g (:mod:`~baselines.alignment.shared.normal_equations`) and the units S
of the unknowns, an iteration solves

    (S H S + lambda diag(S H S)) d = -S g

and accepts the step S d if it lowers E. The loop allocates nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.shared.small_matrices import product, se3_exp, solve_cholesky
from relocbench.arrays import Array
from relocbench.kernels import njit

Workspace = tuple[Array, Array, Array, Array, Array]

CONVERGED, ITERATIONS_SPENT, SINGULAR, NO_RESIDUALS, NOT_FINITE = range(5)
"""how a level ended; NOT_FINITE: residuals or gradients at a pose are not finite"""

ENERGY, COUNT, SATURATED, NOT_FINITE_POINTS, SQUARES, WEIGHT = range(6)
"""places in the statistics (6,) of one linearization: the mean energy (infinite without a valid residual), the numbers
of valid residuals, of saturated ones among them and of points that are not finite, and what one engine adds"""
STATISTICS = 6

SATURATED_SHARE = 0.6
"""while a larger share of the residuals is saturated, the cutoff is doubled"""
CUTOFF_FACTOR_LIMIT = 50.0
SCALE = (1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 10.0, 1000.0)
"""S, the unit of each unknown: translation (m), rotation (rad), a (log gain), b (offset)"""


def linearize_at(
    problem: Any, T_query_ref: Array, brightness: Array, cutoff: float, H: Array, g: Array, statistics: Array
) -> None:
    """Write the normal equations and statistics of a problem at one estimate.

    Each engine compiles its own version of this for its own type of problem (``numba.extending.overload``).

    Args:
        problem: a named tuple: the map, the points, the intrinsics and the robust loss of one level.
        T_query_ref: (4, 4).
        brightness: (2,) a and b; without meaning to an engine that does not estimate them.
        cutoff: residuals beyond it are saturated.
        H: (n, n) out: mean w J J^T.
        g: (n,) out: mean w J r.
        statistics: (6,) out.
    """
    raise NotImplementedError


@njit(cache=True)
def minimise_level(
    problem: Any,
    T_start: Array,
    brightness_start: Array,
    unknowns: tuple[int, int],
    base_cutoff: float,
    max_iterations: int,
    schedule: tuple[float, float, float, float, float, float],
) -> tuple[Array, Array, Array, Array, int, float, int]:
    """Minimise the mean energy of one level from a start.

    Args:
        problem: see :func:`linearize_at`.
        T_start: (4, 4).
        brightness_start: (2,).
        unknowns: how many are solved for, and the size of the problem's H.
        base_cutoff: of the robust loss; doubled while more than 60 % of the residuals are saturated.
        max_iterations: at most so many.
        schedule: of :class:`~baselines.alignment.shared.damping.Damping`.

    Returns:
        T_query_ref (4, 4), brightness (2,), H and the statistics there, the number of iterations, the factor by which
        the cutoff was raised, and how the level ended.
    """
    damping, accepted, rejected, floor, extrapolate_below, smallest_step = schedule
    n, size = unknowns
    H, g, now = np.zeros((size, size)), np.zeros(size), np.zeros(STATISTICS)
    trial_H, trial_g, trial = np.zeros((size, size)), np.zeros(size), np.zeros(STATISTICS)
    T, trial_T = T_start.copy(), np.empty((4, 4))
    brightness, trial_brightness = brightness_start.copy(), brightness_start.copy()
    step = np.empty(n)
    workspace = np.empty((n, n)), np.empty((n, n)), np.empty(n), np.empty(6), np.empty((4, 4))

    factor = 1.0
    linearize_at(problem, T, brightness, base_cutoff, H, g, now)
    while now[SATURATED] > SATURATED_SHARE * now[COUNT] and factor < CUTOFF_FACTOR_LIMIT:
        factor *= 2.0
        linearize_at(problem, T, brightness, base_cutoff * factor, H, g, now)
    cutoff = base_cutoff * factor
    if now[COUNT] == 0:
        return T, brightness, H, now, 0, factor, NO_RESIDUALS
    if now[NOT_FINITE_POINTS] > 0:
        return T, brightness, H, now, 0, factor, NOT_FINITE

    for iteration in range(max_iterations):
        if not _damped_step(H, g, damping, extrapolate_below, workspace, step):
            return T, brightness, H, now, iteration, factor, SINGULAR
        _moved_pose(step, T, workspace, trial_T)
        for i in range(6, n):
            trial_brightness[i - 6] = brightness[i - 6] + SCALE[i] * step[i]
        linearize_at(problem, trial_T, trial_brightness, cutoff, trial_H, trial_g, trial)
        if trial[NOT_FINITE_POINTS] > 0:
            return trial_T, trial_brightness, trial_H, trial, iteration + 1, factor, NOT_FINITE
        if trial[ENERGY] < now[ENERGY]:
            T, trial_T = trial_T, T
            brightness, trial_brightness = trial_brightness, brightness
            H, trial_H = trial_H, H
            g, trial_g = trial_g, g
            now, trial = trial, now
            damping *= accepted
        else:
            damping = max(rejected * damping, floor)
        if not _length(step) > smallest_step:
            return T, brightness, H, now, iteration + 1, factor, CONVERGED
    return T, brightness, H, now, max_iterations, factor, ITERATIONS_SPENT


@njit(cache=True)
def minimise_level_from_each(
    problem: Any,
    T_starts: Array,
    size: int,
    base_cutoff: float,
    max_iterations: int,
    schedule: tuple[float, float, float, float, float, float],
) -> tuple[Array, Array, Array, NDArray[np.integer], Array, NDArray[np.integer]]:
    """As :func:`minimise_level`, of a problem that does not estimate brightness, from each of several starts.

    Args:
        problem: see :func:`linearize_at`.
        T_starts: (S, 4, 4).
        size: of the problem's H.
        base_cutoff, max_iterations, schedule: see :func:`minimise_level`.

    Returns:
        For each start T_query_ref (S, 4, 4), H (S, size, size) and the statistics (S, 6) there, the number of
        iterations (S,), the factor by which the cutoff was raised (S,), and how the level ended (S,).
    """
    starts = len(T_starts)
    T, H, statistics = np.empty((starts, 4, 4)), np.empty((starts, size, size)), np.empty((starts, STATISTICS))
    iterations, factors, ends = np.empty(starts, np.int64), np.empty(starts), np.empty(starts, np.int64)
    for i in range(starts):
        T[i], _, H[i], statistics[i], iterations[i], factors[i], ends[i] = minimise_level(
            problem, T_starts[i], np.zeros(2), (6, size), base_cutoff, max_iterations, schedule
        )
    return T, H, statistics, iterations, factors, ends


@njit(cache=True)
def _damped_step(
    H: Array, g: Array, damping: float, extrapolate_below: float, workspace: Workspace, step: Array
) -> bool:
    """Solve for the first n unknowns, d into ``step`` (n,); False when the matrix is not positive definite.

    With less damping than ``extrapolate_below`` the step is lengthened by (extrapolate_below / damping)^(1/4), as in
    DSO's tracker.
    """
    A, L, negative, _, _ = workspace
    n = len(step)
    for i in range(n):
        for j in range(n):
            A[i, j] = SCALE[i] * H[i, j] * SCALE[j]
        A[i, i] *= 1.0 + damping
        negative[i] = -SCALE[i] * g[i]
    if not solve_cholesky(A, negative, L, step):
        return False
    if damping < extrapolate_below:
        longer = (extrapolate_below / damping) ** 0.25
        for i in range(n):
            step[i] *= longer
    return True


@njit(cache=True)
def _moved_pose(step: Array, T: Array, workspace: Workspace, out: Array) -> None:
    """exp(S d) T for the pose's part of a step d, written to ``out`` (4, 4)."""
    _, _, _, xi, increment = workspace
    for i in range(6):
        xi[i] = SCALE[i] * step[i]
    se3_exp(xi, increment)
    product(increment, T, out)


@njit(cache=True)
def _length(step: Array) -> float:
    """The norm of a step (n,), in the units of ``SCALE``."""
    squares = 0.0
    for i in range(len(step)):
        squares += step[i] * step[i]
    return float(np.sqrt(squares))
