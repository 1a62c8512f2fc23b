"""Sparse depth images from lidar scans."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from relocbench.arrays import Array, Floats, Image, Mask
from relocbench.datasets.sensors.cloud_formats.point_table import MOST_SCAN_BYTES
from relocbench.datasets.sensors.plausible_points import check_distances
from relocbench.datasets.sensors.scan_files import columns
from relocbench.errors import DatasetError
from relocbench.files import read_bytes
from relocbench.geometry import Camera, apply

LIDAR_SIGMA = 0.02
"""metres; ranging accuracy of KITTI's HDL-64"""
_REACH = 12
"""pixels; more than the gaps between beams on one surface and the parallax between lidar and camera"""
_THICKNESS = 3
"""pixels; half the width of the strip searched in each direction, wide enough to contain a ring of beams"""


def read_scan(path: Path) -> Array:
    """Points (N, 3) of a KITTI scan (float32 x y z reflectance), metres in the lidar's frame.

    Raises:
        DatasetError: the file is missing, empty or not a whole number of points, or these are not metres.
    """
    data = read_bytes(path, "a lidar scan (float32 x y z reflectance)", DatasetError, MOST_SCAN_BYTES)
    if not data:
        raise DatasetError("is empty; expected a lidar scan", path)
    points = columns(data, "x y z reflectance", path)[:, :3].astype(np.float64)
    points = points[np.all(np.isfinite(points), axis=1)]
    check_distances(points, path)
    return points


def project_scan(points: Array, camera: Camera, T_cam_lidar: Array, max_depth: float = 80.0) -> Floats:
    """Depth (H, W) in metres along z by projecting lidar points (N, 3), 0 where there is none.

    Of several points in a pixel the nearest is kept. Since lidar and camera are at different places, the lidar sees
    past some edges; points that are hidden from the camera are removed by :func:`hidden`.
    """
    moved = apply(T_cam_lidar, points)
    uv, valid = camera.project(moved)
    valid &= camera.contains(uv) & (moved[:, 2] > 0.5) & (moved[:, 2] <= max_depth)
    u, v = np.rint(uv[valid]).astype(int).T
    nearest = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    np.minimum.at(nearest, (v, u), moved[valid, 2].astype(np.float32))
    return np.where(np.isfinite(nearest) & ~hidden(nearest), nearest, np.float32(0.0))


def hidden(nearest: Floats) -> Mask:
    """Which points of a depth image (H, W; inf where there is none) are hidden behind a nearer surface.

    A point is hidden if clearly nearer points lie on both sides of it, left and right or above and below. One side is
    not enough: on a road everything below a point is nearer, and beside an edge everything beyond the edge.
    """
    # Pixels without a point cannot be hidden.
    known = np.isfinite(nearest)
    depth = np.where(known, nearest, np.float32(0.0))
    limit = depth - np.maximum(np.float32(0.5), np.float32(0.1) * depth)
    side = {}
    for name in ("left", "right", "above", "below"):
        kernel, anchor = _strip(name)
        side[name] = np.asarray(cv2.erode(nearest, kernel, anchor=anchor)) < limit
    return known & ((side["left"] & side["right"]) | (side["above"] & side["below"]))


def _strip(side: str) -> tuple[Image, tuple[int, int]]:
    """Kernel for the strip of pixels on one side of a pixel, and the pixel's place (x, y) in the kernel."""
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
