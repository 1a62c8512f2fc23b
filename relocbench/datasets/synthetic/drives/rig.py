"""Camera rigs: cameras and their mounts on the car.

Vehicle axes: x forward, y left, z up, origin on the road surface below the middle of the car. Camera axes: x right,
y down, z forward.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.errors import ConfigError, available
from relocbench.geometry import Camera, make_transform, so3_exp

_R_VEHICLE_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""rotation of a camera that looks straight ahead"""


@dataclass(frozen=True)
class Mount:
    """Position and viewing direction of a camera in vehicle axes."""

    forward_m: float
    left_m: float
    up_m: float
    yaw_deg: float = 0.0
    """to the left"""
    down_deg: float = 0.0
    """below the horizon"""

    @property
    def T_rig_cam(self) -> Array:
        """Pose (4, 4), turned first down and then to the left."""
        yaw, down = np.radians(self.yaw_deg), np.radians(self.down_deg)
        rotation = so3_exp([0.0, 0.0, yaw]) @ so3_exp([0.0, down, 0.0]) @ _R_VEHICLE_CAMERA
        return make_transform(rotation, [self.forward_m, self.left_m, self.up_m])


@dataclass(frozen=True)
class Rig:
    """Cameras of the same model on different mounts."""

    mounts: Mapping[str, Mount]
    field_of_view_deg: float
    """horizontal"""

    def camera(self, width: int, height: int) -> Camera:
        """The pinhole camera on each mount of the rig."""
        focal = 0.5 * width / np.tan(np.radians(self.field_of_view_deg) / 2)
        return Camera("pinhole", width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)

    def cameras(self, width: int, height: int) -> dict[str, tuple[Camera, Array]]:
        """The cameras by name: (camera, ``T_rig_cam`` (4, 4)). The rig's frame is the vehicle's."""
        return {name: (self.camera(width, height), mount.T_rig_cam) for name, mount in self.mounts.items()}


RIGS: dict[str, Rig] = {
    "front": Rig({"front": Mount(0.9, 0.0, 1.5)}, 75.0),
    "stereo": Rig({"left": Mount(0.9, 0.12, 1.5), "right": Mount(0.9, -0.12, 1.5)}, 75.0),
    "wide-stereo": Rig({"left": Mount(0.9, 0.27, 1.65), "right": Mount(0.9, -0.27, 1.65)}, 80.0),
    "six": Rig(
        {
            "cam0": Mount(1.0, 0.0, 1.6),
            "cam1": Mount(1.0, 0.5, 1.6, yaw_deg=15),
            "cam2": Mount(1.0, -0.5, 1.6, yaw_deg=-15),
            "cam3": Mount(0.8, 0.0, 2.0, down_deg=8),
            "cam4": Mount(0.6, 0.7, 1.8, yaw_deg=45),
            "cam5": Mount(0.6, -0.7, 1.8, yaw_deg=-45),
        },
        90.0,
    ),
}
"""``six`` has as many cameras as the rig of the GN-Net benchmark's synthetic half, all with different poses. The
baselines of the stereo rigs, 0.24 m and 0.54 m, are those of the Bumblebee XB3 (RobotCar) and of KITTI's car."""


def rig_named(name: str) -> Rig:
    """The rig of a name in :data:`RIGS`. Raises ConfigError, listing the names, if there is none."""
    if name not in RIGS:
        raise ConfigError(f"no rig '{name}'{available(name, RIGS)}")
    return RIGS[name]
