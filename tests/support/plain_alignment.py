"""Direct alignment in plain vectorised NumPy, written from the formulas alone.

It says what ``baselines.alignment.direct`` computes, and is what that is tested and timed against. Double precision.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.direct.settings import Settings
from baselines.alignment.shared.depth_map import LevelPoints
from baselines.alignment.shared.pyramid import SMALLEST_AREA, Level, level_camera
from relocbench.arrays import Array, Image, Mask
from relocbench.geometry import Camera, se3_exp

SCALE = np.array([1, 1, 1, 0.5, 0.5, 0.5, 10, 1000])
BORDER = 2


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Mean energy and normal equations at one pose."""

    energy: float
    valid: int
    saturated: int
    H: Array
    """(8, 8) mean w J J^T"""
    g: Array
    """(8,) mean w J r"""


def image_pyramid(image: Image, camera: Camera, max_levels: int = 6) -> list[Level]:
    """Grey image (H, W) -> maps of value, x and y derivative, finest first."""
    grey = image.astype(np.float32)
    levels: list[Level] = []
    while True:
        gradient = np.zeros((*grey.shape, 2), dtype=np.float32)
        gradient[1:-1, 1:-1, 0] = (grey[1:-1, 2:] - grey[1:-1, :-2]) / 2
        gradient[1:-1, 1:-1, 1] = (grey[2:, 1:-1] - grey[:-2, 1:-1]) / 2
        levels.append(Level(np.concatenate([grey[..., None], gradient], axis=-1), level_camera(camera, len(levels))))
        if len(levels) == max_levels or grey.size <= SMALLEST_AREA:
            return levels
        height, width = grey.shape[0] // 2 * 2, grey.shape[1] // 2 * 2
        grey = grey[:height, :width].reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3))


def projected(
    camera: Camera, points: NDArray[Any], T_query_ref: Array
) -> tuple[Mask, Array, Array, Array, Array, Array]:
    """Points in the query.

    Args:
        points: (3, N) normalised x, y and inverse depth in the reference camera.

    Returns:
        Which of them are in front of the camera and more than 2 px inside its image (N,), and of these the normalised
        x and y, the inverse depth and the pixel's u and v.
    """
    x, y, inverse_depth = points.astype(np.float64)
    rays = np.stack([x, y, np.ones_like(x)])
    moved = T_query_ref[:3, :3] @ rays + T_query_ref[:3, 3:] * inverse_depth
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v, i = moved[0] / moved[2], moved[1] / moved[2], inverse_depth / moved[2]
        px, py = camera.fx * u + camera.cx, camera.fy * v + camera.cy
        inside = (px > BORDER) & (py > BORDER) & (px < camera.width - 1 - BORDER) & (py < camera.height - 1 - BORDER)
        kept = inside & (i > 0)
    return kept, u[kept], v[kept], i[kept], px[kept], py[kept]


def linearize(
    level: Level,
    points: LevelPoints,
    T_query_ref: Array,
    a: float,
    b: float,
    huber: float,
    cutoff: float,
) -> NormalEquations:
    """Residuals (N,), robust weights, Jacobians (N, 8) and their products, all points at once."""
    camera = level.camera
    kept, u, v, i, px, py = projected(camera, points.points, T_query_ref)
    if not u.size:
        return NormalEquations(np.inf, 0, 0, np.zeros((8, 8)), np.zeros(8))

    value, gx, gy = bilinear(level.map, px, py).T
    reference = points.values[kept, 0].astype(np.float64)
    residual = value - (np.exp(a) * reference + b)
    gx, gy = gx * camera.fx, gy * camera.fy
    J = np.stack(
        [
            i * gx,
            i * gy,
            -i * (u * gx + v * gy),
            -(u * v * gx + (1 + v * v) * gy),
            u * v * gy + (1 + u * u) * gx,
            u * gy - v * gx,
            -np.exp(a) * reference,
            -np.ones_like(reference),
        ],
        axis=-1,
    )
    size = np.abs(residual)
    w = np.where(size < huber, 1.0, huber / np.maximum(size, huber))
    saturated = size > cutoff
    energy = np.where(saturated, 2 * huber * cutoff - huber**2, w * size**2 * (2 - w))
    weighted = J * np.where(saturated, 0.0, w)[:, None]
    count = size.size
    return NormalEquations(
        energy=float(energy.sum() / count),
        valid=count,
        saturated=int(saturated.sum()),
        H=weighted.T @ J / count,
        g=weighted.T @ residual / count,
    )


def bilinear(level_map: NDArray[np.floating], px: Array, py: Array) -> Array:
    """(H, W, C) looked up at N pixels -> (N, C)."""
    ix, iy = px.astype(int), py.astype(int)
    ax, ay = (px - ix)[:, None], (py - iy)[:, None]
    top = (1 - ax) * level_map[iy, ix] + ax * level_map[iy, ix + 1]
    bottom = (1 - ax) * level_map[iy + 1, ix] + ax * level_map[iy + 1, ix + 1]
    out: Array = (1 - ay) * top + ay * bottom
    return out


def align(
    reference: Sequence[LevelPoints], query: Sequence[Level], T_start: Array, settings: Settings
) -> tuple[Array, float, float, list[int]]:
    """T_query_ref, a, b and the iterations of each level worked on, coarsest first."""
    T, light, iterations = T_start, np.zeros(2), []
    level, repeated = min(len(reference), len(query)) - 1, False
    while level >= 0:
        cutoff = settings.cutoff if level < settings.cutoff_levels else np.inf
        limit = settings.iterations[min(level, len(settings.iterations) - 1)]
        T, light, factor, used = _minimise(query[level], reference[level], T, light, settings.huber, cutoff, limit)
        iterations.append(used)
        if factor > 1 and not repeated:
            repeated = True
            continue
        level -= 1
    return T, float(light[0]), float(light[1]), iterations


def _minimise(
    level: Level, points: LevelPoints, T: Array, light: Array, huber: float, base_cutoff: float, limit: int
) -> tuple[Array, Array, float, int]:
    factor, damping = 1.0, 0.01
    now = linearize(level, points, T, light[0], light[1], huber, base_cutoff)
    while now.saturated > 0.6 * now.valid and factor < 50:
        factor *= 2
        now = linearize(level, points, T, light[0], light[1], huber, base_cutoff * factor)
    for iteration in range(limit):
        H, g = now.H * np.outer(SCALE, SCALE), now.g * SCALE
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)), -g)
        if damping < 1e-3:
            step *= (1e-3 / damping) ** 0.25
        trial_T, trial_light = se3_exp((SCALE * step)[:6]) @ T, light + (SCALE * step)[6:]
        trial = linearize(level, points, trial_T, trial_light[0], trial_light[1], huber, base_cutoff * factor)
        if trial.energy < now.energy:
            T, light, now = trial_T, trial_light, trial
            damping /= 2
        else:
            damping = max(4 * damping, 1e-3)
        if np.linalg.norm(step) <= 1e-3:
            return T, light, factor, iteration + 1
    return T, light, factor, limit
