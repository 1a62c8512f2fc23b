"""Alignment on feature maps in plain vectorised NumPy, written from the formulas alone.

It says what ``baselines.alignment.features`` computes, and is what that is tested and timed against. Double precision.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from plain_alignment import bilinear, projected

from baselines.alignment.features.pyramid import FeatureLevel, FeaturePyramid
from baselines.alignment.features.reference import FeaturePoints, ReferenceFeatures
from baselines.alignment.features.settings import FeatureSettings
from baselines.alignment.shared.damping import Damping
from relocbench.arrays import Array
from relocbench.geometry import se3_exp

SCALE = np.array([1, 1, 1, 0.5, 0.5, 0.5])
BORDER = 2


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Weighted mean energy and normal equations at one pose."""

    energy: float
    squares: float
    """mean omega w r^2 of what is not saturated"""
    weight: float
    """sum of omega over the valid residuals"""
    valid: int
    saturated: int
    H: Array
    """(6, 6) mean omega w J^T J"""
    g: Array
    """(6,) mean omega w J^T r"""


def linearize(
    level: FeatureLevel, points: FeaturePoints, T_query_ref: Array, huber: float, cutoff: float, per_channel: bool
) -> NormalEquations:
    """Residuals (N, D), Jacobians (N, D, 6) and their products, all points at once."""
    camera = level.camera
    kept, u, v, i, px, py = projected(camera, points.points, T_query_ref)
    if not u.size:
        return NormalEquations(np.inf, 0.0, 0.0, 0, 0, np.zeros((6, 6)), np.zeros(6))

    residual = bilinear(level.map, px, py) - points.values[kept].astype(np.float64)
    along_x = (bilinear(level.map, px + 1, py) - bilinear(level.map, px - 1, py)) / 2
    along_y = (bilinear(level.map, px, py + 1) - bilinear(level.map, px, py - 1)) / 2
    F_g = np.stack([along_x * camera.fx, along_y * camera.fy], axis=-1)
    zero = np.zeros_like(u)
    dp_dxi = np.stack(
        [
            np.stack([i, zero, -i * u, -u * v, 1 + u * u, -v], axis=-1),
            np.stack([zero, i, -i * v, -(1 + v * v), u * v, u], axis=-1),
        ],
        axis=1,
    )
    J = F_g @ dp_dxi

    size = np.abs(residual) if per_channel else np.linalg.norm(residual, axis=1, keepdims=True)
    omega = np.broadcast_to(points.weights[kept].astype(np.float64)[:, None], size.shape)
    w = np.where(size < huber, 1.0, huber / np.maximum(size, huber))
    saturated = size > cutoff
    energy = np.where(saturated, 2 * huber * cutoff - huber**2, w * size**2 * (2 - w))
    w = omega * np.where(saturated, 0.0, w)
    weight = float(omega.sum())
    flat = J.reshape(-1, 6)
    weighted = flat * np.broadcast_to(w, residual.shape).reshape(-1, 1)
    return NormalEquations(
        energy=float((omega * energy).sum() / weight),
        squares=float((w * size**2).sum() / weight),
        weight=weight,
        valid=size.size,
        saturated=int(saturated.sum()),
        H=weighted.T @ flat / weight,
        g=weighted.T @ residual.reshape(-1) / weight,
    )


def align(
    reference: ReferenceFeatures, query: FeaturePyramid, T_start: Array, settings: FeatureSettings
) -> tuple[Array, list[int]]:
    """T_query_ref and the iterations of each level worked on, coarsest first."""
    T, iterations = T_start, []
    level, repeated = min(len(reference), len(query)) - 1, False
    while level >= 0:
        points = reference.levels[level]
        T, factor, used = _minimise(query.levels[level], points, T, level, settings)
        iterations.append(used)
        if factor > 1 and not repeated:
            repeated = True
            continue
        level -= 1
    return T, iterations


def _minimise(
    level: FeatureLevel, points: FeaturePoints, T: Array, number: int, settings: FeatureSettings
) -> tuple[Array, float, int]:
    schedule: Damping = settings.damping
    huber, cutoff = settings.thresholds(points, number)
    factor, damping = 1.0, schedule.first
    now = linearize(level, points, T, huber, cutoff, settings.per_channel)
    while now.saturated > 0.6 * now.valid and factor < 50:
        factor *= 2
        now = linearize(level, points, T, huber, cutoff * factor, settings.per_channel)
    limit = settings.iterations_of(number)
    for iteration in range(limit):
        H, g = now.H * np.outer(SCALE, SCALE), now.g * SCALE
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)), -g)
        if damping < schedule.extrapolate_below:
            step *= (schedule.extrapolate_below / damping) ** 0.25
        trial_T = se3_exp(SCALE * step) @ T
        trial = linearize(level, points, trial_T, huber, cutoff * factor, settings.per_channel)
        if trial.energy < now.energy:
            T, now = trial_T, trial
            damping *= schedule.accepted
        else:
            damping = max(schedule.rejected * damping, schedule.floor)
        if np.linalg.norm(step) <= schedule.smallest_step:
            return T, factor, iteration + 1
    return T, factor, limit
