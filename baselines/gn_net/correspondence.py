"""Matches between points of the reference and pixels of the query: the nearest features, coarse to fine.

On each level, a pixel is described by its own features and by those of all coarser levels, interpolated at its place
(hypercolumns: Hariharan et al., CVPR 2015). Points are searched for over the whole query on one coarse level and kept
where point and pixel are mutual nearest neighbours. Then they are moved, level by level, to the nearest pixel of a
small window. Contrastive losses train each level for this: matching features are close, others a margin apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.features.pyramid import FeaturePyramid, level_coordinates, sample
from baselines.alignment.shared.compiled import FAST
from relocbench.arrays import Array, Floats, Indices, Mask
from relocbench.kernels import njit
from relocbench.tracking import KeyframePoints

Features = Floats


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Points of a reference that are matched in queries."""

    points: Array
    """(N, 3) metres, reference camera"""
    values: tuple[Features, ...]
    """(N, D) features on each level, finest first"""

    @classmethod
    def at(cls, points: KeyframePoints, pyramid: FeaturePyramid, count: int, rng: np.random.Generator) -> Landmarks:
        """Choose at most ``count`` points that have a depth, at random; they are pixels of the finest map."""
        inverse_depth = np.asarray(points.inverse_depth, dtype=np.float64)
        known = np.flatnonzero((inverse_depth > 0) & np.isfinite(inverse_depth))
        chosen = np.sort(rng.permutation(known)[:count])
        uv, camera = points.uv[chosen], pyramid.levels[0].camera
        x, y = (uv[:, 0] - camera.cx) / camera.fx, (uv[:, 1] - camera.cy) / camera.fy
        return cls(
            np.stack([x, y, np.ones_like(x)], axis=1) / inverse_depth[chosen, None],
            tuple(_read(level.map, level_coordinates(uv, number)) for number, level in enumerate(pyramid.levels)),
        )

    def __len__(self) -> int:
        return len(self.points)


def match_landmarks(
    landmarks: Landmarks, query: FeaturePyramid, level: int, windows: Sequence[int]
) -> tuple[Indices, Array]:
    """Match landmarks to pixels of a query.

    Args:
        level: the level, counted from the finest map, on which the whole query is searched.
        windows: half-widths, in pixels, of the windows on the finer levels, coarser ones first; finer levels without a
            window are not searched.

    Returns:
        The rows (M,) of the landmarks that were matched, nearest features first, and their pixels (M, 2) in the finest
        map, to fractions of a pixel.
    """
    rows, uv, distances = _search(landmarks, query, level)
    for half_width in windows[:level]:
        level -= 1
        values = [of_level[rows] for of_level in landmarks.values]
        uv, distances = _move((uv + 0.5) * 2.0 - 0.5, values, query, level, half_width)
    order = np.argsort(distances, kind="stable")
    return rows[order], ((uv + 0.5) * float(1 << level) - 0.5)[order]


def _search(landmarks: Landmarks, query: FeaturePyramid, level: int) -> tuple[Indices, Array, Features]:
    """Mutual nearest neighbours on a level: rows (M,), pixels (M, 2) and squared distances (M,)."""
    height, width = query.levels[level].map.shape[:2]
    values = np.concatenate(landmarks.values[level:], axis=1)
    columns = _hypercolumns(query, level).reshape(height * width, -1)
    # -||f - g||^2 = 2 f g - ||g||^2 - ||f||^2. The nearest pixel g of a landmark f needs no ||f||^2.
    own = np.sum(values**2, axis=1)
    twice = np.concatenate([2.0 * values, np.full((len(values), 1), -1.0, values.dtype)], axis=1)
    columns = np.concatenate([columns, np.einsum("ij,ij->i", columns, columns)[:, None]], axis=1)
    nearest = np.argmax(twice @ columns.T, axis=1)
    likeness = twice @ columns[nearest].T - own[:, None]
    mutual = np.flatnonzero(np.argmax(likeness, axis=0) == np.arange(len(values)))
    v, u = np.divmod(nearest[mutual], width)
    return mutual, np.stack([u, v], axis=1).astype(np.float64), -likeness[mutual, mutual]


def _hypercolumns(pyramid: FeaturePyramid, level: int) -> Features:
    """The features of all levels from this one on (H, W, channels), at the pixels of this level."""
    height, width = pyramid.levels[level].map.shape[:2]
    coarser = []
    for number, of_level in enumerate(pyramid.levels[level + 1 :], start=1):
        across = _between(of_level.map, 1, width, number)
        coarser.append(_between(across, 0, height, number))
    return np.concatenate([pyramid.levels[level].map, *coarser], axis=2)


