"""Inverse depth maps of a reference: points of known depth, propagated to every pyramid level (DSO)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.shared.pyramid import Level
from relocbench.arrays import Array, Floats, Indices
from relocbench.geometry import Camera
from relocbench.tracking import KeyframePoints

KEPT_BORDER = 2
"""pixels of a level that are left out along its border"""
INFORMATION_SCALE = 1e-3
DIAGONAL = ((-1, -1), (-1, 1), (1, -1), (1, 1))
STRAIGHT = ((-1, 0), (1, 0), (0, -1), (0, 1))


@dataclass(frozen=True, eq=False)
class LevelPoints:
    """The points of one level of the reference, for direct alignment."""

    points: Floats
    """(3, N) normalised x, y and inverse depth (1/m)"""
    values: Floats
    """(N, D) the reference's values at the pixels; direct alignment takes D = 1"""
    uv: NDArray[np.int32]
    """(N, 2) the pixels, on this level"""

    def __len__(self) -> int:
        return int(self.points.shape[1])


@dataclass(frozen=True, eq=False)
class InverseDepthSums:
    """The weighted sum of inverse depths and the sum of weights of each pixel; their quotient is its inverse depth."""

    weighted: Array
    """(H, W) sum of weight * inverse depth"""
    weight: Array
    """(H, W) sum of weights; 0 where no depth is known"""


def splat(points: KeyframePoints, width: int, height: int) -> InverseDepthSums:
    """Round points to pixels and sum them with weights sqrt(1e-3 / sigma^2).

    Without any positive sigma all weights are 1; where only some are positive, the others take the smallest of them.
    """
    u, v = np.rint(points.uv).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    inside &= (points.inverse_depth > 0) & np.isfinite(points.inverse_depth)
    stated = (points.sigma > 0) & np.isfinite(points.sigma)
    if np.any(stated):
        sigma = np.where(stated, points.sigma, points.sigma[stated].min())
        weights = np.sqrt(INFORMATION_SCALE) / sigma
    else:
        weights = np.ones(len(points))
    sums = InverseDepthSums(np.zeros((height, width)), np.zeros((height, width)))
    at = (v[inside], u[inside])
    np.add.at(sums.weighted, at, weights[inside] * points.inverse_depth[inside])
    np.add.at(sums.weight, at, weights[inside])
    return sums


def halve_sums(sums: InverseDepthSums) -> InverseDepthSums:
    """Add up both sums over 2x2 blocks, (H, W) -> (H // 2, W // 2)."""
    height, width = (side // 2 * 2 for side in sums.weight.shape)

    def blocks(a: Array) -> Array:
        return a[0:height:2, 0:width:2] + a[0:height:2, 1:width:2] + a[1:height:2, 0:width:2] + a[1:height:2, 1:width:2]

    return InverseDepthSums(blocks(sums.weighted), blocks(sums.weight))


def dilate(sums: InverseDepthSums, neighbours: tuple[tuple[int, int], ...]) -> InverseDepthSums:
    """Fill empty pixels with the mean of both sums over their known neighbours, given as offsets (dy, dx)."""
    height, width = sums.weight.shape
    weighted = np.pad(sums.weighted, 1)
    weight = np.pad(sums.weight, 1)

    def shifted(a: Array, dy: int, dx: int) -> Array:
        return a[1 + dy : 1 + dy + height, 1 + dx : 1 + dx + width]

    sum_weighted = sum(shifted(weighted, *offset) for offset in neighbours)
    sum_weight = sum(shifted(weight, *offset) for offset in neighbours)
    known = sum(shifted(weight, *offset) > 0 for offset in neighbours)
    fill = (sums.weight <= 0) & (known > 0)
    count = np.maximum(known, 1)
    return InverseDepthSums(
        np.where(fill, sum_weighted / count, sums.weighted), np.where(fill, sum_weight / count, sums.weight)
    )


def coarse_points(points: KeyframePoints, levels: Sequence[Level]) -> list[LevelPoints]:
    """The points of every pyramid level, with the values that the level's map has there.

    On each level the sums are halved from the level below, dilated once and divided. Empty pixels are filled from their
    diagonal neighbours on levels 0 and 1, from their four nearest neighbours on coarser ones.

    Args:
        points: pixels of level 0 with inverse depth.
        levels: maps and cameras, finest first.
    """
    sums = splat(points, levels[0].camera.width, levels[0].camera.height)
    out = []
    for number, level in enumerate(levels):
        if number > 0:
            sums = halve_sums(sums)
        uv, inverse_depth = _read_off(dilate(sums, DIAGONAL if number < 2 else STRAIGHT))
        out.append(sample_points(uv, inverse_depth, level.map, level.camera))
    return out


def _read_off(sums: InverseDepthSums) -> tuple[Indices, Array]:
    kept = sums.weight > 0
    kept[:KEPT_BORDER] = kept[-KEPT_BORDER:] = False
    kept[:, :KEPT_BORDER] = kept[:, -KEPT_BORDER:] = False
    v, u = np.nonzero(kept)
    inverse_depth = sums.weighted[v, u] / sums.weight[v, u]
    positive = inverse_depth > 0
    return np.stack([u, v], axis=-1)[positive], inverse_depth[positive]


def sample_points(uv: NDArray[np.integer], inverse_depth: Array, level_map: Floats, camera: Camera) -> LevelPoints:
    """The points at pixels (N, 2) with inverse depth (N,), and the values of a level's map (H, W, 3 D) there."""
    u, v = uv[:, 0], uv[:, 1]
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    channels = level_map.shape[2] // 3
    return LevelPoints(
        points=np.stack([x, y, inverse_depth]).astype(np.float32),
        values=np.ascontiguousarray(level_map[v, u, :channels]),
        uv=uv.astype(np.int32),
    )
