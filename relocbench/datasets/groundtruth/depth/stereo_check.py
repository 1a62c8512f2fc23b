"""Depth by stereo, and how two depths of one image that know nothing of each other agree."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.depth.depth import DepthImage
from relocbench.datasets.sensors.stereo import StereoGeometry, stereo_depth
from relocbench.errors import ConfigError
from relocbench.geometry import Camera

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

_ROWS_PX = 0.5
"""rows of a rectified pair differ by less"""


@dataclass(frozen=True)
class Agreement:
    """Differences of disparity, where both depths are known."""

    pixels: int
    """where both are"""
    median_px: float
    """of the differences without their sign; nan where there are none"""
    bias_px: float
    """median with sign; above 0 the lidar is nearer"""
    within_1px: float
    """share"""
    within_3px: float

    def __str__(self) -> str:
        return (
            f"median {self.median_px:.2f} px, bias {self.bias_px:+.2f} px, {self.within_1px:.0%} within 1 px, "
            f"{self.within_3px:.0%} within 3 px, of {self.pixels} pixels"
        )


def rectified(left: Camera, right: Camera, T_right_left: Array, max_disparity: int = 128) -> StereoGeometry:
    """Geometry of a pair of pinhole cameras of which rows see the same planes.

    Raises:
        ConfigError: the pair is not rectified, or its right camera is not to the right.
    """
    baseline = -float(T_right_left[0, 3])
    aside = np.abs(T_right_left[1:3, 3]).max()
    turned = np.abs(T_right_left[:3, :3] - np.eye(3)).max()
    lens = max(abs(left.fx - right.fx), abs(left.fy - right.fy), abs(left.cy - right.cy))
    if left.model != "pinhole" or right.model != "pinhole" or left.size != right.size:
        raise ConfigError("depth by stereo needs two pinhole cameras of one size")
    if baseline <= 0 or lens > _ROWS_PX or turned * left.fx > _ROWS_PX or aside > 0.01 * baseline:
        raise ConfigError(
            f"the cameras are no rectified pair: the right one is {baseline:.3f} m to the right and {aside:.3f} m off "
            f"that line, turned by {np.degrees(turned):.3f} deg; intrinsics differ by {lens:.2f} px"
        )
    return StereoGeometry(left.fx * baseline, left.cx - right.cx, max_disparity=max_disparity)


def depth_by_stereo(left: NDArray[np.uint8], right: NDArray[np.uint8], geometry: StereoGeometry) -> DepthImage:
    """Depth of the left image by semi-global matching."""
    depth = stereo_depth(left, right, geometry)
    a, b, c = geometry.depth_sigma
    return DepthImage(depth, np.where(depth > 0, a + b * depth + c * depth * depth, 0).astype(np.float32))


def cross_check(lidar: Floats, stereo: Floats, camera: Camera, baseline_m: float) -> Agreement:
    """How two depth images (H, W) of one camera agree, in pixels of disparity ``f b / z``."""
    difference = _disparity_difference(lidar, stereo, camera, baseline_m)
    known = difference[np.isfinite(difference)]
    if not len(known):
        return Agreement(0, float("nan"), float("nan"), 0.0, 0.0)
    size = np.abs(known)
    return Agreement(
        len(known),
        float(np.median(size)),
        float(np.median(known)),
        float((size <= 1).mean()),
        float((size <= 3).mean()),
    )


def without_contradicted(
    lidar: DepthImage, stereo: Floats, camera: Camera, baseline_m: float, limit_px: float = 3.0
) -> DepthImage:
    """Lidar depth less the pixels where stereo sees something clearly nearer.

    The camera saw something that was not there when the lidar came by, a moving car say, or that it never met.
    """
    difference = _disparity_difference(lidar.depth, stereo, camera, baseline_m)
    gone = np.isfinite(difference) & (difference < -limit_px)
    zero = np.float32(0)
    return replace(lidar, depth=np.where(gone, zero, lidar.depth), sigma=np.where(gone, zero, lidar.sigma))


def _disparity_difference(lidar: Floats, stereo: Floats, camera: Camera, baseline_m: float) -> Array:
    """(H, W) lidar's disparity less that of stereo, nan where either is unknown."""
    both = (lidar > 0) & (stereo > 0)
    first, second = np.where(both, lidar, 1).astype(np.float64), np.where(both, stereo, 1).astype(np.float64)
    return np.where(both, camera.fx * baseline_m * (1 / first - 1 / second), np.nan)
