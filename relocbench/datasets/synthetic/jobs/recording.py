"""Recording a drive through a district: cameras, lidars and odometry in a real data set's layout, and the exact truth.

``OUT/truth/NAME`` holds what no importer reads: ``poses.csv``, ``T_world_rig`` at 100 Hz (between its lines the motion
*is* the interpolation of :func:`relocbench.geometry.interpolate_trajectory`); ``settings.yaml``, all that the drive was
made of (seeds, condition, cameras, extrinsics); ``drawn.yaml``, errors that hold for the whole drive; and
``moving_cars.csv``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from relocbench.datasets.core.schema import Transform
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.drives.drive import RATE_HZ, STEP_NS, DriveStyle, Route, drive, route_length
from relocbench.datasets.synthetic.drives.traffic import moving_cars
from relocbench.datasets.synthetic.jobs.recording_jobs import DriveJob, carry_out
from relocbench.datasets.synthetic.jobs.recording_work import (
    Composer,
    RendererFactory,
    Town,
    town_compose,
    town_renderer,
)
from relocbench.datasets.synthetic.layouts import robotcar as robotcar_layout
from relocbench.datasets.synthetic.layouts.kitti import KittiLayout
from relocbench.datasets.synthetic.layouts.recorded import CarTrack, Layout, Trajectory, car_tracks
from relocbench.datasets.synthetic.town.network import LANE_M
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run
from relocbench.files import atomic_write, dump_yaml, read_bytes, remove_parts, write_text
from relocbench.geometry import make_transform, transform_to_tq
from relocbench.progress import Reporter, Silent
from relocbench.version import __version__

Array = NDArray[np.float64]

LEAD_NS = 500_000_000
"""the drive begins so long before the first image and ends so long after the last"""
_TRUTH_NS = 10_000_000
_FIRST_US = 1_709_287_200_000_000
"""2024-03-01, 10:00; drive n of the RobotCar layout is n days later"""
_DAY_US = 86_400_000_000


@dataclass(frozen=True)
class Recorded:
    """Where a recording lies."""

    name: str
    """of the traversal or sequence"""
    folder: Path
    """its images and scans"""
    truth: Path


LayoutName = Literal["robotcar", "kitti"]
LAYOUTS: tuple[LayoutName, ...] = ("robotcar", "kitti")


@dataclass(frozen=True)
class DriveOptions:
    """What is recorded of a drive, and how."""

    layout: LayoutName = "robotcar"
    seed: int = 0
    """of everything that is random; together with ``number``"""
    number: int = 0
    """of the drive: another day (RobotCar) or sequence (KITTI), another line in the lane, other errors"""
    frames: int = 160
    """stereo images of each lens (RobotCar, 16 Hz) or frames (KITTI, 10 Hz)"""
    scale: float = 0.5
    """size of the images over that of the real cameras"""
    cameras: tuple[str, ...] | None = None
    """which to record; all six of RobotCar, the two grey ones of KITTI by default"""
    style: DriveStyle = field(default_factory=DriveStyle)
    rings: int = 64
    """of the spinning lidar (KITTI)"""
    azimuths: int = 2000
    """of the spinning lidar (KITTI)"""
    motion_distorted: bool = False
    """leave the car's own motion in the scans of the spinning lidar (KITTI)"""

    @property
    def path_length_m(self) -> float:
        """Road that the drive needs. Raises ConfigError on an unknown layout or too few frames."""
        return path_length(self.frames, self.layout, self.style)

    def target(self, out: Path) -> Layout:
        """Raises ConfigError on an unknown layout or camera."""
        if self.layout not in LAYOUTS:
            raise ConfigError(f"no recording layout '{self.layout}'; there is {', '.join(LAYOUTS)}")
        if not 0 < self.scale <= 1:
            raise ConfigError(f"the scale of the images lies in (0, 1], got {self.scale}")
        if self.layout == "kitti":
            chosen = ("image_0", "image_1") if self.cameras is None else self.cameras
            spinning = (self.rings, self.azimuths, not self.motion_distorted)
            return KittiLayout(out, f"{self.number:02d}", self.frames, self.scale, chosen, *spinning)
        start = _FIRST_US + self.number * _DAY_US
        chosen = robotcar_layout.CAMERAS if self.cameras is None else self.cameras
        return robotcar_layout.RobotCarLayout(out, start, self.frames, self.scale, chosen)


def record(
    district: Town,
    path: Route,
    factors: Factors,
    out: Path,
    layout: LayoutName = "robotcar",
    *,
    reporter: Reporter | None = None,
    run: Run | None = None,
    renderer_factory: RendererFactory | None = None,
    compose: Composer | None = None,
    **options: Any,
) -> Recorded:
    """Record one drive. Run again, it does only what is missing; the bytes are the same for any number of workers.

    Args:
        path: what is driven; at least ``path_length(frames, layout, style)`` metres long.
        renderer_factory, compose: take the place of the town's own; importable, since workers import them.
        options: of :class:`DriveOptions`.

    Raises:
        ConfigError: an unknown layout or camera, too few frames, a path that is too short.
        DatasetError: ``out`` holds another recording of this name.
    """
    recorded, job = prepare(district, path, factors, out, DriveOptions(layout, **options))
    made = renderer_factory or town_renderer, compose or town_compose
    carry_out([job], *made, reporter or Silent(), run or Run())
    return recorded


