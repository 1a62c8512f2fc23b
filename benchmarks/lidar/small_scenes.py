"""Ground truth from lidars and depth cameras that are carried through rooms: what is accepted and how far off it is.

Two walks through each of some furnished rooms of 4 to 6 m are simulated with exact truth: the second one is another
day's, along another way, with other errors. A spinning lidar has noise of 8 mm; a depth camera looks ahead and down,
with noise that grows with the square of the distance: 5 mm at 1.5 m, 20 mm at 3 m. Noise does not shrink with the
scene, as that of a street would if it were made smaller. Odometry is off in scale and drifts. The build measures the
scale itself. A pair is wrong if it is off by more than 0.3 m divided by this scale, which is of a room what 0.3 m are
of a street, or by 1 degree; the normalised error squared is the mean of ``e^T C^-1 e / 6``, which is 1 if covariances
are correct.

    python benchmarks/lidar/small_scenes.py [--seeds 1,2] [--cases lidar,depth] [--scale 8]

The table goes to standard error; the last line of standard output is JSON.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"  # in each worker

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from case_figures import Off, case_figures, off_truth
from ground_truth_drives import Spoken
from ground_truth_judging import WRONG_DEG, WRONG_M
from register_scenes import Boxes, camera_directions, room, sphere_directions

from relocbench.arrays import Array, Times
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.groundtruth.jobs.aligning import align
from relocbench.datasets.groundtruth.jobs.measuring import scale_of_drives
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.groundtruth.jobs.scaling import enlarged, reduced_paired
from relocbench.datasets.groundtruth.jobs.writing import select_images
from relocbench.datasets.groundtruth.pairs.outcome import PairOutcome
from relocbench.datasets.groundtruth.pairs.pairing import CameraFrames, PairingUnit, pair_up
from relocbench.datasets.sensors.recording import FieldRecording, Scan, Trajectory
from relocbench.execution import Run
from relocbench.geometry import invert, make_transform, se3_exp, so3_exp

Device = Literal["lidar", "depth"]

TITLES: dict[Device, str] = {
    "lidar": "rooms, a lidar carried by hand, noise 8 mm",
    "depth": "rooms, a depth camera, noise 5 mm at 1.5 m",
}
APART_M = 0.15
"""between keyframes, and between queries"""
_LIDAR_NOISE_M = 0.008
_DEPTH_NOISE_M, _DEPTH_AT_M, _DEPTH_FARTHEST_M = 0.005, 1.5, 4.5
_T_RIG_CAM = make_transform(
    np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]) @ so3_exp([-0.25, 0.0, 0.0]), [0.05, 0, 0.1]
)
_START_NS, _PERIOD_NS = 1_700_000_000_000_000_000, 100_000_000
_SPEED = 0.4
_DRIFT_M, _DRIFT_DEG, _SCALE_ERROR = 0.002, 0.05, 0.01
"""standard deviations of the odometry's errors: for the root of each metre, and of its scale"""


@lru_cache(maxsize=2)
def _room(seed: int) -> tuple[Boxes, Array]:
    return room(seed)


