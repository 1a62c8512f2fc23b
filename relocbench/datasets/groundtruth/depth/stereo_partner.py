"""Stereo pairs of a rig: finding the camera that is rectified with a given one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from relocbench.arrays import Image
from relocbench.datasets.groundtruth.depth.depth import DepthImage
from relocbench.datasets.groundtruth.depth.stereo_check import depth_by_stereo, rectified
from relocbench.datasets.sensors.recording import CameraStream
from relocbench.datasets.sensors.stereo import StereoGeometry
from relocbench.errors import ConfigError
from relocbench.geometry import invert


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