def prepare(
    district: Town, path: Route, factors: Factors, out: Path, options: DriveOptions
) -> tuple[Recorded, DriveJob]:
    """Write a drive's texts and its truth; the images and scans that are missing are left to do.

    Raises:
        ConfigError, DatasetError: as :func:`record`.
    """
    # Workers of a cluster start in folders of their own.
    out = out.resolve()
    target = options.target(out)
    identity = (options.seed, options.number)
    trajectory, tracks = _drive(path, factors, target, options.style, identity, options.path_length_m)
    truth = out / "truth" / target.name
    for folder in (truth, target.folder):
        remove_parts(folder)
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
        "sensors": {"T_rig_sensor": _extrinsics(target), "cameras": _cameras(target)},
    }
    _claim(truth / "settings.yaml", settings)
    drawn = target.write_texts(trajectory, factors, int(np.random.SeedSequence([*identity, 3]).generate_state(1)[0]))
    write_text(truth / "drawn.yaml", dump_yaml(drawn))
    _write_poses(truth / "poses.csv", trajectory)
    _write_cars(truth / "moving_cars.csv", tracks)
    scans, pictures = _missing(target, target.lidars), _missing(target, target.cameras)
    job = DriveJob(district, factors, target, trajectory, tracks, identity, truth, scans, pictures)
    return Recorded(target.name, target.folder, truth), job


def path_length(frames: int, layout: str, style: DriveStyle | None = None) -> float:
    """Metres of road that a recording needs."""
    return route_length(_steps(frames, layout), style or DriveStyle())


def _steps(frames: int, layout: str) -> int:
    """Steps of the drive, lead and tail among them."""
    rate = {"robotcar": 16.0, "kitti": 10.0}
    if layout not in rate:
        raise ConfigError(f"no recording layout '{layout}'; there is {', '.join(rate)}")
    if frames < 2:
        raise ConfigError(f"a recording has at least 2 frames, got {frames}")
    return int(np.ceil(((frames - 1) / rate[layout] + 2 * LEAD_NS / 1e9) * RATE_HZ)) + 1


def _drive(
    path: Route, factors: Factors, layout: Layout, style: DriveStyle, seed: tuple[int, int], needed_m: float
) -> tuple[Trajectory, list[CarTrack]]:
    """The smooth motion through the steps of a drive, and the other cars."""
    if path.length < needed_m - 1e-6:
        raise ConfigError(f"the recording needs {needed_m:.1f} m of road, the path is {path.length:.1f} m long")
    first = min(int(times[0]) for times in layout.times.values()) - LEAD_NS
    last = max(int(times[-1]) for times in layout.times.values())
    steps = int(np.ceil((last + LEAD_NS - first) / STEP_NS)) + 1
    rng = np.random.default_rng([*seed, 1])
    driven = drive(path, steps, style, rng)
    others = moving_cars(path, driven, factors.traffic, LANE_M, rng)
    step_times = first + STEP_NS * np.arange(steps, dtype=np.int64)
    return _smooth(step_times, driven.T_world_rig), car_tracks(step_times, others)


def _smooth(times_ns: NDArray[np.int64], T_world_rig: Array) -> Trajectory:
    """Splines through the steps, with continuous velocity and turning rate, sampled at 100 Hz."""
    fine = np.arange(times_ns[0], times_ns[-1] + 1, _TRUTH_NS, dtype=np.int64)
    knots, at = (times_ns - times_ns[0]) / 1e9, (fine - times_ns[0]) / 1e9
    position = CubicSpline(knots, T_world_rig[:, :3, 3], axis=0)(at)
    rotation = RotationSpline(knots, Rotation.from_matrix(T_world_rig[:, :3, :3]))(at).as_matrix()
    return Trajectory(fine, make_transform(rotation, position))


def _missing(layout: Layout, sensors: Iterable[str]) -> list[tuple[str, int]]:
    """(sensor, index) of what is not there or torn, in order of time, so that images of one moment share a scene."""
    found = [
        (int(time), sensor, i)
        for sensor in sensors
        for i, time in enumerate(layout.times[sensor])
        if not layout.is_whole(sensor, layout.path(sensor, i))
    ]
    return [(sensor, i) for _, sensor, i in sorted(found)]


def _claim(path: Path, settings: Mapping[str, Any]) -> None:
    """A folder with another recording of this name is refused. Raises DatasetError."""
    text = dump_yaml(dict(settings))
    if path.exists() and read_bytes(path, "settings of a recording", DatasetError) != text.encode():
        raise DatasetError("another recording of this name lies here; choose another folder or number", path)
    write_text(path, text)


def _extrinsics(layout: Layout) -> dict[str, Any]:
    mounts = {n: m.T_rig_cam for n, m in layout.cameras.items()} | {n: m.T_rig_lidar for n, m in layout.lidars.items()}
    return {name: Transform.of(pose).model_dump() for name, pose in mounts.items()}


def _cameras(layout: Layout) -> dict[str, Any]:
    return {name: mount.camera.to_dict() for name, mount in layout.cameras.items()}


def _write_poses(path: Path, trajectory: Trajectory) -> None:
    t, q = transform_to_tq(trajectory.T_world_rig)
    with atomic_write(path) as stream:
        stream.write("timestamp_ns,tx,ty,tz,qx,qy,qz,qw\n")
        for time, values in zip(trajectory.times_ns.tolist(), np.hstack([t, q]).tolist(), strict=True):
            stream.write(f"{time},{','.join(map(repr, values))}\n")


def _write_cars(path: Path, tracks: Sequence[CarTrack]) -> None:
    """``T_world_car`` at the steps of the drive; between them it is interpolated."""
    with atomic_write(path) as stream:
        stream.write("timestamp_ns,variant,tx,ty,tz,qx,qy,qz,qw\n")
        for track in tracks:
            there = np.isfinite(track.T_world_car[:, 0, 0])
            t, q = transform_to_tq(track.T_world_car[there])
            for time, values in zip(track.times_ns[there].tolist(), np.hstack([t, q]).tolist(), strict=True):
                stream.write(f"{time},{track.variant},{','.join(map(repr, values))}\n")
