"""Writing recordings in the layout of the Boreas dataset.

``OUT/boreas-YYYY-MM-DD-HH-MM/{applanix,calib,camera,lidar}``; radar and ``imu.csv`` are not written. Axes of the
Applanix frame: x right, y forward, z up. The lidar is mounted turned by 43 degrees, as on the real car. Burnett et
al., Boreas: A Multi-Season Autonomous Driving Dataset, IJRR 2023.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array, Mask, Times
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.drives import odometry
from relocbench.datasets.synthetic.layouts.recorded import CameraMount, Layout, LidarMount, TrueTrajectory
from relocbench.datasets.synthetic.lidar import lidar
from relocbench.files import write_bytes, write_text
from relocbench.geometry import Camera, interpolate_trajectory, invert, make_transform, project_to_rotation

CAMERAS = ("camera",)
_CAMERA = Camera("pinhole", 2448, 2048, 1475.605190, 1475.366667, 1226.003331, 1031.566565)
"""the rectified camera of the development kit's ``P_camera.txt``"""
_T_RIG_APPLANIX = make_transform(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), [0.3, 0.0, 1.84])
"""to the rig of the simulation: x forward, y left, z up, origin on the road"""
_COS, _SIN = 0.7274135642622281, 0.6861993198242921
T_APPLANIX_LIDAR = make_transform(np.array([[_COS, -_SIN, 0.0], [_SIN, _COS, 0.0], [0.0, 0.0, 1.0]]), [0.0, 0.0, 0.21])
"""as published with the development kit"""
T_CAMERA_LIDAR = make_transform(
    project_to_rotation(np.array([[0.7293, -0.6842, -0.0005], [-0.0128, -0.0129, -0.9998], [0.6841, 0.7292, -0.0182]])),
    [-0.0231, -0.2294, -0.6353],
)
"""the relative pose of a standing car's lidar and camera, by the pose files published with the development kit"""
_HIGHEST_DEG, _LOWEST_DEG = 15.0, -25.0
"""vertical field of view of the Velodyne Alpha Prime"""
_PERIOD_NS = 100_000_000
_POSE_PERIOD_NS = 5_000_000
_LIDAR_PHASE_NS = 40_000_000
"""camera and lidar are not triggered together"""
POST_PROCESSED = odometry.InertialErrors(
    offset_m=(0.04, 0.04, 0.06), walk_m=0.004, noise_m=0.0, heading_deg=0.02, tilt_deg=0.005
)
"""post-processed GNSS/INS: 2 to 4 cm RMS by the dataset's data reference, smooth over seconds"""
_HEADER = "GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,angvel_z,angvel_y,angvel_x"
_POINT_BYTES = 24


