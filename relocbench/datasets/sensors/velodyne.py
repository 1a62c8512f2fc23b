"""Sparse depth images from lidar scans."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.sensors.point_table import MOST_SCAN_BYTES
from relocbench.errors import DatasetError
from relocbench.files import read_bytes
from relocbench.geometry import Camera, apply

Array = NDArray[np.float64]

LIDAR_SIGMA = 0.02
"""metres: ranging accuracy of the HDL-64 that KITTI carries"""
_REACH = 12
"""pixels: gaps between beams of one surface, and the parallax between lidar and camera, are smaller"""
_THICKNESS = 3
"""pixels: half the breadth of the strip searched in a direction, so that a ring of beams is met"""


def read_scan(path: Path) -> Array:
    """(N, 3) metres in the lidar frame of a KITTI scan (float32 x y z reflectance).

    Raises:
        DatasetError: missing, or not a whole number of points.
    """
    data = read_bytes(path, "a lidar scan (float32 x y z reflectance)", DatasetError, MOST_SCAN_BYTES)
    if len(data) == 0 or len(data) % 16:
        raise DatasetError(f"{len(data)} bytes are no whole number of points (float32 x y z reflectance)", path)
    points = np.frombuffer(data, dtype="<f4").reshape(-1, 4)[:, :3].astype(np.float64)
    return points[np.all(np.isfinite(points), axis=1)]


def project_scan(points: Array, camera: Camera, T_cam_lidar: Array, max_depth: float = 80.0) -> NDArray[np.float32]:
    """(H, W) metres along z, 0 where no beam fell.

    Of several points in a pixel the nearest is kept. The lidar looks from another place than the camera: points
    that it sees past an edge, which the camera does not, are removed by :func:`hidden`.
    """
    moved = apply(T_cam_lidar, points)
    uv, valid = camera.project(moved)
    valid &= camera.contains(uv) & (moved[:, 2] > 0.5) & (moved[:, 2] <= max_depth)
    u, v = np.rint(uv[valid]).astype(int).T
    nearest = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    np.minimum.at(nearest, (v, u), moved[valid, 2].astype(np.float32))
    return np.where(np.isfinite(nearest) & ~hidden(nearest), nearest, np.float32(0.0))


def hidden(nearest: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which of the points (H, W; inf where none) stand behind a surface that the camera sees instead.

    A point is hidden when clearly nearer points lie on both sides of it, left and right or above and below. One side
    is not enough: on a road everything below is nearer, and beside an edge everything beyond it.
    """
    # Where no beam fell there is nothing to hide.
    known = np.isfinite(nearest)
    depth = np.where(known, nearest, np.float32(0.0))
    limit = depth - np.maximum(np.float32(0.5), np.float32(0.1) * depth)
    side = {}
    for name in ("left", "right", "above", "below"):
        kernel, anchor = _strip(name)
        side[name] = np.asarray(cv2.erode(nearest, kernel, anchor=anchor)) < limit
    return known & ((side["left"] & side["right"]) | (side["above"] & side["below"]))


def _strip(side: str) -> tuple[NDArray[np.uint8], tuple[int, int]]:
    """Kernel of the strip of pixels on one side of a pixel, and where that pixel lies in it (x, y)."""
    along, across = _REACH, 2 * _THICKNESS + 1
    shape, anchor = {
        "left": ((across, along + 1), (along, _THICKNESS)),
        "right": ((across, along + 1), (0, _THICKNESS)),
        "above": ((along + 1, across), (_THICKNESS, along)),
        "below": ((along + 1, across), (_THICKNESS, 0)),
    }[side]
    kernel = np.ones(shape, dtype=np.uint8)
    if side in ("left", "right"):
        kernel[:, anchor[0]] = 0
    else:
        kernel[anchor[1], :] = 0
    return kernel, anchor
