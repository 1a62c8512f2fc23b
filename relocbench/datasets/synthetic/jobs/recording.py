"""Recording one drive through a district: cameras, lidars and odometry in a real data set's layout, and exact truth.

``OUT/truth/NAME`` holds what no importer reads: ``poses.csv``, ``T_world_rig`` at 100 Hz (between its lines the motion
*is* the interpolation of :func:`relocbench.geometry.interpolate_trajectory`); ``settings.yaml``, everything that
determines the drive (seeds, condition, cameras, extrinsics); ``drawn.yaml``, the random errors that are constant over
the drive; and ``moving_cars.csv``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from relocbench.arrays import Array, Times
from relocbench.datasets.core.schema import Transform
from relocbench.datasets.core.traversal import POSE_COLUMNS
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.drives.drive import RATE_HZ, STEP_NS, DriveStyle, Route, drive, route_length
from relocbench.datasets.synthetic.drives.traffic import on_the_road
from relocbench.datasets.synthetic.jobs.recording_jobs import DriveJob, carry_out
from relocbench.datasets.synthetic.jobs.recording_work import (
    Composer,
    DriveContext,
    RecordableDistrict,
    RendererFactory,
    town_compose,
    town_renderer,
)
from relocbench.datasets.synthetic.layouts import boreas as boreas_layout
from relocbench.datasets.synthetic.layouts import robotcar as robotcar_layout
from relocbench.datasets.synthetic.layouts.kitti import KittiLayout
from relocbench.datasets.synthetic.layouts.recorded import CarTrack, Layout, TrueTrajectory, car_tracks
from relocbench.errors import ConfigError, DatasetError, available
from relocbench.execution import Run
from relocbench.files import dump_yaml, read_bytes, remove_parts, write_table, write_text
from relocbench.geometry import make_transform, transform_to_tq
from relocbench.progress import Reporter, Silent
from relocbench.version import __version__

LEAD_NS = 500_000_000
"""time from the start of the drive to the first image or scan, and from the last one to the end"""
_TRUTH_NS = 10_000_000
_FIRST_US = 1_709_287_200_000_000
"""2024-03-01, 10:00; in the layouts of RobotCar and Boreas drive n is n days later"""
_DAY_US = 86_400_000_000


@dataclass(frozen=True)
class Recorded:
    """The folders of a recorded drive."""

    name: str
    """name of the traversal or sequence"""
    folder: Path
    """folder of its images and scans"""
    truth: Path


LayoutName = Literal["robotcar", "kitti", "boreas"]
RATES_HZ: dict[str, float] = {"robotcar": 16.0, "kitti": 10.0, "boreas": 10.0}
_USUAL_CAMERAS: dict[LayoutName, tuple[str, ...]] = {
    "robotcar": robotcar_layout.CAMERAS,
    "kitti": ("image_0", "image_1"),
    "boreas": boreas_layout.CAMERAS,
}


@dataclass(frozen=True)
class DriveOptions:
    """Options of a recorded drive."""

    layout: LayoutName = "robotcar"
    seed: int = 0
    """seed, together with ``number``, of everything random"""
    number: int = 0
    """number of the drive, which determines its day or sequence (KITTI), its motion and its errors"""
    frames: int = 160
    """stereo images per lens (RobotCar, 16 Hz) or frames (KITTI, Boreas, 10 Hz)"""
    scale: float = 0.5
    """image size relative to that of the real cameras"""
    cameras: tuple[str, ...] | None = None
    """cameras to record; default: all six of RobotCar, the two grey ones of KITTI, the one of Boreas"""
    style: DriveStyle = field(default_factory=DriveStyle)
    rings: int = 64
    """rings of the spinning lidar (KITTI, Boreas)"""
    azimuths: int = 2000
    """points per ring and turn of the spinning lidar (KITTI, Boreas)"""
    motion_distorted: bool = False
    """write scans of the spinning lidar without motion compensation (KITTI)"""

    @property
    def path_length_m(self) -> float:
        """Length of road that the drive needs. Raises ConfigError on an unknown layout or too few frames."""
        return path_length(self.frames, self.layout, self.style)

    def target(self, out: Path) -> Layout:
        """The layout that writes the drive below ``out``.

        Raises:
            ConfigError: the layout or a camera is unknown, or the scale is out of range.
        """
        _rate_hz(self.layout)
        if not 0 < self.scale <= 1:
            raise ConfigError(f"the scale of the images must be in (0, 1], got {self.scale}")
        chosen = _USUAL_CAMERAS[self.layout] if self.cameras is None else self.cameras
        drive, start_us = (out, self.frames, self.scale, chosen), _FIRST_US + self.number * _DAY_US
        if self.layout == "kitti":
            return KittiLayout(*drive, f"{self.number:02d}", self.rings, self.azimuths, not self.motion_distorted)
        if self.layout == "boreas":
            return boreas_layout.BoreasLayout(*drive, start_us, self.rings, self.azimuths)
        return robotcar_layout.RobotCarLayout(*drive, start_us)


def record(
    district: RecordableDistrict,
    path: Route,
    factors: Factors,
    out: Path,
    layout: LayoutName = "robotcar",
    *,
    reporter: Reporter | None = None,
    run: Run | None = None,
    renderer_factory: RendererFactory = town_renderer,
    compose: Composer = town_compose,
    **options: Any,
) -> Recorded:
    """Record one drive. A repeated call does only what is missing; the bytes do not depend on the number of workers.

    Args:
        path: the route to drive, at least ``path_length(frames, layout, style)`` metres long.
        renderer_factory, compose: as in :func:`carry_out`.
        options: fields of :class:`DriveOptions`.

    Raises:
        ConfigError: the layout or a camera is unknown, there are too few frames, or the path is too short.
        DatasetError: ``out`` holds another recording of this name.
    """
    recorded, job = prepare(district, path, factors, out, DriveOptions(layout, **options))
    carry_out([job], reporter or Silent(), run or Run(), renderer_factory, compose)
    return recorded


def prepare(
    district: RecordableDistrict, path: Route, factors: Factors, out: Path, options: DriveOptions
) -> tuple[Recorded, DriveJob]:
    """Write a drive's text files and truth, and return a job for the images and scans that are missing.

    Raises:
        ConfigError, DatasetError: like :func:`record`.
    """
    # Cluster workers have other working directories, so paths must be absolute.
    out = out.resolve()
    target = options.target(out)
    identity = (options.seed, options.number)
    trajectory, tracks = _drive(path, factors, target, options.style, identity, options.path_length_m)
    truth = out / "truth" / target.name
    for folder in (truth, target.folder):
        remove_parts(folder)
    cameras = {name: mount.camera.to_dict() for name, mount in target.cameras.items()}
    settings = {
        "layout": options.layout,
        "seed": options.seed,
        "number": options.number,
        "frames": options.frames,
        "scale": options.scale,
        "district_seed": district.seed,
        "factors": factors.model_dump(),
        "style": vars(options.style),
        "spinning": {
            "rings": options.rings,
            "azimuths": options.azimuths,
            "motion_distorted": options.motion_distorted,
        },
        "trajectory_sha256": hashlib.sha256(trajectory.T_world_rig.tobytes()).hexdigest(),
        "relocbench": __version__,
        "sensors": {"T_rig_sensor": _extrinsics(target), "cameras": cameras},
    }
    _claim(truth / "settings.yaml", settings)
    drawn = target.write_texts(trajectory, factors, int(np.random.SeedSequence([*identity, 3]).generate_state(1)[0]))
    write_text(truth / "drawn.yaml", dump_yaml(drawn))
    write_table(truth / "poses.csv", POSE_COLUMNS, _pose_rows(trajectory.times_ns, trajectory.T_world_rig))
    _write_cars(truth / "moving_cars.csv", tracks)
    scans, pictures = _missing(target, target.lidars), _missing(target, target.cameras)
    context = DriveContext(factors, target, trajectory, tracks, identity)
    return Recorded(target.name, target.folder, truth), DriveJob(district, context, truth, scans, pictures)


def path_length(frames: int, layout: str, style: DriveStyle | None = None) -> float:
    """Length of road in metres that a recording needs."""
    return route_length(_steps(frames, layout), style or DriveStyle())


def _steps(frames: int, layout: str) -> int:
    """Number of steps of the drive, including the time before the first and after the last image."""
    rate_hz = _rate_hz(layout)
    if frames < 2:
        raise ConfigError(f"a recording needs at least 2 frames, got {frames}")
    return int(np.ceil(((frames - 1) / rate_hz + 2 * LEAD_NS / 1e9) * RATE_HZ)) + 1


def _rate_hz(layout: str) -> float:
    """Images of each camera (RobotCar: of the stereo lenses) in a second. Raises ConfigError on an unknown layout."""
    if layout not in RATES_HZ:
        raise ConfigError(f"no recording layout '{layout}'{available(layout, RATES_HZ)}")
    return RATES_HZ[layout]


def _drive(
    path: Route, factors: Factors, layout: Layout, style: DriveStyle, seed: tuple[int, int], needed_m: float
) -> tuple[TrueTrajectory, list[CarTrack]]:
    """The smooth motion of a drive, and the tracks of the other cars."""
    if path.length < needed_m - 1e-6:
        raise ConfigError(f"the recording needs {needed_m:.1f} m of road, but the path is {path.length:.1f} m long")
    first = min(int(times[0]) for times in layout.times.values()) - LEAD_NS
    last = max(int(times[-1]) for times in layout.times.values())
    steps = int(np.ceil((last + LEAD_NS - first) / STEP_NS)) + 1
    rng = np.random.default_rng([*seed, 1])
    driven = drive(path, steps, style, rng)
    others = on_the_road(path, driven, factors.traffic, path.other_lane_m, rng)
    step_times = first + STEP_NS * np.arange(steps, dtype=np.int64)
    return _smooth(step_times, driven.T_world_rig), car_tracks(step_times, others)


def _smooth(times_ns: Times, T_world_rig: Array) -> TrueTrajectory:
    """Splines through the steps, with continuous velocity and angular velocity, sampled at 100 Hz."""
    fine = np.arange(times_ns[0], times_ns[-1] + 1, _TRUTH_NS, dtype=np.int64)
    knots, at = (times_ns - times_ns[0]) / 1e9, (fine - times_ns[0]) / 1e9
    position = CubicSpline(knots, T_world_rig[:, :3, 3], axis=0)(at)
    rotation = RotationSpline(knots, Rotation.from_matrix(T_world_rig[:, :3, :3]))(at).as_matrix()
    return TrueTrajectory(fine, make_transform(rotation, position))


def _missing(layout: Layout, sensors: Iterable[str]) -> list[tuple[str, int]]:
    """(sensor, index) of missing or truncated files, ordered by time so that images of one moment share a scene."""
    found = [
        (int(time), sensor, i)
        for sensor in sensors
        for i, time in enumerate(layout.times[sensor])
        if not layout.is_whole(sensor, layout.path(sensor, i))
    ]
    return [(sensor, i) for _, sensor, i in sorted(found)]


def _claim(path: Path, settings: Mapping[str, Any]) -> None:
    """Write the settings. Raises DatasetError if the folder holds another recording of this name."""
    text = dump_yaml(dict(settings))
    if path.exists() and read_bytes(path, "settings of a recording", DatasetError) != text.encode():
        raise DatasetError("belongs to another recording of this name; choose another folder or number", path)
    write_text(path, text)


def _extrinsics(layout: Layout) -> dict[str, Any]:
    mounts = {n: m.T_rig_cam for n, m in layout.cameras.items()} | {n: m.T_rig_lidar for n, m in layout.lidars.items()}
    return {name: Transform.of(pose).model_dump() for name, pose in mounts.items()}


def _write_cars(path: Path, tracks: Sequence[CarTrack]) -> None:
    """Write ``T_world_car`` at the steps of the drive; between them it is interpolated."""
    rows: list[list[Any]] = []
    for track in tracks:
        present = np.isfinite(track.T_world_car[:, 0, 0])
        poses = _pose_rows(track.times_ns[present], track.T_world_car[present])
        rows += ([time, track.variant, *pose] for time, *pose in poses)
    write_table(path, (POSE_COLUMNS[0], "variant", *POSE_COLUMNS[1:]), rows)


def _pose_rows(times_ns: Times, transforms: Array) -> list[list[Any]]:
    """Time and pose (8,) of each of the transforms (N, 4, 4)."""
    poses = np.hstack(transform_to_tq(transforms)).tolist()
    return [[time, *pose] for time, pose in zip(times_ns.tolist(), poses, strict=True)]
