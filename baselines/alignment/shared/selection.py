"""DSO's choice of pixels: evenly spread and of large gradient, denser in textured parts of the image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.shared.pyramid import Level
from relocbench.arrays import Floats, Indices, Mask
from relocbench.kernels import njit
from relocbench.tracking import KeyframePoints, Reference

BLOCK = 32
"""pixels; side of the blocks that each have a threshold"""
THRESHOLD_OVER_MEDIAN = 7.0
"""grey levels per pixel"""
COARSER_CELL_FACTOR = 0.75
"""factor of the threshold for cells twice as large"""
LARGEST_BIN = 49
KEPT_BORDER = 4
"""pixels"""
FIRST_CELL = 4
"""pixels; side of the smallest cells in the first try"""
MAX_TRIES = 8
DIRECTIONS = 16


def choose_points(reference: Reference, levels: list[Level], count: int, rng: np.random.Generator) -> KeyframePoints:
    """The points of a sparse map, or pixels of a dense depth image: at most about ``count``, of large gradient.

    Of a map with more points, such as a lidar's scan, those whose pixels are chosen as in a depth image, and others at
    random where these are too few. ``levels`` is the keyframe's intensity pyramid, finest first.
    """
    if reference.sparse_points is not None or reference.depth is None:
        return _choose_of_map(reference.points, levels, count, rng)
    known = np.isfinite(reference.depth) & (reference.depth > 0)
    uv = select_pixels(levels, known, count, rng)
    z = reference.depth[uv[:, 1], uv[:, 0]].astype(np.float64)
    a, b, c = reference.depth_sigma
    return KeyframePoints(uv.astype(np.float64), 1.0 / z, (a + b * z + c * z * z) / (z * z))


def _choose_of_map(points: KeyframePoints, levels: list[Level], count: int, rng: np.random.Generator) -> KeyframePoints:
    """At most ``count`` points of a sparse map, see :func:`choose_points`; of several at one pixel the nearest."""
    if len(points) <= count:
        return points
    height, width = levels[0].map.shape[:2]
    u, v = np.rint(points.uv).astype(int).T
    inside = np.flatnonzero((u >= 0) & (v >= 0) & (u < width) & (v < height))
    inside = inside[np.argsort(points.inverse_depth[inside], kind="stable")]
    at_pixel = np.full((height, width), -1)
    at_pixel[v[inside], u[inside]] = inside
    uv = select_pixels(levels, at_pixel >= 0, count, rng)
    steep = at_pixel[uv[:, 1], uv[:, 0]]
    others = rng.permutation(np.setdiff1d(np.arange(len(points)), steep))
    rows = np.sort(np.concatenate([steep, others[: count - len(steep)]]))
    return KeyframePoints(points.uv[rows], points.inverse_depth[rows], points.sigma[rows])


def select_pixels(levels: list[Level], candidates: Mask, wanted: int, rng: np.random.Generator) -> NDArray[np.int32]:
    """Choose about ``wanted`` candidates of large gradient.

    The image is divided into cells of d, 2d and 4d pixels. Of each d-cell, among the candidates whose gradient exceeds
    the threshold, the one of largest gradient along a random direction is chosen. In a 2d-cell without a chosen pixel,
    one is sought above 0.75 of the threshold, with gradients of pyramid level 1; in a 4d-cell without any, one above
    0.75^2 of it, with gradients of level 2. d is adapted until enough pixels are chosen; a surplus is thinned at
    random.

    Args:
        levels: intensity pyramid, finest first.
        candidates: (H, W) pixels that may be chosen.
        wanted: largest number; fewer are returned where candidates or gradients are scarce.
        rng: source of directions and thinning.

    Returns:
        (N, 2) pixels u, v in raster order, N <= wanted.
    """
    gradient_0, gradient_1, gradient_2 = (_gradient(levels[min(k, len(levels) - 1)]) for k in range(3))
    shifts = np.array([min(k, len(levels) - 1) for k in range(3)])
    allowed = candidates.copy()
    allowed[:KEPT_BORDER] = allowed[-KEPT_BORDER:] = False
    allowed[:, :KEPT_BORDER] = allowed[:, -KEPT_BORDER:] = False
    thresholds = block_thresholds(np.hypot(gradient_0[..., 0], gradient_0[..., 1]))
    angles = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    compass = np.stack([np.cos(angles), np.sin(angles)], axis=-1).astype(np.float32)

    best = np.zeros(0, dtype=np.int64)
    cell, tried = FIRST_CELL, set()
    for _ in range(MAX_TRIES):
        tried.add(cell)
        drawn = rng.integers(DIRECTIONS, size=(3, -(-allowed.shape[0] // cell), -(-allowed.shape[1] // cell)))
        found = np.flatnonzero(
            _choose(gradient_0, gradient_1, gradient_2, shifts, allowed, thresholds, compass, drawn, cell)
        )
        if (found.size >= wanted and (best.size < wanted or found.size < best.size)) or best.size < found.size < wanted:
            best = found
        if wanted <= found.size <= 1.25 * wanted:
            break
        # The number of cells falls as 1 / (d + 1)^2, the number of points nearly so.
        cell = max(1, round((cell + 1) * np.sqrt(max(found.size, 1) / wanted)) - 1)
        if cell in tried:
            cell -= 1
        if cell < 1 or cell in tried:
            break
    if best.size > wanted:
        best = np.sort(rng.choice(best, size=wanted, replace=False))
    v, u = np.divmod(best, allowed.shape[1])
    return np.stack([u, v], axis=-1).astype(np.int32)


def block_thresholds(magnitude: Floats) -> Floats:
    """The threshold of each 32x32 block: the median gradient magnitude (in whole bins) + 7, averaged over 3x3 blocks.

    Incomplete blocks at the right and lower border belong to their neighbour.

    Args:
        magnitude: (H, W).

    Returns:
        (H // 32, W // 32), at least 1x1.
    """
    rows, columns = (max(1, side // BLOCK) for side in magnitude.shape)
    medians = np.empty((rows, columns))
    for i in range(rows):
        for j in range(columns):
            bottom = None if i == rows - 1 else (i + 1) * BLOCK
            right = None if j == columns - 1 else (j + 1) * BLOCK
            block = magnitude[i * BLOCK : bottom, j * BLOCK : right]
            medians[i, j] = min(np.floor(np.median(block)), LARGEST_BIN)
    raised = np.pad(medians + THRESHOLD_OVER_MEDIAN, 1, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(raised, (3, 3))
    out: Floats = np.nanmean(windows, axis=(2, 3)).astype(np.float32)
    return out


def _gradient(level: Level) -> Floats:
    return np.ascontiguousarray(level.map[..., 1:3])


@njit(cache=True)
def _best_in_cell(
    gradient: Floats,
    shift: int,
    allowed: Mask,
    thresholds: Floats,
    factor: float,
    direction: Floats,
    y0: int,
    x0: int,
    side: int,
) -> int:
    """The flat index of the cell's allowed pixel above threshold with the largest gradient along a direction, or -1."""
    height, width = allowed.shape
    best, best_index = np.float32(0.0), -1
    for y in range(y0, min(y0 + side, height)):
        block_y = min(y // BLOCK, thresholds.shape[0] - 1)
        for x in range(x0, min(x0 + side, width)):
            if not allowed[y, x]:
                continue
            threshold = factor * thresholds[block_y, min(x // BLOCK, thresholds.shape[1] - 1)]
            # An odd last row or column of a level has no pixel on the next coarser one.
            gradient_y = min(y >> shift, gradient.shape[0] - 1)
            gradient_x = min(x >> shift, gradient.shape[1] - 1)
            gx, gy = gradient[gradient_y, gradient_x, 0], gradient[gradient_y, gradient_x, 1]
            if gx * gx + gy * gy > threshold * threshold:
                along = abs(gx * direction[0] + gy * direction[1])
                if along > best:
                    best, best_index = along, y * width + x
    return best_index


@njit(cache=True)
def _choose(
    gradient_0: Floats,
    gradient_1: Floats,
    gradient_2: Floats,
    shifts: Indices,
    allowed: Mask,
    thresholds: Floats,
    compass: Floats,
    drawn: Indices,
    d: int,
) -> Mask:
    """The chosen pixels (H, W) for cells of d, 2d and 4d pixels; ``drawn`` holds the direction of each cell."""
    height, width = allowed.shape
    chosen = np.zeros((height, width), np.bool_)
    flat = chosen.reshape(-1)
    for y4 in range(0, height, 4 * d):
        for x4 in range(0, width, 4 * d):
            found_4 = False
            for y2 in range(y4, min(y4 + 4 * d, height), 2 * d):
                for x2 in range(x4, min(x4 + 4 * d, width), 2 * d):
                    found_2 = False
                    for y in range(y2, min(y2 + 2 * d, height), d):
                        for x in range(x2, min(x2 + 2 * d, width), d):
                            direction = compass[drawn[0, y // d, x // d]]
                            index = _best_in_cell(gradient_0, shifts[0], allowed, thresholds, 1.0, direction, y, x, d)
                            if index >= 0:
                                flat[index] = True
                                found_2 = True
                    if not found_2:
                        direction = compass[drawn[1, y2 // d, x2 // d]]
                        factor = COARSER_CELL_FACTOR
                        index = _best_in_cell(
                            gradient_1, shifts[1], allowed, thresholds, factor, direction, y2, x2, 2 * d
                        )
                        if index >= 0:
                            flat[index] = True
                            found_2 = True
                    found_4 = found_4 or found_2
            if not found_4:
                direction = compass[drawn[2, y4 // d, x4 // d]]
                factor = COARSER_CELL_FACTOR * COARSER_CELL_FACTOR
                index = _best_in_cell(gradient_2, shifts[2], allowed, thresholds, factor, direction, y4, x4, 4 * d)
                if index >= 0:
                    flat[index] = True
    return chosen