@lru_cache(maxsize=8)
def _directions(device: Device, step_deg: float) -> Array:
    if device == "lidar":
        return sphere_directions(step_deg, -50.0)
    columns = round(240 / step_deg)
    return camera_directions(columns, 3 * columns // 4, 0.8 * columns)


@dataclass(frozen=True, eq=False)
class Carried:
    """What a person carries through a room: the lidar of a recording, with scans that are not distorted."""

    seed: int
    walk: int
    device: Device
    truth: Trajectory
    step_deg: float = 3.0
    pattern: Literal["push-broom", "spinning"] = "spinning"

    @property
    def name(self) -> str:
        return self.device

    @property
    def T_rig_lidar(self) -> Array:
        return np.eye(4) if self.device == "lidar" else _T_RIG_CAM

    @property
    def times_ns(self) -> Times:
        return self.truth.times_ns

    @property
    def max_range_m(self) -> float:
        return 30.0 if self.device == "lidar" else _DEPTH_FARTHEST_M

    @property
    def sigma_m(self) -> float:
        return _LIDAR_NOISE_M if self.device == "lidar" else _DEPTH_NOISE_M

    def read(self, index: int) -> Scan:
        """Measure from the pose at a time; the same scan whenever it is asked for."""
        rng = np.random.default_rng([self.seed, self.walk, index])
        T_world_sensor = self.truth.T_odom_rig[index] @ self.T_rig_lidar
        points = _room(self.seed)[0].seen(T_world_sensor, _directions(self.device, self.step_deg), 0.0, rng)
        far = np.linalg.norm(points, axis=1) if self.device == "lidar" else points[:, 2]
        square = np.square(far / _DEPTH_AT_M)
        sigma = _LIDAR_NOISE_M if self.device == "lidar" else _DEPTH_NOISE_M * square
        points = points * (1 + sigma * rng.normal(size=len(far)) / far)[:, None]
        points = points[np.linalg.norm(points, axis=1) < self.max_range_m]
        return Scan(points, np.full(len(points), self.times_ns[index]))


@dataclass(frozen=True, eq=False)
class Walk:
    """A recording and its truth, which the build does not get."""

    recording: FieldRecording
    truth: Trajectory
    """``T_world_rig``"""


def record(
    seed: int, walk: int, device: Device, *, laps: float = 1.5, step_deg: float = 3.0, period_ns: int = _PERIOD_NS
) -> Walk:
    """A walk around the middle of the room of a seed, looking about."""
    size = _room(seed)[1]
    rng = np.random.default_rng([seed, walk, 8])
    radii = size[:2] * rng.uniform(0.18, 0.24, 2)
    around = 2 * np.pi * np.sqrt(np.mean(radii**2))
    seconds = np.arange(0.0, laps * around / _SPEED, period_ns / 1e9)
    phase = 2 * np.pi * _SPEED * seconds / around
    sway = 0.03 * np.sin(seconds[:, None] * rng.uniform(1.0, 2.0, 3) + rng.uniform(0, 6, 3))
    height = np.full_like(phase, rng.uniform(1.3, 1.5))
    position = np.stack([radii[0] * np.cos(phase), radii[1] * np.sin(phase), height], axis=1) + sway
    yaw = phase + np.pi / 2 + 0.4 * np.sin(0.35 * seconds + rng.uniform(0, 6))
    tilt = 0.08 * np.sin(seconds[:, None] * [0.5, 0.8, 0.0] + rng.uniform(0, 6, 3)) * [1.0, 1.0, 0.0]
    R = so3_exp(yaw[:, None] * [0.0, 0.0, 1.0]) @ so3_exp(tilt)
    times = _START_NS + np.arange(len(seconds), dtype=np.int64) * period_ns
    truth = Trajectory(times, make_transform(R, position))
    told = _drifting(truth, np.random.default_rng([seed, walk, 9]))
    condition = Condition(weather="clear", season="summer", time_of_day="day")
    carried = Carried(seed, walk, device, truth, step_deg)
    return Walk(FieldRecording(f"walk{walk}", Path(f"room{seed}"), condition, told, (carried,)), truth)


def _drifting(truth: Trajectory, rng: np.random.Generator) -> Trajectory:
    """Odometry in a frame of its own."""
    steps = invert(truth.T_odom_rig[:-1]) @ truth.T_odom_rig[1:]
    steps[:, :3, 3] *= 1.0 + _SCALE_ERROR * rng.normal()
    root = np.sqrt(np.linalg.norm(steps[:, :3, 3], axis=1))[:, None]
    errors = rng.normal(size=(len(steps), 6)) * root * np.repeat([_DRIFT_M, np.radians(_DRIFT_DEG)], 3)
    poses = [make_transform(so3_exp([0.0, 0.0, float(rng.uniform(0, 6))]), rng.uniform(-2, 2, 3))]
    for step in steps @ se3_exp(errors):
        poses.append(poses[-1] @ step)
    return Trajectory(truth.times_ns, np.array(poses))


def outcomes(
    walks: Sequence[Walk], folder: Path, options: FieldOptions, spoken: Spoken, workers: int
) -> tuple[list[PairOutcome], float]:
    """The pairs of a build of poses of the rig, and the factor by which the scene was enlarged."""
    recordings = [walk.recording for walk in walks]
    scale = scale_of_drives(recordings, options.scale, spoken)
    spoken.note(f"scale: {scale.reason}")
    large = [enlarged(recording, scale.factor) for recording in recordings]
    estimate = options.calibration == "estimate"
    aligned = align(large, folder, options.alignment, None, estimate, spoken, Run(workers), scale.factor)
    times = []
    for recording, drive in zip(recordings, aligned.drives, strict=True):
        stream = recording.rig_stream("rig")
        chosen = select_images(recording, stream, drive.nodes, APART_M * scale.factor)
        times.append(tuple(int(stream.times_ns[i]) for i in chosen))
    name = aligned.drives[1].name
    frames = CameraFrames("rig", np.eye(4), np.eye(4), times[0], times[1])
    limits = options.limits_at(scale.factor), options.max_angle
    drives, registrations = (aligned.drives[0], aligned.drives[1]), tuple(aligned.registrations[name])
    unit = PairingUnit(*drives, registrations, (frames,), *limits, aligned.shared.get(name))
    return reduced_paired(pair_up(unit), scale.factor).outcomes["rig"], scale.factor


def off(walks: Sequence[Walk], pair: PairOutcome) -> Off:
    """How far a pair with a pose is off the truth."""
    T_world_ref = walks[0].truth.at(np.array([pair.ref_timestamp_ns]))[0]
    T_world_query = walks[1].truth.at(np.array([pair.query_timestamp_ns]))[0]
    return off_truth(pair, invert(T_world_query) @ T_world_ref)


def line(title: str, f: dict[str, Any]) -> str:
    """A row of the table in Markdown."""
    if not f["accepted"]:
        return f"| {title} | 0 of {f['pairs']} | | | |"
    return (
        f"| {title} | {f['accepted']} of {f['pairs']} | {1000 * f['median_m']:.1f} mm, {f['median_deg']:.3f}° | "
        f"{1000 * f['max_m']:.1f} mm, {f['max_deg']:.3f}° | {f['normalised']} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, help="folder of all intermediate files; default: one that is removed")
    parser.add_argument("--seeds", default="1,2", help="of the rooms")
    parser.add_argument("--cases", default="lidar,depth")
    parser.add_argument("--scale", default="auto", help="as in build-dataset; 1 as if there were none")
    parser.add_argument("--workers", type=int, default=1)
    a = parser.parse_args()
    chosen: list[Device] = [case for case in TITLES if case in a.cases.split(",")]
    if unknown := set(a.cases.split(",")) - set(TITLES):
        parser.error(f"no case {', '.join(sorted(unknown))}; there is {', '.join(TITLES)}")
    options = FieldOptions(scale=a.scale if a.scale == "auto" else float(a.scale))
    spoken, result, lines = Spoken(), {}, []
    with tempfile.TemporaryDirectory() as temporary:
        for case in chosen:
            found: list[PairOutcome] = []
            errors: list[Off] = []
            factors: list[float] = []
            wrong = 0
            for seed in map(int, a.seeds.split(",")):
                walks = [record(seed, walk, case) for walk in range(2)]
                folder = (a.work or Path(temporary)) / case / str(seed)
                pairs, factor = outcomes(walks, folder, options, spoken, a.workers)
                mine = [off(walks, pair) for pair in pairs if pair.accepted]
                wrong += sum(metres > WRONG_M / factor or degrees > WRONG_DEG for metres, degrees, _ in mine)
                found, errors, factors = found + pairs, errors + mine, [*factors, round(factor, 2)]
            result[case] = case_figures(found, errors, wrong) | {"factors": factors}
            lines.append(line(TITLES[case], result[case]))
            spoken.note(lines[-1])
    head = "| situation | accepted | median | largest | normalised squared error |"
    print("\n".join(["", head, "|---" * 5 + "|", *lines, ""]), file=sys.stderr)
    print(json.dumps({"benchmark": "small_scenes", "seeds": a.seeds, "scale": a.scale, "cases": result}))


if __name__ == "__main__":
    main()