def _between(level_map: Features, axis: int, count: int, number: int) -> Features:
    """A map interpolated linearly along an axis at the ``count`` pixels of a level that is ``number`` levels finer."""
    last = level_map.shape[axis] - 1
    at = np.clip(level_coordinates(np.arange(count, dtype=np.float64), number), 0, last)
    before = at.astype(np.intp)
    share = (at - before).astype(np.float32).reshape([-1 if axis == each else 1 for each in range(level_map.ndim)])
    left, right = level_map.take(before, axis), level_map.take(np.minimum(before + 1, last), axis)
    return np.asarray(left + share * (right - left), dtype=np.float32)


def _move(
    uv: Array, values: Sequence[Features], query: FeaturePyramid, level: int, half_width: int
) -> tuple[Array, Features]:
    """The nearest pixel (M, 2) in a window around each pixel, and the squared distance of its features (M,).

    A parabola through the distances of neighbouring pixels gives the fraction of a pixel.
    """
    height, width = query.levels[level].map.shape[:2]
    side = 2 * half_width + 1
    corners = np.rint(np.clip(uv, 0, [width - 1, height - 1])).astype(np.int64) - half_width
    distances = np.zeros((len(uv), side, side), dtype=np.float32)
    for number in range(level, len(query)):
        add_window_distances(
            np.ascontiguousarray(values[number]), query.levels[number].map, 1 << (number - level), corners, distances
        )
    rows = np.arange(len(uv))
    i, j = np.divmod(np.argmin(distances.reshape(len(uv), -1), axis=1), side)

    def peak(before: NDArray[np.floating], after: NDArray[np.floating], inside: Mask) -> Array:
        middle = distances[rows, i, j].astype(np.float64)
        bend = before.astype(np.float64) + after - 2.0 * middle
        off = np.divide(0.5 * (before - after), bend, out=np.zeros_like(bend), where=inside & (bend > 0))
        return np.asarray(np.clip(off, -0.5, 0.5), dtype=np.float64)

    last = side - 1
    across = peak(
        distances[rows, i, np.maximum(j - 1, 0)], distances[rows, i, np.minimum(j + 1, last)], (j > 0) & (j < last)
    )
    down = peak(
        distances[rows, np.maximum(i - 1, 0), j], distances[rows, np.minimum(i + 1, last), j], (i > 0) & (i < last)
    )
    found = corners + np.stack([j + across, i + down], axis=1)
    return np.clip(found, 0, [width - 1, height - 1]), distances[rows, i, j]


def _read(level_map: Features, uv: Array) -> Features:
    """A map (H, W, D) interpolated at (N, 2) pixels -> (N, D); pixels beyond the border are moved onto it."""
    height, width = level_map.shape[:2]
    return sample(level_map, np.clip(uv, 0, [width - 1, height - 1]))


@njit(cache=True, fastmath=FAST, error_model="numpy")
def add_window_distances(
    values: NDArray[Any], level_map: NDArray[Any], coarser: int, corners: NDArray[Any], distances: NDArray[Any]
) -> None:
    """Add ``||F(u) - f_m||^2`` for each pixel u of each window, with F interpolated bilinearly.

    Args:
        values: (M, D) float32 features f.
        level_map: (H, W, D) float32, F.
        coarser: the side, in pixels of the windows' level, of a pixel of the map: 1, 2, 4, ...
        corners: (M, 2) int64 first column and row of each window; pixels beyond the border are moved onto it.
        distances: (M, K, K) float32, added to.
    """
    height, width, channels = level_map.shape
    side = distances.shape[1]
    one, half = np.float32(1), np.float32(0.5)
    scale = one / np.float32(coarser)
    last_u, last_v = np.float32(width - 1), np.float32(height - 1)
    for m in range(len(values)):
        for i in range(side):
            v = min(max((np.float32(corners[m, 1] + i) + half) * scale - half, np.float32(0)), last_v)
            iv = int(v)
            jv = min(iv + 1, height - 1)
            av = v - np.float32(iv)
            for j in range(side):
                u = min(max((np.float32(corners[m, 0] + j) + half) * scale - half, np.float32(0)), last_u)
                iu = int(u)
                ju = min(iu + 1, width - 1)
                au = u - np.float32(iu)
                w00, w01 = (one - av) * (one - au), (one - av) * au
                w10, w11 = av * (one - au), av * au
                total = np.float32(0)
                for c in range(channels):
                    f = (
                        w00 * level_map[iv, iu, c]
                        + w01 * level_map[iv, ju, c]
                        + w10 * level_map[jv, iu, c]
                        + w11 * level_map[jv, ju, c]
                        - values[m, c]
                    )
                    total += f * f
                distances[m, i, j] += total
