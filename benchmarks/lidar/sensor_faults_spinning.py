"""Simulated drives with a spinning lidar for ``sensor_faults.py``, in the layout of KITTI odometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from ground_truth_drives import EXTENT_M, Leg, Spoken, Taken, Ticks, Truth

from relocbench.datasets.groundtruth.blocks.nodes import make_nodes
from relocbench.datasets.groundtruth.jobs.writing import select_images
from relocbench.datasets.groundtruth.odometry.deferred import kept_in
from relocbench.datasets.importers.kitti.recording import read_kitti
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.drives.routes import route
from relocbench.datasets.synthetic.jobs.recording import DriveOptions, prepare
from relocbench.datasets.synthetic.jobs.recording_jobs import carry_out
from relocbench.datasets.synthetic.town.town import make_district
from relocbench.execution import Run
from relocbench.geometry import transform_from_tq

_LEGS = (Leg(0, "Sunny", "common"), Leg(1, "Overcast", "common"))
_RATE = 10 / 16
"""KITTI's frames per image of RobotCar"""


def record_spinning(
    out: Path, split: str, seed: int, frames: int, rings: int, distorted: bool, spoken: Spoken, workers: int
) -> tuple[Taken, Taken]:
    """Two drives of the same route; existing recordings are kept."""
    count = round(frames * _RATE)
    town, jobs = make_district(seed, split, EXTENT_M), []
    for leg in _LEGS:
        options = DriveOptions(
            "kitti", seed=seed, number=leg.number, frames=count, cameras=(), rings=rings, azimuths=1000,
            motion_distorted=distorted,
        )  # fmt: skip
        path = route(town.network, town.periodic.street, leg.route, options.path_length_m, seed)
        jobs.append(prepare(town, path, condition_named(leg.condition).factors, out, options)[1])
    carry_out(jobs, spoken, Run(workers))
    taken = [_taken(out, leg, distorted, spoken) for leg in _LEGS]
    return taken[0], taken[1]


def _taken(out: Path, leg: Leg, distorted: bool, spoken: Spoken) -> Taken:
    name = f"{leg.number:02d}"
    motion = "distorted" if distorted else "compensated"
    odometry = kept_in(out / "odometry" / f"{name}.csv")
    recording = read_kitti(out, name, motion=motion, from_lidar=odometry, reporter=spoken)
    folder = out / "truth" / name
    times = np.loadtxt(folder / "poses.csv", delimiter=",", skiprows=1, usecols=0, dtype=np.int64)
    values = np.loadtxt(folder / "poses.csv", delimiter=",", skiprows=1, usecols=range(1, 8))
    settings = yaml.safe_load((folder / "settings.yaml").read_text(encoding="utf-8"))
    mounted = settings["sensors"]["T_rig_sensor"]["velodyne"]
    T_car_lidar = transform_from_tq(np.array(mounted["translation_m"]), np.array(mounted["quaternion_xyzw"]))
    truth = Truth(times, transform_from_tq(values[:, :3], values[:, 3:]) @ T_car_lidar)
    stream = Ticks(recording.odometry.times_ns)
    chosen = select_images(recording, stream, make_nodes(recording), 1.0)
    return Taken(leg, recording, truth, tuple(int(stream.times_ns[i]) for i in chosen))
