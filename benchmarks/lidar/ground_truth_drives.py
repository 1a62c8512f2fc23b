"""Simulated lidar drives for ``ground_truth.py``, which are read like real ones, with their exact truth."""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from relocbench.arrays import Array, Image, Times
from relocbench.datasets.groundtruth.blocks.nodes import make_nodes
from relocbench.datasets.groundtruth.jobs.writing import select_images
from relocbench.datasets.importers.robotcar.recording import read_robotcar_drives
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.drives.routes import RouteName, route
from relocbench.datasets.synthetic.jobs.recording import DriveOptions, prepare
from relocbench.datasets.synthetic.jobs.recording_jobs import carry_out
from relocbench.datasets.synthetic.town.town import make_district
from relocbench.execution import Run
from relocbench.files import atomic_write, write_text
from relocbench.geometry import Camera, interpolate_trajectory, invert, make_transform, transform_from_tq
from relocbench.progress import Advance

EXTENT_M = 400.0
FRAMES = 720
"""16 per second at 8 m/s, 360 m: the shortest route on which the test district has a detour"""
T_RIG_CAM = make_transform(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), [0, 0, 0])
"""a camera that looks ahead, at the rig's origin, 1.55 m above the road; it has times but no images, since only poses
are evaluated"""
_CAMERA = Camera("pinhole", 640, 480, 491.5, 491.5, 319.5, 239.5)


@dataclass(frozen=True)
class Leg:
    """One drive; its number determines the day, its position in the lane and all errors."""

    number: int
    condition: str
    route: RouteName

    @property
    def title(self) -> str:
        return self.condition if self.route == "common" else f"{self.condition}, {self.route}"


LEGS = (
    Leg(0, "Sunny", "common"),
    Leg(1, "Overcast", "common"),
    Leg(2, "Rain", "common"),
    Leg(3, "Snow", "common"),
    Leg(4, "Night", "common"),
    Leg(5, "Sunny", "periodic"),
    Leg(6, "Snow", "periodic"),
    Leg(7, "Rain", "crossing"),
    Leg(8, "Overcast", "detour"),
)
PAIRS = ((0, 1), (0, 2), (0, 3), (0, 4), (5, 6), (0, 7), (0, 8))
"""(reference, query), indices of drives"""


class Spoken:
    """Progress as lines on standard error."""

    def __init__(self) -> None:
        self.begin = time.monotonic()

    def note(self, message: str) -> None:
        print(f"[{time.monotonic() - self.begin:6.0f} s] {message}", file=sys.stderr, flush=True)

    @contextmanager
    def stage(self, description: str, total: int) -> Iterator[Advance]:
        done, shown = 0, time.monotonic()
        self.note(f"{description}: {total}")

        def advance(count: int) -> None:
            nonlocal done, shown
            done += count
            if time.monotonic() - shown > 15:
                shown = time.monotonic()
                self.note(f"{description}: {done} of {total}")

        yield advance


@dataclass(frozen=True, eq=False)
class Truth:
    """The exact motion of the rig, as the reader defines it."""

    times_ns: Times
    T_world_rig: Array
    """(N, 4, 4)"""

    def at(self, times_ns: Times) -> Array:
        """(M, 4, 4) ``T_world_rig``."""
        return interpolate_trajectory(self.times_ns, self.T_world_rig, times_ns)


@dataclass(frozen=True, eq=False)
class Ticks:
    """A camera that has only times."""

    times_ns: Times
    name: str = "front"
    camera: Camera = _CAMERA

    @property
    def T_rig_cam(self) -> Array:
        return T_RIG_CAM

    def read(self, index: int) -> Image:
        raise NotImplementedError("there are no images")

    def file(self, index: int) -> Path | None:
        return None


@dataclass(frozen=True, eq=False)
class Taken:
    """A drive as the builder gets it, and its truth, which the builder does not get."""

    leg: Leg
    recording: FieldRecording
    truth: Truth
    image_ns: tuple[int, ...]
    """times of images 1 m of road apart"""


def record_legs(
    legs: Sequence[Leg], out: Path, split: str, seed: int, frames: int, extent_m: float, spoken: Spoken, workers: int
) -> dict[int, Path]:
    """The folder of each drive by its number; existing recordings are kept."""
    index = out / "legs.csv"
    known: dict[int, Path] = {}
    if index.exists():
        with index.open(encoding="utf-8", newline="") as stream:
            known = {int(row["number"]): out / row["name"] for row in csv.DictReader(stream)}
        if all(leg.number in known for leg in legs):
            return known
    spoken.note(f"laying out the {split} district")
    town = make_district(seed, split, extent_m)
    length = DriveOptions(frames=frames).path_length_m
    recorded, jobs = dict(known), []
    for leg in legs:
        if leg.number in known:
            continue
        options = DriveOptions(seed=seed, number=leg.number, frames=frames, cameras=())
        path = route(town.network, town.periodic.street, leg.route, length, seed)
        found, job = prepare(town, path, condition_named(leg.condition).factors, out, options)
        recorded[leg.number] = found.folder
        jobs.append(job)
    carry_out(jobs, spoken, Run(workers))
    with atomic_write(index) as stream:
        stream.write("number,name\n")
        stream.writelines(f"{number},{folder.name}\n" for number, folder in recorded.items())
    return recorded


def read_legs(legs: Sequence[Leg], folders: dict[int, Path]) -> dict[int, Taken]:
    """The drives by number, with priors on one map."""
    recordings = read_robotcar_drives([folders[leg.number] for leg in legs])
    return {leg.number: taken_from(leg, recording) for leg, recording in zip(legs, recordings, strict=True)}


def taken_from(leg: Leg, recording: FieldRecording) -> Taken:
    """A drive with its truth, and the times at which it is a metre further."""
    stream = Ticks(recording.odometry.times_ns)
    chosen = select_images(recording, stream, make_nodes(recording), 1.0)
    return Taken(leg, recording, read_truth(recording), tuple(int(stream.times_ns[i]) for i in chosen))


def read_truth(recording: FieldRecording) -> Truth:
    """The transform between the RobotCar rig of the reader and the town's car, from a lidar's poses in both."""
    folder = recording.folder.parent / "truth" / recording.folder.name
    times = np.loadtxt(folder / "poses.csv", delimiter=",", skiprows=1, usecols=0, dtype=np.int64)
    values = np.loadtxt(folder / "poses.csv", delimiter=",", skiprows=1, usecols=range(1, 8))
    settings = yaml.safe_load((folder / "settings.yaml").read_text(encoding="utf-8"))
    lidar = recording.lidars[0]
    mounted = settings["sensors"]["T_rig_sensor"][lidar.name]
    T_car_lidar = transform_from_tq(np.array(mounted["translation_m"]), np.array(mounted["quaternion_xyzw"]))
    T_car_rig = T_car_lidar @ invert(lidar.T_rig_lidar)
    return Truth(times, transform_from_tq(values[:, :3], values[:, 3:]) @ T_car_rig)


def facade_period_m(folder: Path, split: str, seed: int, extent_m: float) -> float:
    """The period of the facades of the repeating street, which is kept beside the recording."""
    kept = folder / "period.txt"
    if not kept.exists():
        write_text(kept, f"{make_district(seed, split, extent_m).periodic.fronts[0].period_m!r}\n")
    return float(kept.read_text(encoding="utf-8"))
