"""Writing recordings in the layout of the Oxford RobotCar dataset.

``OUT/TRAVERSAL/{stereo/left,stereo/centre,stereo/right,mono_left,mono_right,mono_rear,lms_front,lms_rear}``,
``*.timestamps``, ``vo/vo.csv``, ``gps/{ins,gps}.csv``, and beside the traversals ``extrinsics``, ``models`` and
``tags``, which the real data set's SDK has. Vehicle axes: x forward, y right, z down, origin at the left lens of the
stereo camera. Maddern et al., 1 Year, 1000 km: The Oxford RobotCar Dataset, IJRR 2017.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array, Image, Mask, Times
from relocbench.datasets.core import images
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.drives import odometry
from relocbench.datasets.synthetic.layouts import robotcar_odometry
from relocbench.datasets.synthetic.layouts.recorded import CameraMount, Layout, LidarMount, TrueTrajectory
from relocbench.datasets.synthetic.lidar import lidar
from relocbench.errors import DatasetError
from relocbench.files import plain_file, write_bytes, write_text
from relocbench.geometry import Camera, invert, make_transform

EXTRINSICS: dict[str, tuple[float, ...]] = {
    "stereo": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    "mono_left": (-0.0905, 1.6375, 0.2803, 0.2079, -0.2339, 1.2321),
    "mono_right": (-0.2587, -1.6810, 0.3226, -0.1961, -0.2469, -1.2675),
    "mono_rear": (-2.0582, 0.0894, 0.3675, -0.0119, -0.2498, 3.1283),
    "lms_front": (1.7589, 0.2268, 1.0411, -0.0437, -1.4572, 0.0356),
    "lms_rear": (-2.5850, 0.2852, 1.0885, -2.8405, -1.5090, -0.3614),
    "ins": (-1.7132, 0.1181, 1.1948, -0.0125, 0.0400, 0.0050),
}
"""x, y, z, roll, pitch, yaw as published with the dataset's SDK. Those of cameras map from the vehicle to the camera
(which the left camera's 1.6375 m and +70.6 degrees show), all others from the sensor to the vehicle."""

T_RIG_VEHICLE = make_transform(np.diag([1.0, -1.0, -1.0]), [0.4, 0.12, 1.55])
"""from the RobotCar vehicle to the rig of the simulation: x forward, y left, z up, origin on the road"""
_R_CAMERA_IMAGE = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""from image axes (x right, y down, z forward) to camera axes (x forward, y right, z down)"""


@dataclass(frozen=True)
class Lens:
    """A camera model file: undistorted pinhole intrinsics at full size, and the lens's offset to the right."""

    camera: str
    """the camera whose images it is for"""
    intrinsics: tuple[float, float, float]
    """focal length, cx, cy"""
    size: tuple[int, int]
    right_m: float = 0.0
    pattern: str = "GBRG"


LENSES: dict[str, Lens] = {
    "stereo_wide_left": Lens("stereo/left", (983.044006, 643.646973, 493.378998), (1280, 960)),
    "stereo_wide_right": Lens("stereo/right", (983.044006, 643.646973, 493.378998), (1280, 960), 0.239983),
    "stereo_narrow_left": Lens("stereo/centre", (964.828979, 643.788025, 484.407990), (1280, 960), 0.119997),
    "stereo_narrow_right": Lens("stereo/right", (964.828979, 643.788025, 484.407990), (1280, 960), 0.239983),
    "mono_left": Lens("mono_left", (400.0, 500.107605, 511.461426), (1024, 1024), pattern="RGGB"),
    "mono_right": Lens("mono_right", (400.0, 502.503754, 490.259033), (1024, 1024), pattern="RGGB"),
    "mono_rear": Lens("mono_rear", (400.0, 508.222931, 498.187378), (1024, 1024), pattern="RGGB"),
}
"""Intrinsics and baselines as published with the dataset's SDK. The SDK's narrow pair is relative to the centre lens;
here all lenses are relative to the left one, so that the files are exact. Images of a camera are rendered with the
first model for it; the look-up tables of its other models refer to these images."""

CAMERAS = tuple(dict.fromkeys(lens.camera for lens in LENSES.values()))
_STEREO_PERIOD_NS = 62_500_000
_MONO_PERIOD_NS = 90_000_000
_INS_PERIOD_NS = 20_000_000
_PHASES_NS = {"stereo": 0, "mono_left": 11_000_000, "mono_right": 12_000_000, "mono_rear": 13_000_000,
              "lms_front": 3_000_000, "lms_rear": 14_000_000, "ins": 1_000_000}  # fmt: skip
"""sensors are not triggered together"""
_CHUNK = 6000
"""images or scans per chunk"""
_SCAN_BYTES = 541 * 3 * 8


@dataclass(frozen=True)
class RobotCarLayout(Layout):
    """One traversal."""

    start_us: int
    """time of the first stereo image, microseconds since 1970"""
    format = "RobotCar"
    known_cameras = CAMERAS

    @property
    def name(self) -> str:
        return datetime.fromtimestamp(self.start_us // 1_000_000, UTC).strftime("%Y-%m-%d-%H-%M-%S")

    @cached_property
    def cameras(self) -> Mapping[str, CameraMount]:
        models = {self.model_of(camera): camera for camera in self.chosen}
        return {
            camera: CameraMount(self.camera(model), T_RIG_VEHICLE @ T_vehicle_image(model))
            for model, camera in models.items()
        }

    @cached_property
    def lidars(self) -> Mapping[str, LidarMount]:
        return {
            name: LidarMount(lidar.push_broom(), T_RIG_VEHICLE @ odometry.transform_from_xyzrpy(EXTRINSICS[name]))
            for name in ("lms_front", "lms_rear")
        }

    @cached_property
    def times(self) -> Mapping[str, Times]:
        stereo = {c: self._ticks("stereo", _STEREO_PERIOD_NS) for c in self.chosen if c.startswith("stereo")}
        mono = {c: self._ticks(c, _MONO_PERIOD_NS) for c in self.chosen if c.startswith("mono")}
        return stereo | mono | {name: self._ticks(name, 20_000_000) for name in self.lidars}

    def _ticks(self, sensor: str, period_ns: int) -> Times:
        """Times of a sensor, whole microseconds, while the stereo camera records."""
        duration = (self.frames - 1) * _STEREO_PERIOD_NS
        first = self.start_us * 1000 + _PHASES_NS[sensor]
        return np.arange(first, self.start_us * 1000 + duration + 1, period_ns, dtype=np.int64)

    def model_of(self, camera: str) -> str:
        """The camera model that a camera's images are rendered with."""
        return next(name for name, lens in LENSES.items() if lens.camera == camera)

    def camera(self, model: str) -> Camera:
        """The pinhole camera of a model file."""
        lens = LENSES[model]
        focal, cx, cy = lens.intrinsics
        return Camera("pinhole", *lens.size, focal, focal, cx, cy).scaled(self.scale)

    def is_scan_size(self, size: int) -> bool:
        return size == _SCAN_BYTES

    def write_image(self, camera: str, path: Path, rgb: Image) -> None:
        images.write_image(path, mosaic(rgb, LENSES[self.model_of(camera)].pattern))

    def write_scan(self, path: Path, points: Array, reflectance: Array, returned: Mask) -> None:
        """Write all 541 beams, (0, 0, 0) for those without a return."""
        write_bytes(path, np.column_stack([points[:, :2], reflectance]).astype("<f8").tobytes())

    def write_texts(self, trajectory: TrueTrajectory, factors: Factors, seed: int) -> dict[str, Any]:
        self._write_calibration()
        for sensor in {name.split("/")[0]: name for name in self.times}.values():
            rows = (f"{t // 1000} {1 + i // _CHUNK}\n" for i, t in enumerate(self.times[sensor].tolist()))
            write_text(self.folder / f"{sensor.split('/')[0]}.timestamps", "".join(rows))
        write_text(self.root / "tags" / f"{self.name}.yaml", "".join(f"- {tag}\n" for tag in tags(factors)))
        times = self._ticks("stereo", _STEREO_PERIOD_NS)
        text = robotcar_odometry.vo_text(times, trajectory.at(times) @ T_RIG_VEHICLE, np.random.default_rng([seed, 21]))
        write_text(self.folder / "vo" / "vo.csv", text)
        times = self._ticks("ins", _INS_PERIOD_NS)
        instrument = trajectory.at(times) @ T_RIG_VEHICLE @ odometry.transform_from_xyzrpy(EXTRINSICS["ins"])
        texts, drawn = robotcar_odometry.gps_texts(times, instrument, np.random.default_rng([seed, 22]))
        for name, text in texts.items():
            write_text(self.folder / "gps" / name, text)
        return drawn

    def _write_calibration(self) -> None:
        """Write extrinsics and models, which all traversals in the folder share."""
        files = {
            f"extrinsics/{name}.txt": (" ".join(f"{v:.4f}" for v in values) + "\n").encode()
            for name, values in EXTRINSICS.items()
        }
        for model, lens in LENSES.items():
            files[f"models/{model}.txt"] = model_text(self.camera(model), lens).encode()
            files[f"models/{model}_distortion_lut.bin"] = self._look_up_table(model)
        for name, data in files.items():
            path = self.root / name
            if not path.exists():
                write_bytes(path, data)
            elif plain_file(path, "a table").read_bytes() != data:
                raise DatasetError("belongs to recordings with another image size; choose another folder", path)

    def _look_up_table(self, model: str) -> bytes:
        """The look-up table of a model: u, then v in the recorded image of each undistorted pixel, float64."""
        camera = self.camera(model)
        recorded = self.camera(self.model_of(LENSES[model].camera))
        v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
        u = recorded.fx / camera.fx * (u - camera.cx) + recorded.cx
        v = recorded.fy / camera.fy * (v - camera.cy) + recorded.cy
        return np.stack([u.ravel(), v.ravel()]).astype("<f8").tobytes()


def T_vehicle_image(model: str) -> Array:
    """(4, 4) from image axes to the vehicle: the camera's extrinsics combined with the lens's offset."""
    lens = LENSES[model]
    T_camera_image = make_transform(_R_CAMERA_IMAGE, [0.0, lens.right_m, 0.0])
    T_camera_vehicle = odometry.transform_from_xyzrpy(EXTRINSICS[lens.camera.split("/")[0]])
    return np.asarray(invert(T_camera_vehicle) @ T_camera_image)


def model_text(camera: Camera, lens: Lens) -> str:
    """Text of a model file: ``fx fy cx cy``, then the 4x4 G_camera_image."""
    T_camera_image = make_transform(_R_CAMERA_IMAGE, [0.0, lens.right_m, 0.0])
    first = f"{camera.fx:.6f} {camera.fy:.6f} {camera.cx:.6f} {camera.cy:.6f}\n"
    return first + "".join(" ".join(f"{v:.6f}" for v in row) + "\n" for row in T_camera_image)


def mosaic(rgb: Image, pattern: str) -> Image:
    """Bayer mosaic (H, W) of an image (H, W, 3); ``pattern`` names the colours of the top left 2x2 pixels."""
    out = np.empty(rgb.shape[:2], dtype=np.uint8)
    for k, colour in enumerate(pattern):
        row, column = divmod(k, 2)
        out[row::2, column::2] = rgb[row::2, column::2, "RGB".index(colour)]
    return out


def tags(factors: Factors) -> list[str]:
    """The dataset's tags that describe a condition."""
    if factors.sun_elevation_deg < -6:
        light = "night"
    elif factors.sun_elevation_deg < 3:
        light = "dusk"
    else:
        light = "overcast" if factors.cloud_cover > 0.8 else "clouds" if factors.cloud_cover > 0.4 else "sun"
    falling = ["rain"] if factors.rain_mm_h > 0 else []
    lying = ["snow"] if factors.snow_cover > 0.2 or factors.snowfall_mm_h > 0 else []
    return [light, *falling, *lying]
