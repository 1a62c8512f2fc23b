"""A model of two images in NumPy: patches that look alike, then the relative pose up to scale.

It is given the shape of what the keyframe shows, but not its size, which is the part that a network would have learnt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from relocbench.geometry import Camera, apply, se3_exp

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

_HALF = 4
"""a patch reaches so many pixels from its centre"""
_COARSEST_WIDTH = 100
_REACH = 0.15
"""how far a patch may move, as a share of the image's width"""
_CELLS = (20, 15)
_ALIKE = 0.85
"""least correlation of patches that match"""
_FEWEST = 20
_STEPS = 20
_NUDGE = 1e-6


@dataclass(frozen=True, eq=False)
class Features:
    """What matching needs of one image."""

    levels: list[tuple[Floats, Floats]]
    """finest first: grey (H, W), and the contrast (H, W) of the patch around each pixel"""
    corners: NDArray[np.intp]
    """(N, 2) pixels u, v of the most contrast, one a cell of a grid"""


def features(image: NDArray[np.uint8]) -> Features:
    """The features of a grey (H, W) or RGB (H, W, 3) image."""
    grey = image.astype(np.float32) if image.ndim == 2 else image.mean(axis=2, dtype=np.float32)
    levels = [(grey, _contrast(grey))]
    while levels[-1][0].shape[1] > _COARSEST_WIDTH:
        fine = levels[-1][0]
        height, width = fine.shape[0] // 2 * 2, fine.shape[1] // 2 * 2
        half = fine[:height, :width].reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3))
        levels.append((half, _contrast(half)))
    return Features(levels, _corners(levels[0][1]))


def matches(reference: Features, query: Features) -> tuple[Array, Array]:
    """Pixels (N, 2) of the reference and the pixels (N, 2) of the query around which the patches look alike."""
    corners = reference.corners
    moved = np.zeros((len(corners), 2), dtype=np.intp)
    score, offset = np.zeros(len(corners)), np.zeros((len(corners), 2))
    coarsest = len(reference.levels) - 1
    for level in range(coarsest, -1, -1):
        grey = reference.levels[level][0]
        reach = round(_REACH * grey.shape[1]) if level == coarsest else 2
        at = corners // 2**level
        moved, score, offset = _search(grey, query.levels[level], at, moved, reach)
        moved = moved * 2 if level else moved
    good = score > _ALIKE
    return corners[good].astype(np.float64), (corners + moved + offset)[good]


def relative_pose(shape: Array, uv_query: Array, camera: Camera) -> tuple[Array, Array] | None:
    """Rotation (3, 3) and unit direction (3,) of ``T_query_ref``, or None if the matches are too few.

    It minimises the angles between the rays of the query and the points, with Cauchy weights, by Gauss-Newton from no
    motion.

    Args:
        shape: (N, 3) points of the reference, of any size; NaN where unknown.
        uv_query: (N, 2) pixels of the query that show them.
    """
    rays, seen = camera.unproject(uv_query)
    seen &= np.isfinite(shape).all(axis=1)
    if seen.sum() < _FEWEST:
        return None
    y = rays[seen] / np.linalg.norm(rays[seen], axis=1, keepdims=True)
    X = shape[seen] / np.median(np.linalg.norm(shape[seen], axis=1))  # without metres
    pixel = 2 / (camera.fx + camera.fy)
    T = np.eye(4)
    for _ in range(_STEPS):
        residual = _angles(T, X, y)
        jacobian = np.stack([(_angles(se3_exp(d) @ T, X, y) - residual) / _NUDGE for d in _NUDGE * np.eye(6)], axis=-1)
        weights = 1 / (1 + np.sum(residual**2, axis=1) / pixel**2)
        weighted = (jacobian * weights[:, None, None]).reshape(-1, 6)
        normal = weighted.T @ jacobian.reshape(-1, 6) + 1e-9 * np.eye(6)
        step = -np.linalg.solve(normal, weighted.T @ residual.reshape(-1))
        T = se3_exp(step) @ T
        if np.abs(step).max() < 1e-8:
            break
    length = np.linalg.norm(T[:3, 3])
    return (T[:3, :3], T[:3, 3] / length) if length > 0 else None


