"""Writing recordings in the layout of KITTI odometry.

``OUT/sequences/NN/{image_0..3,velodyne,calib.txt,times.txt}`` and ``OUT/poses/NN.txt``. As in KITTI itself, the poses
are those of a GNSS/INS, and each sequence has its own world, the frame of its first camera. The exact poses, in one
world for all sequences, are in ``OUT/truth/NN/poses_cam0.txt``. Geiger et al., Are we ready for autonomous driving?,
CVPR 2012.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array, Image, Mask, Times
from relocbench.datasets.core import images
from relocbench.datasets.core.upright import R_VEHICLE_CAMERA
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.drives import odometry
from relocbench.datasets.synthetic.layouts.recorded import CameraMount, Layout, LidarMount, TrueTrajectory
from relocbench.datasets.synthetic.lidar import lidar
from relocbench.files import write_bytes, write_text
from relocbench.geometry import Camera, invert, make_transform

CAMERAS: dict[str, float] = {"image_0": 0.0, "image_1": 0.53715, "image_2": -0.06, "image_3": 0.47}
"""metres to the right of camera 0; cameras 0 and 1 are grey, 2 and 3 colour"""
_CAMERA = Camera("pinhole", 1226, 370, 707.0912, 707.0912, 601.8873, 183.1104)
"""the camera of sequences 04 to 12"""
_T_RIG_LIDAR = make_transform(np.eye(3), [0.0, 0.27, 1.73])
_T_LIDAR_CAM0 = make_transform(R_VEHICLE_CAMERA, [0.27, 0.0, -0.08])
"""the lidar is 1.73 m above the road, the cameras 1.65 m and 0.27 m further forward (KITTI's set-up page)"""
_T_RIG_CAM0 = _T_RIG_LIDAR @ _T_LIDAR_CAM0
_PERIOD_NS = 100_000_000


@dataclass(frozen=True)
class KittiLayout(Layout):
    """One sequence."""

    sequence: str
    """two digits"""
    rings: int
    azimuths: int
    compensated: bool
    """whether scans are motion-compensated, as those of KITTI's odometry benchmark are"""
    format = "KITTI"
    known_cameras = CAMERAS

    @property
    def name(self) -> str:
        return self.sequence

    @property
    def folder(self) -> Path:
        return self.root / "sequences" / self.name

    @cached_property
    def cameras(self) -> Mapping[str, CameraMount]:
        T_cam0_cam = {name: make_transform(np.eye(3), [CAMERAS[name], 0.0, 0.0]) for name in self.chosen}
        return {name: CameraMount(_CAMERA.scaled(self.scale), _T_RIG_CAM0 @ T) for name, T in T_cam0_cam.items()}

    @cached_property
    def lidars(self) -> Mapping[str, LidarMount]:
        return {"velodyne": LidarMount(lidar.spinning(self.rings, self.azimuths), _T_RIG_LIDAR, self.compensated)}

    @cached_property
    def times(self) -> Mapping[str, Times]:
        """Times by sensor. The lidar faces forward when the cameras are triggered."""
        ticks = np.arange(self.frames, dtype=np.int64) * _PERIOD_NS
        return dict.fromkeys((*self.chosen, *self.lidars), ticks)

    def stem(self, sensor: str, index: int) -> str:
        return f"{index:06d}"

    def is_scan_size(self, size: int) -> bool:
        # The number of returns varies, so only a size that is not a whole number of points shows truncation.
        return size > 0 and size % 16 == 0

    def write_image(self, camera: str, path: Path, rgb: Image) -> None:
        colour = camera in ("image_2", "image_3")
        images.write_image(path, rgb if colour else images.as_grey(rgb))

    def write_scan(self, path: Path, points: Array, reflectance: Array, returned: Mask) -> None:
        """Write x, y, z, reflectance of the returned points as float32."""
        write_bytes(path, np.column_stack([points, reflectance])[returned].astype("<f4").tobytes())

    def write_texts(self, trajectory: TrueTrajectory, factors: Factors, seed: int) -> dict[str, Any]:
        camera = _CAMERA.scaled(self.scale)
        rows = []
        for i, right_m in enumerate(CAMERAS.values()):
            projection = camera.matrix @ np.column_stack([np.eye(3), [-right_m, 0.0, 0.0]])
            rows.append(f"P{i}: {_numbers(projection)}\n")
        rows.append(f"Tr: {_numbers(invert(_T_LIDAR_CAM0)[:3])}\n")
        write_text(self.folder / "calib.txt", "".join(rows))
        ticks = self.times["velodyne"]
        write_text(self.folder / "times.txt", "".join(f"{t / 1e9:.9e}\n" for t in ticks.tolist()))
        T_world_rig = trajectory.at(ticks)
        _write_poses(self.root / "truth" / self.name / "poses_cam0.txt", T_world_rig @ _T_RIG_CAM0)
        rng = np.random.default_rng([seed, 22])
        solution = odometry.inertial(ticks, T_world_rig, odometry.InertialErrors(), rng)
        T_world_cam0 = solution.T_world_body @ _T_RIG_CAM0
        _write_poses(self.root / "poses" / f"{self.name}.txt", invert(T_world_cam0[0]) @ T_world_cam0)
        return {"compensated_scans": self.compensated, "ins_offset_east_north_up_m": solution.offset_m.tolist()}


def _write_poses(path: Path, T_world_cam0: Array) -> None:
    write_text(path, "".join(_numbers(pose[:3]) + "\n" for pose in T_world_cam0))


def _numbers(matrix: Array) -> str:
    return " ".join(f"{v:.12e}" for v in matrix.ravel().tolist())
