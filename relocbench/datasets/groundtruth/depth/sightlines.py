"""Sight lines: a camera cannot see through the shadow behind a scanned surface, unless some beam went through it.

The side of a thing that was never scanned (the front of a parked car, seen along the road by a scanner that looks
across it) has no surface that could hide what is behind it. But the inside of the thing is in the shadow of the side
that was scanned. Where no beam returned, above roofs and behind panes, space is unknown and hides nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Bytes, Floats
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.geometry import Camera, invert
from relocbench.kernels import njit

_LARGEST = 30_000_000
"""largest number of cells"""


@dataclass(frozen=True, eq=False)
class TracedSpace:
    """Space in cells that are free, in shadow or unknown, in the frame of the submap's node."""

    low: Floats
    """(3,) lowest corner"""
    cell_m: float
    state: Bytes
    """(X, Y, Z) 0: unknown; 1: free, a beam went through; 2: shadow, none went through and one ended in front of it"""


def trace_beams(submap: Submap, cell_m: float, within_m: float, shadow_m: float) -> TracedSpace:
    """Classify space by the beams of all points of a submap; those of dynamic points make free space but no shadow.

    Args:
        cell_m: size of a cell; it is enlarged if there would be too many.
        within_m: distance from the node, on each axis, within which space is classified.
        shadow_m: length of the shadow behind the end of a beam.
    """
    points, origins = submap.points, submap.origins
    used = np.isfinite(points).all(axis=1) & np.isfinite(origins).all(axis=1)
    points, origins = np.ascontiguousarray(points[used]), np.ascontiguousarray(origins[used])
    if not len(points):
        return TracedSpace(np.zeros(3, np.float32), cell_m, np.zeros((1, 1, 1), np.uint8))
    bound = np.float32(within_m)
    low = np.maximum(np.minimum(points.min(axis=0), origins.min(axis=0)), -bound)
    high = np.minimum(np.maximum(points.max(axis=0), origins.max(axis=0)), bound)
    extent = np.maximum(high - low, 0).astype(np.float64)
    while np.prod(np.floor(extent / cell_m) + 1) > _LARGEST:
        cell_m *= 1.25
    state = np.zeros(np.floor(extent / cell_m).astype(int) + 1, np.uint8)
    grid = low.astype(np.float32), np.float32(1 / cell_m)
    beam = points - origins
    length = np.maximum(np.linalg.norm(beam, axis=1, keepdims=True), 1e-3).astype(np.float32)
    steady = submap.steady[used] >= 0.5
    _mark(points[steady], (points + np.float32(shadow_m) / length * beam)[steady], *grid, 2, state)
    _mark(origins, points, *grid, 1, state)
    return TracedSpace(grid[0], cell_m, state)


def sight_limits(
    space: TracedSpace, camera: Camera, T_cam_node: Array, step: int, max_depth: float, start_m: float, shadow_m: float
) -> Floats:
    """(ceil(H / step), ceil(W / step)) depth along z up to which a pinhole camera can see; inf if it is not limited.

    Element (i, j) is for row step (i + 0.5) - 0.5 and column step (j + 0.5) - 0.5 of the image.

    Args:
        start_m: space nearer to the camera than this counts as free.
        shadow_m: a sight line ends where it enters a shadow in which it then runs further than this.
    """
    T_node_cam = invert(np.asarray(T_cam_node, dtype=np.float64))
    middle = (step - 1) / 2
    v, u = np.mgrid[0 : camera.height : step, 0 : camera.width : step].astype(np.float64) + middle
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    directions = np.ascontiguousarray((rays @ T_node_cam[:3, :3].T).reshape(-1, 3), dtype=np.float32)
    out = np.empty(len(directions), np.float32)
    eye = T_node_cam[:3, 3].astype(np.float32)
    limits = np.float32(max_depth), np.float32(start_m), np.float32(shadow_m)
    _look(eye, directions, space.low, np.float32(space.cell_m), space.state, *limits, out)
    return out.reshape(u.shape)


@njit(cache=True, nogil=True, error_model="numpy")
def _mark(begin, end, low, inverse, value, state):  # type: ignore[no-untyped-def]
    """Give a value to the cells along lines, at steps of half a cell."""
    nx, ny, nz = state.shape
    for i in range(len(begin)):
        x, y, z = (begin[i, 0] - low[0]) * inverse, (begin[i, 1] - low[1]) * inverse, (begin[i, 2] - low[2]) * inverse
        dx, dy = (end[i, 0] - begin[i, 0]) * inverse, (end[i, 1] - begin[i, 1]) * inverse
        dz = (end[i, 2] - begin[i, 2]) * inverse
        steps = np.int64(np.sqrt(dx * dx + dy * dy + dz * dz) * 2) + 1
        dx, dy, dz = dx / steps, dy / steps, dz / steps
        for _ in range(steps + 1):
            if x >= 0 and y >= 0 and z >= 0 and x < nx and y < ny and z < nz:
                state[np.int64(x), np.int64(y), np.int64(z)] = value
            x += dx
            y += dy
            z += dz


@njit(cache=True, nogil=True, error_model="numpy")
def _look(eye, directions, low, cell, state, max_depth, start, shadow, out):  # type: ignore[no-untyped-def]
    """Follow rays, at steps of half a cell, until they have been in shadow for too long without reaching free space."""
    nx, ny, nz = state.shape
    ex, ey, ez = (eye[0] - low[0]) / cell, (eye[1] - low[1]) / cell, (eye[2] - low[2]) / cell
    for i in range(len(directions)):
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        step = np.float32(0.5) * cell / length
        depth, begin, shaded = start / length, np.float32(0.0), np.float32(0.0)
        out[i] = np.inf
        while depth < max_depth:
            at = depth / cell
            x, y, z = ex + at * dx, ey + at * dy, ez + at * dz
            if x >= 0 and y >= 0 and z >= 0 and x < nx and y < ny and z < nz:
                value = state[np.int64(x), np.int64(y), np.int64(z)]
                if value == 1:
                    shaded = np.float32(0.0)
                elif value == 2:
                    if shaded == 0:
                        begin = depth
                    shaded += step * length
                    if shaded > shadow:
                        out[i] = begin
                        break
            depth += step
