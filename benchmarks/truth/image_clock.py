"""What the images say of the clock of the poses, where it is known how far off it is.

Drives through rendered towns of the training split are rendered with exact poses, by a car at ten images a second and
by a camera in a hand at thirty, with all rows at once or one after the other within 25 ms, with depth of each image.
The poses are then recorded a hundred times a second (car: also twenty) with noise as that of motion capture or GNSS,
and their clock is set off by -50 to 50 ms. Of recordings (datasets that are given, with the poses in
``groundtruth.txt`` where one is named), whose own offset is not known, the clock is set off by the same: what is
counted is by how much the estimates follow.

    python benchmarks/truth/image_clock.py [--seeds 11,12] [--scratch S] [DATASET[@TRAJECTORY] ...]

Printed are, for each kind of drive: the mean and the largest error of the estimate, its standard deviation as stated,
the mean squared normalised error, which is 1 where that is right, the mean error of rotations that take all rows for
read at once, and the verdicts. The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from relocbench.arrays import Array, Times
from relocbench.datasets.clock.check import ClockCheck, check_clock, judge
from relocbench.datasets.clock.evidence import gather, own_trajectory
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.images import write_depth, write_image
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.schema import CameraEntry, TraversalFile
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.sensors.pose_tables import read_trajectory
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS
from relocbench.datasets.synthetic.drives.drive import RATE_HZ, DriveStyle, drive, route_length
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.geometry import Camera, make_transform, se3_exp, so3_exp

_START_NS = 1_700_000_000_000_000_000
_EXTENT_M = 180.0
_STRIPS = 8
"""parts of an image that stand for rows which are read together"""
_CAMERA = Camera("pinhole", 320, 240, 250.0, 250.0, 159.5, 119.5)
_T_CAR_CAM = make_transform(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), [0, 0, 1.5])
_NAME = "drive"


@dataclass(frozen=True)
class Kind:
    """A kind of drive."""

    title: str
    by_hand: bool
    readout_s: float
    images: int
    poses_hz: int
    noise_m: float
    noise_deg: float


KINDS = (
    Kind("hand, 40 images, all rows at once, exact poses", True, 0.0, 40, 100, 0.0, 0.0),
    Kind("hand, 40 images, motion capture", True, 0.0, 40, 100, 0.001, 0.05),
    Kind("hand, 40 images, rows within 25 ms, motion capture", True, 0.025, 40, 100, 0.001, 0.05),
    Kind("hand, 10 images, rows within 25 ms, motion capture", True, 0.025, 10, 100, 0.001, 0.05),
    Kind("car, 60 images, all rows at once, exact poses", False, 0.0, 60, 100, 0.0, 0.0),
    Kind("car, 60 images, all rows at once, GNSS/INS at 20 Hz", False, 0.0, 60, 20, 0.01, 0.02),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="*", metavar="DATASET[@TRAJECTORY]")
    parser.add_argument("--seeds", default="11,12,13")
    parser.add_argument("--offsets", default="-50,-20,-5,0,5,20,50", help="milliseconds by which clocks are set off")
    parser.add_argument("--scratch", type=Path, help="folder that keeps the rendered drives")
    options = parser.parse_args()
    offsets = [int(text) for text in options.offsets.split(",")]
    found: dict[str, Any] = {}
    heads = ("drive", "offsets", "mean error, ms", "largest", "stated sigma, median", "NES", "rows at once", "verdicts")
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    with tempfile.TemporaryDirectory() as temporary:
        scratch = options.scratch or Path(temporary)
        seeds = [int(seed) for seed in options.seeds.split(",") if seed]
        for kind in KINDS if seeds else ():
            checks = [one for seed in seeds for one in rendered_checks(kind, seed, scratch, offsets)]
            found[kind.title] = row(kind.title, checks)
    for given in options.datasets:
        folder, _, table = given.partition("@")
        dataset = Dataset(folder)
        for name in dataset.traversal_names:
            traversal = dataset.traversal(name)
            for camera in traversal.cameras:
                title = f"{dataset.name} {name} {camera}"
                found[title] = row(
                    title, list(recorded_checks(traversal, camera, Path(table) if table else None, offsets))
                )
    print(json.dumps({"benchmark": "image_clock", **found}))


def row(title: str, checks: Sequence[tuple[float, ClockCheck]]) -> dict[str, Any]:
    """Print a row of the table; each check has the offset (s) that its poses were set off by."""
    verdicts = dict(Counter(check.verdict for _, check in checks))
    told = [(planted, check) for planted, check in checks if np.isfinite(check.offset_s)]
    error = np.array([1000 * (check.offset_s - planted) for planted, check in told])
    sigma = np.array([1000 * check.sigma_s for _, check in told])
    false = sum(check.verdict == "offset" for planted, check in checks if planted == 0)
    values: dict[str, Any] = {"offsets": len(checks), "verdicts": verdicts, "offset_where_none": false}
    if told:
        values |= {
            "bias_ms": round(float(np.mean(error)), 2),
            "largest_ms": round(float(np.max(np.abs(error))), 2),
            "sigma_ms": round(float(np.median(sigma)), 2),
            "nes": round(float(np.mean((error / sigma) ** 2)), 2),
            "rows_at_once_ms": round(float(np.mean([1000 * (c.pinhole_offset_s - planted) for planted, c in told])), 2),
        }
    words = ", ".join(f"{verdict} {count}" for verdict, count in verdicts.items())
    cells = [str(values.get(key, "")) for key in ("bias_ms", "largest_ms", "sigma_ms", "nes", "rows_at_once_ms")]
    print(f"| {title} | {len(checks)} | {' | '.join(cells)} | {words} |", flush=True)
    return values


def recorded_checks(
    traversal: Traversal, camera: str, table: Path | None, offsets: Sequence[int]
) -> Iterator[tuple[float, ClockCheck]]:
    """What is found of a recording whose clock is set off, less what is found of it as it is."""
    trajectory = own_trajectory(traversal)
    if table is not None:
        poses = read_trajectory(table)
        trajectory = Trajectory(poses.times_ns, poses.transforms, 100_000_000)
    evidence = gather(traversal, camera, trajectory, in_process)
    for planted in offsets:
        moved = shifted(trajectory, planted)
        if isinstance(evidence, str):
            yield planted / 1000, check_clock(traversal, camera, moved, in_process)
        else:
            yield planted / 1000, judge(evidence, moved)


def rendered_checks(kind: Kind, seed: int, scratch: Path, offsets: Sequence[int]) -> Iterator[tuple[float, ClockCheck]]:
    """What is found of a rendered drive at each offset of the clock of its poses."""
    traversal, motion, last_s = rendered(kind, seed, scratch)
    rng = np.random.default_rng([seed, 9])
    times = np.arange(-0.2, last_s + 0.2, 1 / kind.poses_hz)
    noise = np.hstack(
        [rng.normal(0, kind.noise_m, (len(times), 3)), rng.normal(0, np.radians(kind.noise_deg), (len(times), 3))]
    )
    trajectory = Trajectory(_ns(times), motion(times) @ se3_exp(noise))
    evidence = gather(traversal, "cam0", trajectory, in_process)
    assert not isinstance(evidence, str), evidence
    for planted in offsets:
        yield planted / 1000, judge(evidence, shifted(trajectory, planted))


def shifted(trajectory: Trajectory, planted_ms: int) -> Trajectory:
    """The trajectory with a clock that is so much ahead: an image at t has its pose at t + planted."""
    return Trajectory(trajectory.times_ns + planted_ms * 1_000_000, trajectory.T_odom_rig, trajectory.max_gap_ns)


def in_process(title: str, step: Callable[[Any], Any], units: Sequence[Any]) -> list[Any]:
    """Do the units' work here."""
    return [step(unit) for unit in units]


