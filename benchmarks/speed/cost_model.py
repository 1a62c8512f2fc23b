"""What ground truth and rendering cost: CPU seconds, memory and disk of each unit of work, and of two whole projects.

Two lidar drives of the test district are recorded without cameras, and their ground truth is built stage by stage in
this process: blocks, registration, calibration, and pose graph with local edges and outcomes. Depth is drawn from their
submaps for a camera of 1280 x 960 pixels, as RobotCar's, and images with depth are rendered in three sizes. All stages
run once on short drives before, so that compiled code is loaded. Seconds are of the processor, which other programs
affect less than the clock; memory is the peak of the process within the stage.

From these units follow the costs of

- 100 RobotCar traversals of 10 km: one reference and 99 queries, two lidars of 50 scans a second, an image with depth
  each metre of road. Images are links to the recording.
- a rendered set as large as the CARLA half of the GN-Net benchmark: 27 traversals of 500 steps with 6 cameras of
  512 x 512 pixels, each with depth.

The calibration of two drives is estimated at no more than 150 nodes, so that long drives cost no more for it than
drives of 300 m. Queries are registered one process a drive; everything else is divided evenly among workers.

    python benchmarks/speed/cost_model.py [--steps N] [--workers N,N,...]

It prints tables; the last line is JSON.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from relocbench.datasets.core.images import write_depth
from relocbench.datasets.groundtruth.alignment.two_drives import RegistrationUnit, register_query
from relocbench.datasets.groundtruth.calibration.estimation import calibration_evidence
from relocbench.datasets.groundtruth.calibration.unknowns import DriveLidars, Sensors
from relocbench.datasets.groundtruth.depth.depth import make_scene, scene_depth
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.groundtruth.pairs.pairing import CameraFrames, PairingUnit, pair_up
from relocbench.datasets.groundtruth.pose_graph.graph import optimise
from relocbench.datasets.groundtruth.submaps.drive import make_drive
from relocbench.datasets.importers.robotcar.recording import read_robotcar_drives
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.drives.rig import rig_named
from relocbench.datasets.synthetic.drives.routes import route
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.recording import DriveOptions, prepare
from relocbench.datasets.synthetic.jobs.recording_jobs import carry_out
from relocbench.datasets.synthetic.jobs.rendering import FrameWork, RenderUnit, StepWork, render_unit
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.datasets.synthetic.town.town import make_district
from relocbench.execution import Run
from relocbench.geometry import Camera, invert, make_transform
from relocbench.progress import Silent

Result = TypeVar("Result")
GIB = 2**30
PLACE = DistrictSpec(0, "test", 400.0)
ROBOTCAR = Camera("pinhole", 1280, 960, 983.0, 983.0, 643.0, 493.0)
T_RIG_CAM = make_transform(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), [0, 0, 0])
SIZES = ((256, 192), (512, 512), (1280, 960))
CALIBRATED_NODES = 150
TRAVERSALS, LENGTH_M, IMAGES_A_M = 100, 10_000.0, 1.0
CARLA_IMAGES, CARLA_SIZE = 27 * 500 * 6, (512, 512)
_WARM_STEPS = 100
_DEPTHS, _IMAGES = 6, 6


@dataclass(frozen=True)
class Cost:
    """What a unit of work costs."""

    cpu_s: float
    peak_gib: float = 0.0
    """peak memory of the process"""
    disk_bytes: float = 0.0

    def each(self, count: float) -> Cost:
        """The cost of one of so many units."""
        return Cost(self.cpu_s / count, self.peak_gib, self.disk_bytes / count)


def measured(work: Callable[[], Result]) -> tuple[Result, Cost]:
    """A result with its processor time and peak memory."""
    with suppress(OSError):  # the peak starts anew where the system allows it
        Path("/proc/self/clear_refs").write_text("5")
    start = time.process_time()
    result = work()
    spent = time.process_time() - start
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    peak = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    return result, Cost(spent, peak * 1024 / GIB)


def size_of(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def recorded(folder: Path, steps: int) -> list[Path]:
    """Two drives through the test district, without cameras."""
    town = make_district(PLACE.seed, PLACE.split, PLACE.extent_m)
    length = DriveOptions(frames=steps).path_length_m
    folders, jobs = [], []
    for number, condition in enumerate(("Sunny", "Overcast")):
        options = DriveOptions(seed=PLACE.seed, number=number, frames=steps, cameras=())
        path = route(town.network, town.periodic.street, "common", length, PLACE.seed)
        found, job = prepare(town, path, condition_named(condition).factors, folder, options)
        folders.append(found.folder)
        jobs.append(job)
    carry_out(jobs, Silent(), Run())
    return folders


def ground_truth(folder: Path, steps: int) -> tuple[dict[str, Cost], dict[str, float]]:
    """The costs of each stage in its unit, and what there was."""
    options, alignment = FieldOptions(), FieldOptions().alignment
    recordings = read_robotcar_drives(recorded(folder / "recording", steps))
    blocks = folder / "blocks"
    drives, of_blocks = measured(
        lambda: [make_drive(r, blocks / r.name, alignment.block_m, Silent(), Run()) for r in recordings]
    )
    reference, query = drives
    driven = [float(drive.nodes.travelled_m[-1]) for drive in drives]
    of_blocks = Cost(of_blocks.cpu_s, of_blocks.peak_gib, size_of(blocks))
    registrations, of_registration = measured(lambda: register_query(RegistrationUnit(reference, query, alignment)))
    sensors = Sensors((DriveLidars.of(reference.recording), DriveLidars.of(query.recording)))
    solution = optimise(reference.nodes, query.nodes, registrations)
    _, of_calibration = measured(lambda: calibration_evidence(solution, (reference, query), sensors))
    chosen = tuple(
        tuple(int(t) for t in _times(drive.nodes.times_ns, metres))
        for drive, metres in zip(drives, driven, strict=True)
    )
    frames = CameraFrames("front", T_RIG_CAM, T_RIG_CAM, *chosen)
    unit = PairingUnit(reference, query, tuple(registrations), (frames,), options.limits_at(1.0), options.max_angle)
    paired, of_graph = measured(lambda: pair_up(unit))
    outcomes = paired.outcomes["front"]
    window = query.window(options.depth_submap)
    nodes = np.linspace(5, len(query.nodes) - 6, _DEPTHS).astype(int).tolist()

    def draw() -> None:
        for node in nodes:
            scene = make_scene(window.at(node))
            # Two images a block, one a metre, are drawn from the same submap.
            for k in range(2):
                write_depth(folder / "depth" / f"{node}-{k}.png", scene_depth(scene, ROBOTCAR, invert(T_RIG_CAM)).depth)

    _, of_depth = measured(draw)
    of_depth = Cost(of_depth.cpu_s, of_depth.peak_gib, size_of(folder / "depth")).each(2 * _DEPTHS)
    calibrated = min(len(query.nodes), CALIBRATED_NODES)
    costs = {
        "a metre driven: blocks": of_blocks.each(sum(driven)),
        "a metre registered": of_registration.each(driven[1]),
        "a node of the query, up to 150: calibration": of_calibration.each(calibrated),
        "a metre of the query: graph, local edges, outcomes": of_graph.each(driven[1]),
        "an image's depth by lidar, 1280 x 960": of_depth,
    }
    told = {
        "metres": driven[1],
        "nodes": len(query.nodes),
        "pairs": len(outcomes),
        "accepted": sum(o.accepted for o in outcomes),
        "cpu_s_a_metre": sum(c.cpu_s for c in (of_blocks, of_registration, of_calibration, of_graph)) / driven[1],
        "cpu_s_a_pair": sum(c.cpu_s for c in (of_blocks, of_registration, of_calibration, of_graph)) / len(outcomes),
    }
    return costs, told


def _times(times_ns: np.ndarray, metres: float) -> np.ndarray:
    return np.linspace(times_ns[0], times_ns[-1], max(int(metres * IMAGES_A_M), 2)).astype(np.int64)


def rendering(folder: Path) -> dict[str, Cost]:
    """The cost of an image with depth by its size."""
    costs = {}
    for width, height in SIZES:
        camera = Camera("pinhole", width, height, 0.6 * width, 0.6 * width, (width - 1) / 2, (height - 1) / 2)
        factors = condition_named("Sunny").factors
        target = folder / f"{width}x{height}"
        target.mkdir(parents=True)

        def unit(
            shown: list[Any], camera: Camera = camera, target: Path = target, factors: Any = factors
        ) -> RenderUnit:
            steps = [
                StepWork(
                    (),
                    (FrameWork(camera, T, scenes.frame_seed(0, 0, i, 0),
                               {"image": target / f"image-{i}.png", "depth": target / f"depth-{i}.png"}),),
                )
                for i, T in enumerate(shown)
            ]  # fmt: skip
            return RenderUnit(PLACE, factors, factors, tuple(steps))

        path = scenes.district(PLACE).network.drive(100.0, PLACE.seed)
        _, T_rig_cam = rig_named("front").cameras(width, height)["front"]
        shown = [path.pose(at) @ T_rig_cam for at in np.linspace(5, 95, _IMAGES + 1)]
        render_unit(unit(shown[:1]))
        _, cost = measured(lambda unit=unit, shown=shown: render_unit(unit(shown[1:])))  # type: ignore[misc]
        costs[f"an image rendered with depth, {width} x {height}"] = Cost(
            cost.cpu_s, cost.peak_gib, size_of(target)
        ).each(_IMAGES)
    return costs


def projects(costs: dict[str, Cost], told: dict[str, float]) -> dict[str, tuple[float, float, float]]:
    """CPU hours, disk in GiB, and CPU hours of the longest unit, by project."""
    blocks, metre, calibration, graph, depth = list(costs.values())[:5]
    queries = TRAVERSALS - 1
    of_query = LENGTH_M * (metre.cpu_s + graph.cpu_s) + CALIBRATED_NODES * calibration.cpu_s
    images = TRAVERSALS * LENGTH_M * IMAGES_A_M
    seconds = TRAVERSALS * LENGTH_M * blocks.cpu_s + queries * of_query
    disk = TRAVERSALS * LENGTH_M * blocks.disk_bytes
    carla = costs[f"an image rendered with depth, {CARLA_SIZE[0]} x {CARLA_SIZE[1]}"]
    longest = LENGTH_M * metre.cpu_s / 3600
    return {
        "100 RobotCar traversals of 10 km, poses": (seconds / 3600, disk / GIB, longest),
        "the same, with depth of 1,000,000 images": (
            (seconds + images * depth.cpu_s) / 3600,
            (disk + images * depth.disk_bytes) / GIB,
            longest,
        ),
        "81,000 images of 512 x 512 with depth": (
            CARLA_IMAGES * carla.cpu_s / 3600, CARLA_IMAGES * carla.disk_bytes / GIB, 0.0
        ),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=320, help="frames of the recorded drives, half a metre apart")
    parser.add_argument("--workers", default="1,8,64", help="numbers of workers in the second table")
    chosen = parser.parse_args()
    workers = [int(word) for word in chosen.workers.split(",")]
    with tempfile.TemporaryDirectory(prefix="relocbench-bench-") as scratch:
        ground_truth(Path(scratch) / "warm", _WARM_STEPS)
        costs, told = ground_truth(Path(scratch) / "measured", chosen.steps)
        costs |= rendering(Path(scratch) / "images")
    print("| unit | CPU seconds | peak memory, GiB | disk, KiB |\n|---|---|---|---|")
    for name, cost in costs.items():
        print(f"| {name} | {cost.cpu_s:.3f} | {cost.peak_gib:.2f} | {cost.disk_bytes / 1024:.0f} |")
    print(
        f"\nGround truth of both drives: {told['cpu_s_a_metre']:.2f} s a metre of the query, "
        f"{told['cpu_s_a_pair']:.2f} s a pair "
        f"({told['metres']:.0f} m, {told['accepted']:.0f} of {told['pairs']:.0f} pairs accepted)\n"
    )
    made = projects(costs, told)
    print("| project | CPU hours | disk, GiB | " + " | ".join(f"hours on {n}" for n in workers) + " |")
    print("|---" * (3 + len(workers)) + "|")
    for name, (hours, disk, longest) in made.items():
        cells = " | ".join(f"{max(hours / n, longest):.1f}" for n in workers)
        print(f"| {name} | {hours:.0f} | {disk:.0f} | {cells} |")
    record = {
        "benchmark": "cost_model",
        "units": {name: round(cost.cpu_s, 4) for name, cost in costs.items()},
        "cpu_s_a_metre": round(told["cpu_s_a_metre"], 3),
        "cpu_s_a_pair": round(told["cpu_s_a_pair"], 3),
        "cpu_hours": {name: round(hours, 1) for name, (hours, _, _) in made.items()},
        "disk_gib": {name: round(disk, 1) for name, (_, disk, _) in made.items()},
        "load_average": [round(x, 1) for x in os.getloadavg()],
    }
    print(json.dumps(record))


if __name__ == "__main__":
    main()