def _contrast(grey: Floats) -> Floats:
    """Length of the patch around each pixel without its mean; infinite where it leaves the image."""
    out = np.full(grey.shape, np.inf, dtype=np.float32)
    size = 2 * _HALF + 1
    if min(grey.shape) >= size:
        inner = sliding_window_view(grey, (size, size)).std(axis=(2, 3)) * size
        out[_HALF:-_HALF, _HALF:-_HALF] = np.where(inner > size, inner, np.inf)  # flat ones look like any other
    return out


def _corners(contrast: Floats) -> NDArray[np.intp]:
    """The pixels (N, 2) of the most contrast in each cell of a grid."""
    known = np.where(np.isfinite(contrast), contrast, -1.0)
    found = []
    for rows in np.array_split(np.arange(contrast.shape[0]), _CELLS[1]):
        for columns in np.array_split(np.arange(contrast.shape[1]), _CELLS[0]):
            cell = known[np.ix_(rows, columns)]
            if cell.size and cell.max() > 0:
                v, u = np.unravel_index(cell.argmax(), cell.shape)
                found.append((columns[u], rows[v]))
    return np.array(found, dtype=np.intp).reshape(-1, 2)


def _search(
    grey: Floats, query: tuple[Floats, Floats], at: NDArray[np.intp], moved: NDArray[np.intp], reach: int
) -> tuple[NDArray[np.intp], Array, Array]:
    """Where patches of the reference are found, at most ``reach`` pixels from where they were moved to.

    Returns:
        by how much each moved (N, 2), its correlation (N,), and the part of a pixel that is left (N, 2).
    """
    border = reach + 1 + _HALF
    size = 2 * _HALF + 1
    patches = sliding_window_view(np.pad(grey, _HALF, mode="edge"), (size, size))[at[:, 1], at[:, 0]]
    patches = patches - patches.mean(axis=(1, 2), keepdims=True)
    lengths = np.sqrt(np.sum(patches**2, axis=(1, 2)))
    wide = 2 * (reach + 1) + 1
    height, width = query[0].shape
    centre = np.clip(at + moved, 0, [width - 1, height - 1])
    windows = sliding_window_view(np.pad(query[0], border, mode="edge"), (wide + 2 * _HALF,) * 2)
    regions = sliding_window_view(windows[centre[:, 1], centre[:, 0]], (size, size), axis=(1, 2))
    contrast = sliding_window_view(np.pad(query[1], reach + 1, constant_values=np.inf), (wide, wide))
    correlation = np.einsum("nijab,nab->nij", regions, patches) / contrast[centre[:, 1], centre[:, 0]]
    correlation /= np.maximum(lengths, 1e-6)[:, None, None]
    inner = correlation[:, 1:-1, 1:-1].reshape(len(at), -1)
    best = inner.argmax(axis=1) if len(at) else np.zeros(0, dtype=np.intp)
    row, column = best // (wide - 2) + 1, best % (wide - 2) + 1
    n = np.arange(len(at))
    offset = np.stack(
        [
            _vertex(correlation[n, row, column - 1], correlation[n, row, column], correlation[n, row, column + 1]),
            _vertex(correlation[n, row - 1, column], correlation[n, row, column], correlation[n, row + 1, column]),
        ],
        axis=-1,
    )
    found = centre + np.stack([column, row], axis=-1) - (reach + 1) - at
    return found, correlation[n, row, column].astype(np.float64), offset


def _vertex(before: Floats, middle: Floats, after: Floats) -> Array:
    """Where the parabola through three values (N,) is highest, from -0.5 to 0.5."""
    bend = (before - 2 * middle + after).astype(np.float64)
    return np.clip(np.where(bend < -1e-9, 0.5 * (before - after) / np.minimum(bend, -1e-9), 0.0), -0.5, 0.5)


def _angles(T: Array, X: Array, y: Array) -> Array:
    """Residuals (N, 3) in radians: rays (N, 3) crossed with the directions of the moved points (N, 3)."""
    p = apply(T, X)
    return np.cross(y, p / np.maximum(np.linalg.norm(p, axis=1, keepdims=True), 1e-12))