@dataclass(frozen=True)
class BoreasLayout(Layout):
    """One drive."""

    start_us: int
    """time of the first image, microseconds since 1970"""
    rings: int
    """of the lidar; the real one has 128"""
    azimuths: int
    format = "Boreas"
    known_cameras = CAMERAS

    @property
    def name(self) -> str:
        return datetime.fromtimestamp(self.start_us // 1_000_000, UTC).strftime("boreas-%Y-%m-%d-%H-%M")

    @cached_property
    def cameras(self) -> Mapping[str, CameraMount]:
        T_rig_cam = _T_RIG_APPLANIX @ T_APPLANIX_LIDAR @ invert(T_CAMERA_LIDAR)
        return {name: CameraMount(_CAMERA.scaled(self.scale), T_rig_cam) for name in self.chosen}

    @cached_property
    def lidars(self) -> Mapping[str, LidarMount]:
        turning = lidar.spinning(self.rings, self.azimuths, _HIGHEST_DEG, _LOWEST_DEG)
        return {"lidar": LidarMount(turning, _T_RIG_APPLANIX @ T_APPLANIX_LIDAR)}

    @cached_property
    def times(self) -> Mapping[str, Times]:
        """Times by sensor; a scan's is that of the middle of its turn."""
        ticks = self.start_us * 1000 + np.arange(self.frames, dtype=np.int64) * _PERIOD_NS
        return {**dict.fromkeys(self.chosen, ticks), "lidar": ticks + _LIDAR_PHASE_NS}

    def is_scan_size(self, size: int) -> bool:
        return size > 0 and size % _POINT_BYTES == 0

    def write_scan(self, path: Path, points: Array, reflectance: Array, returned: Mask) -> None:
        """Write x, y, z, intensity, number of the laser and seconds since the middle of the turn, as float32."""
        mount = self.lidars["lidar"].lidar
        laser = np.repeat(np.arange(self.rings), self.azimuths)
        rows = np.column_stack([points, 255 * reflectance, laser, mount.offsets_ns / 1e9])
        write_bytes(path, rows[returned].astype("<f4").tobytes())

    def write_texts(self, trajectory: TrueTrajectory, factors: Factors, seed: int) -> dict[str, Any]:
        self._write_calibration()
        first = min(int(times[0]) for times in self.times.values()) - 4 * _PERIOD_NS
        last = max(int(times[-1]) for times in self.times.values()) + 4 * _PERIOD_NS
        times = np.arange(first, last + 1, _POSE_PERIOD_NS, dtype=np.int64)
        rng = np.random.default_rng([seed, 22])
        found = odometry.inertial(times, trajectory.at(times) @ _T_RIG_APPLANIX, POST_PROCESSED, rng)
        rows = pose_rows([f"{t // 10**9}.{t % 10**9 // 1000:06d}" for t in times.tolist()], times, found.T_world_body)
        write_text(self.folder / "applanix" / "gps_post_process.csv", "\n".join([_HEADER, *rows]) + "\n")
        sensors = {"lidar": T_APPLANIX_LIDAR}
        sensors |= {name: T_APPLANIX_LIDAR @ invert(T_CAMERA_LIDAR) for name in self.chosen}
        for name, T_applanix_sensor in sensors.items():
            at = self.times[name]
            poses = interpolate_trajectory(times, found.T_world_body, at) @ T_applanix_sensor
            rows = pose_rows([str(t // 1000) for t in at.tolist()], at, poses)
            write_text(self.folder / "applanix" / f"{name}_poses.csv", "\n".join([_HEADER, *rows]) + "\n")
        return {"applanix_offset_east_north_up_m": found.offset_m.tolist()}

    def _write_calibration(self) -> None:
        camera = _CAMERA.scaled(self.scale)
        projection = np.eye(4)
        projection[:3, :3] = camera.matrix
        files = {"P_camera": projection, "T_applanix_lidar": T_APPLANIX_LIDAR, "T_camera_lidar": T_CAMERA_LIDAR}
        for name, matrix in files.items():
            text = "".join(" ".join(f"{v:.18e}" for v in row) + "\n" for row in matrix.tolist())
            write_text(self.folder / "calib" / f"{name}.txt", text)


def pose_rows(names: Iterable[str], times_ns: Times, T_enu_sensor: Array) -> Iterable[str]:
    """Rows of a pose file; roll, pitch and heading are those of the rotation from ENU to the sensor.

    Args:
        names: the time of each row as it is written.
        times_ns: (N,) increasing, N at least 2.
        T_enu_sensor: (N, 4, 4)
    """
    seconds = (times_ns - times_ns[0]) / 1e9
    position = T_enu_sensor[:, :3, 3]
    velocity = np.gradient(position, seconds, axis=0)
    R_sensor_enu = np.swapaxes(T_enu_sensor[:, :3, :3], -1, -2)
    attitude = odometry.rpy_from_rotation(R_sensor_enu)
    turning = np.gradient(np.unwrap(attitude, axis=0), seconds, axis=0)[:, ::-1]
    values = np.hstack([position, velocity, attitude, turning]).tolist()
    return (",".join([name, *map(repr, row)]) for name, row in zip(names, values, strict=True))
