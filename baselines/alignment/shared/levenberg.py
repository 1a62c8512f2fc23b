"""What the Levenberg-Marquardt loops of both engines share: how a step is damped and taken, how a level ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.shared.small_matrices import product, se3_exp, solve_cholesky
from relocbench.kernels import njit

Array = NDArray[np.float64]
Room = tuple[Array, Array, Array, Array, Array]

CONVERGED, ITERATIONS_SPENT, SINGULAR, NO_RESIDUALS = 0, 1, 2, 3
"""how a level ended"""

SATURATED_SHARE = 0.6
"""with more residuals saturated the cutoff is doubled"""
CUTOFF_FACTOR_LIMIT = 50.0
SCALE = (1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 10.0, 1000.0)
"""unit of each unknown: translation (m), rotation (rad), a (log gain), b (offset)"""


@njit(cache=True)
def room_for_steps(n: int) -> Room:
    """The arrays that :func:`damped_step` and :func:`moved_pose` work in, for n unknowns."""
    return np.empty((n, n)), np.empty((n, n)), np.empty(n), np.empty(6), np.empty((4, 4))


@njit(cache=True)
def damped_step(H: Array, g: Array, damping: float, extrapolate_below: float, room: Room, step: Array) -> bool:
    """Solve (S H S + damping diag(S H S)) d = -S g, S = diag(SCALE), for the first n unknowns; d goes into step (n,).

    With less damping than ``extrapolate_below`` the step is lengthened by (extrapolate_below / damping)^(1/4), as in
    DSO's tracker. False when the matrix is not positive definite.

    Args:
        H: (n, n) or larger.
        g: (n,) or longer.
    """
    A, L, negative, _, _ = room
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
def moved_pose(step: Array, T: Array, room: Room, out: Array) -> None:
    """exp(S d) T for the pose's part of a step d, written to ``out`` (4, 4)."""
    _, _, _, xi, increment = room
    for i in range(6):
        xi[i] = SCALE[i] * step[i]
    se3_exp(xi, increment)
    product(increment, T, out)


@njit(cache=True)
def length(step: Array) -> float:
    """Norm of a step (n,), in the units of ``SCALE``."""
    squares = 0.0
    for i in range(len(step)):
        squares += step[i] * step[i]
    return float(np.sqrt(squares))
