"""Depth by a stereo pair of the rig, and its agreement with depth by lidar, which is independent of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Floats, Image
from relocbench.datasets.groundtruth.depth.depth import DepthImage
from relocbench.datasets.sensors.recording import CameraStream
from relocbench.datasets.sensors.stereo import StereoGeometry, stereo_depth
from relocbench.errors import ConfigError
from relocbench.geometry import Camera, invert

_ROWS_PX = 0.5
"""largest difference of rows in a rectified pair"""


@dataclass(frozen=True)
class Agreement:
    """Statistics of the differences of disparity, lidar minus stereo."""

    pixels: int
    """number of pixels at which both depths are known"""
    median_px: float
    """median of the absolute differences; nan if there are none"""
    bias_px: float
    """median of the differences; if it is positive, depth by lidar is smaller"""
    within_1px: float
    """share of the absolute differences of at most 1 pixel"""
    within_3px: float
    """share of those of at most 3 pixels"""

    def __str__(self) -> str:
        return (
            f"median {self.median_px:.2f} px, bias {self.bias_px:+.2f} px, {self.within_1px:.0%} within 1 px, "
            f"{self.within_3px:.0%} within 3 px, of {self.pixels} pixels"
        )


def rectified(left: Camera, right: Camera, T_right_left: Array) -> StereoGeometry:
    """Geometry of a rectified stereo pair: two pinhole cameras whose rows see the same planes.

    Raises:
        ConfigError: the pair is not rectified, or the right camera is not to the right of the left one.
    """
    baseline = -float(T_right_left[0, 3])
    aside = np.abs(T_right_left[1:3, 3]).max()
    turned = np.abs(T_right_left[:3, :3] - np.eye(3)).max()
    lens = max(abs(left.fx - right.fx), abs(left.fy - right.fy), abs(left.cy - right.cy))
    if left.model != "pinhole" or right.model != "pinhole" or left.size != right.size:
        raise ConfigError("depth by stereo needs two pinhole cameras with images of the same size")
    if baseline <= 0 or lens > _ROWS_PX or turned * left.fx > _ROWS_PX or aside > 0.01 * baseline:
        raise ConfigError(
            f"the cameras are not a rectified pair: the right one is {baseline:.3f} m to the right and {aside:.3f} m "
            f"off that line, turned by {np.degrees(turned):.3f} deg; intrinsics differ by {lens:.2f} px"
        )
    return StereoGeometry(left.fx * baseline, left.cx - right.cx)


def depth_by_stereo(left: Image, right: Image, geometry: StereoGeometry) -> DepthImage:
    """Depth of the left image by semi-global matching."""
    depth = stereo_depth(left, right, geometry)
    a, b, c = geometry.depth_sigma
    return DepthImage(depth, np.where(depth > 0, a + b * depth + c * depth * depth, 0).astype(np.float32))


def cross_check(lidar: Floats, stereo: Floats, camera: Camera, baseline_m: float) -> Agreement:
    """The agreement of two depth images (H, W) of one camera, in pixels of disparity ``f b / z``."""
    both = (lidar > 0) & (stereo > 0)
    if not both.any():
        return Agreement(0, float("nan"), float("nan"), 0.0, 0.0)
    difference = camera.fx * baseline_m * (1 / lidar[both].astype(np.float64) - 1 / stereo[both].astype(np.float64))
    size = np.abs(difference)
    return Agreement(
        len(difference),
        float(np.median(size)),
        float(np.median(difference)),
        float((size <= 1).mean()),
        float((size <= 3).mean()),
    )


@dataclass(frozen=True, eq=False)
class StereoPair:
    """A camera and the one to its right that is rectified with it."""

    left: CameraStream
    right: CameraStream
    geometry: StereoGeometry
    baseline_m: float

    def common_times(self) -> frozenset[int]:
        """Times at which both cameras took an image."""
        return frozenset(self.left.times_ns.tolist()) & frozenset(self.right.times_ns.tolist())

    def depth(self, time_ns: int) -> DepthImage:
        """Depth of the left image at a common time. Raises DatasetError with the file if an image is damaged."""
        return depth_by_stereo(_image(self.left, time_ns), _image(self.right, time_ns), self.geometry)


def stereo_pair(cameras: Mapping[str, CameraStream], left: str) -> StereoPair | None:
    """The stereo pair of ``left`` with the first camera that is to its right and rectified with it; None if none is."""
    one = cameras[left]
    for name, other in cameras.items():
        if name == left:
            continue
        T_right_left = invert(other.T_rig_cam) @ one.T_rig_cam
        try:
            geometry = rectified(one.camera, other.camera, T_right_left)
        except ConfigError:
            continue
        return StereoPair(one, other, geometry, -float(T_right_left[0, 3]))
    return None


def _image(stream: CameraStream, time_ns: int) -> Image:
    return stream.read(int(stream.times_ns.searchsorted(time_ns)))