def rendered(kind: Kind, seed: int, scratch: Path) -> tuple[Traversal, Callable[[Array], Array], float]:
    """A rendered drive, its motion ``T_world_cam`` at seconds, and the time of its last image."""
    place = DistrictSpec(seed, "train", _EXTENT_M)
    motion = by_hand(place, seed) if kind.by_hand else by_car(place, seed, kind.images)
    rate = 30.0 if kind.by_hand else 10.0
    seconds = 0.5 + np.arange(kind.images) / rate
    root = scratch / f"clock-{seed}-{'hand' if kind.by_hand else 'car'}-{kind.images}-{1000 * kind.readout_s:.0f}"
    if not (root / "manifest.csv").exists():
        writer = DatasetWriter(root, "clock", {"kind": "rendered", "seed": seed})
        cameras = {"cam0": CameraEntry.of(_CAMERA)}
        writer.traversal(
            TraversalFile(name=_NAME, cameras=cameras), dict(zip(_ns(seconds).tolist(), motion(seconds), strict=True))
        )
        for index, time in enumerate(seconds):
            image, depth = photograph(place, motion, float(time), kind.readout_s, seed * 1000 + index)
            stamp = int(_ns(np.array([time]))[0])
            write_image(writer.layout.traversal(_NAME).image("cam0", stamp), image)
            write_depth(writer.layout.traversal(_NAME).depth("cam0", stamp), depth)
        writer.finish({})
    return Traversal(DatasetLayout(root).traversal(_NAME)), motion, float(seconds[-1])


