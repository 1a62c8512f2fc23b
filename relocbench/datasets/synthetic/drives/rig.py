"""Camera rigs: cameras and their mounts on the car.

Vehicle axes: x forward, y left, z up, origin on the road surface below the middle of the car. Camera axes: x right,
y down, z forward.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.upright import R_VEHICLE_CAMERA
from relocbench.datasets.synthetic.conditions.views import CameraView, image_size
from relocbench.errors import ConfigError, available
from relocbench.geometry import Camera, make_transform, so3_exp


def _turn(yaw_deg: float, down_deg: float) -> Array:
    """The rotation (3, 3) in vehicle axes first down and then to the left."""
    return np.asarray(so3_exp([0.0, 0.0, np.radians(yaw_deg)]) @ so3_exp([0.0, np.radians(down_deg), 0.0]))


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
        rotation = _turn(self.yaw_deg, self.down_deg) @ R_VEHICLE_CAMERA
        return make_transform(rotation, [self.forward_m, self.left_m, self.up_m])


@dataclass(frozen=True)
class Rig:
    """Cameras of the same model on different mounts."""

    mounts: Mapping[str, Mount]
    field_of_view_deg: float
    """horizontal"""

    def camera(self, width: int, height: int, zoom: float = 1.0) -> Camera:
        """The pinhole camera on each mount of the rig; ``zoom`` is a factor of its focal length."""
        focal = 0.5 * zoom * width / np.tan(np.radians(self.field_of_view_deg) / 2)
        return Camera("pinhole", width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)

    def cameras(self, width: int, height: int, view: CameraView | None = None) -> dict[str, tuple[Camera, Array]]:
        """The cameras by name: (camera, ``T_rig_cam`` (4, 4)). The rig's frame is the vehicle's.

        Args:
            width: pixels, unless the view has a size of its own.
            height: pixels, likewise.
            view: of the drive, if it has one of its own.
        """
        T_rig_cam = {name: mount.T_rig_cam for name, mount in self.mounts.items()}
        if view is None:
            return {name: (self.camera(width, height), T) for name, T in T_rig_cam.items()}
        camera = self.camera(*image_size(view, (width, height)), view.focal)
        centre = np.mean([T[:3, 3] for T in T_rig_cam.values()], axis=0)
        turn = make_transform(_turn(view.yaw_deg, view.down_deg), centre + np.array([0.0, 0.0, view.up_m]))
        T_viewed_plain = turn @ make_transform(np.eye(3), -centre)
        return {name: (camera, T_viewed_plain @ T) for name, T in T_rig_cam.items()}


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
    "around": Rig(
        {
            "front": Mount(0.9, 0.0, 1.5),
            "left": Mount(0.6, 0.9, 1.1, yaw_deg=90),
            "right": Mount(0.6, -0.9, 1.1, yaw_deg=-90),
            "rear": Mount(-2.0, 0.0, 1.1, yaw_deg=180),
        },
        90.0,
    ),
}
"""``six`` has as many cameras as the rig of the GN-Net benchmark's synthetic half, all with different poses. ``around``
has those that cars have for parking: behind the windscreen, on both mirrors and above the number plate. The baselines
of the stereo rigs, 0.24 m and 0.54 m, are those of the Bumblebee XB3 (RobotCar) and of KITTI's car."""


def rig_named(name: str) -> Rig:
    """The rig of a name in :data:`RIGS`. Raises ConfigError, listing the names, if there is none."""
    if name not in RIGS:
        raise ConfigError(f"no rig '{name}'{available(name, RIGS)}")
    return RIGS[name]
