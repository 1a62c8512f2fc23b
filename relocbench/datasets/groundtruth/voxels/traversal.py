"""The voxels along a ray, one after the other (Amanatides and Woo, A fast voxel traversal algorithm, 1987)."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.kernels import njit


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def enter_grid(
    origin: Array, direction: Array, begin: float, size: float,
    voxel: Indices, step: Indices, leave: Array, stride: Array,
) -> None:  # fmt: skip
    """Set up a ray from ``origin`` (3,) along the unit vector ``direction`` (3,), ``begin`` metres from the origin.

    Args:
        size: edge length of a voxel, metres.
        voxel: (3,) receives the coordinates of the voxel that the ray is in.
        step: (3,) receives -1, 0 or 1 an axis.
        leave: (3,) receives the distance from the origin at which the ray leaves the voxel, by axis.
        stride: (3,) receives the distance between two such borders.
    """
    for axis in range(3):
        o = origin[axis]
        voxel[axis] = int(np.floor((o + begin * direction[axis]) / size))
        if direction[axis] > 0:
            step[axis] = 1
            leave[axis] = ((voxel[axis] + 1) * size - o) / direction[axis]
            stride[axis] = size / direction[axis]
        elif direction[axis] < 0:
            step[axis] = -1
            leave[axis] = (voxel[axis] * size - o) / direction[axis]
            stride[axis] = -size / direction[axis]
        else:
            step[axis] = 0
            leave[axis] = np.inf
            stride[axis] = np.inf


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def next_voxel(voxel: Indices, step: Indices, leave: Array, stride: Array) -> float:
    """Move on to the ray's next voxel. Returns the distance from the origin at which it is entered."""
    axis = 0
    if leave[1] < leave[axis]:
        axis = 1
    if leave[2] < leave[axis]:
        axis = 2
    entered = leave[axis]
    leave[axis] += stride[axis]
    voxel[axis] += step[axis]
    return float(entered)