def photograph(
    place: DistrictSpec, motion: Callable[[Array], Array], time_s: float, readout_s: float, seed: int
) -> tuple[Any, Any]:
    """Image and depth, whose rows are read in strips, the middle of the image at its time; depth is of one moment."""
    renderer = scenes.renderer(place, CONDITIONS["Overcast"].factors)
    whole = renderer.render(_CAMERA, motion(np.array([time_s]))[0], seed)
    if readout_s == 0.0:
        return whole.rgb, whole.depth
    image = whole.rgb.copy()
    height = _CAMERA.height // _STRIPS
    for strip in range(_STRIPS):
        late = readout_s * ((strip + 0.5) / _STRIPS - 0.5)
        part = Camera("pinhole", _CAMERA.width, height, _CAMERA.fx, _CAMERA.fy, _CAMERA.cx, _CAMERA.cy - strip * height)
        rows = renderer.render(part, motion(np.array([time_s + late]))[0], seed + 500 * (strip + 1))
        image[strip * height : (strip + 1) * height] = rows.rgb
    return image, whole.depth


def by_car(place: DistrictSpec, seed: int, images: int) -> Callable[[Array], Array]:
    """A car's drive along streets of the district."""
    style = DriveStyle()
    steps = int(np.ceil((images / 10.0 + 2.0) * RATE_HZ))
    route = scenes.district(place).network.drive(route_length(steps, style), seed)
    driven = drive(route, steps, style, np.random.default_rng([seed, 1]))
    return _splines(np.arange(steps) / RATE_HZ - 0.5, driven.T_world_rig @ _T_CAR_CAM)


def by_hand(place: DistrictSpec, seed: int) -> Callable[[Array], Array]:
    """A camera in a hand, somewhere on a street: up to about 1 rad/s and 0.5 m/s, changing within tenths of seconds."""
    style = DriveStyle()
    route = scenes.district(place).network.drive(route_length(20, style), seed)
    stand = drive(route, 20, style, np.random.default_rng([seed, 1])).T_world_rig[10] @ _T_CAR_CAM
    rng = np.random.default_rng([seed, 2])
    knots = np.arange(-1.0, 4.0, 0.25)
    move = CubicSpline(knots, rng.normal(0, 0.06, (len(knots), 3)))
    turn = CubicSpline(knots, rng.normal(0, 0.1, (len(knots), 3)))

    def at(seconds: Array) -> Array:
        return np.array([stand @ make_transform(so3_exp(turn(s)), move(s)) for s in seconds])

    return at


def _splines(seconds: Array, poses: Array) -> Callable[[Array], Array]:
    position = CubicSpline(seconds, poses[:, :3, 3], axis=0)
    rotation = RotationSpline(seconds, Rotation.from_matrix(poses[:, :3, :3]))
    return lambda at: make_transform(rotation(at).as_matrix(), position(at))


def _ns(seconds: Array) -> Times:
    return _START_NS + np.round(seconds * 1e9).astype(np.int64)


if __name__ == "__main__":
    main()
