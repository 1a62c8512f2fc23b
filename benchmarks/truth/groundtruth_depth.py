"""Errors of depth from lidar submaps, measured against the exact depth of simulated drives.

Lidar drives in the layout of the RobotCar dataset are recorded through one district in several conditions. Their
submaps are made as for any recording, and the depth of keyframes is computed from them; the true depth is that of the
renderer. A pixel is wrong if its error exceeds both 10 cm and 3 % of its depth, and ``at edge`` if the true depth jumps
within two pixels. ``nes`` is the mean of (error / sigma)^2 over pixels with less than 5 sigma, and ``model`` the same
with the sigma from ``a + b z + c z^2``.

    python benchmarks/truth/groundtruth_depth.py [--work DIR] [--conditions Sunny,Rain,Snow] [--pictures DIR]
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from relocbench.arrays import Floats, Image, Mask
from relocbench.datasets.groundtruth.blocks.nodes import make_nodes
from relocbench.datasets.groundtruth.blocks.store import build_blocks
from relocbench.datasets.groundtruth.depth.depth import DepthImage, DepthOptions, fit_sigma, make_scene, scene_depth
from relocbench.datasets.groundtruth.submaps.submaps import SubmapWindow
from relocbench.datasets.importers.robotcar.recording import read_robotcar
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.drives.drive import DriveStyle
from relocbench.datasets.synthetic.jobs.recording import path_length, record
from relocbench.datasets.synthetic.layouts.robotcar import T_RIG_VEHICLE
from relocbench.datasets.synthetic.renderer.render import Frame, Renderer
from relocbench.datasets.synthetic.town.mesh import Semantic
from relocbench.datasets.synthetic.town.town import District, compose, make_district
from relocbench.execution import Run
from relocbench.geometry import Camera, interpolate_trajectory, invert, make_transform, transform_from_tq

CAMERA = Camera("pinhole", 640, 480, 491.5, 491.5, 319.5, 239.5)
T_RIG_CAM = make_transform(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), [0, 0, 0])
T_VEHICLE_RIG = make_transform(np.diag([1.0, -1.0, -1.0]), [0, 0, 0])
CLASSES: dict[str, tuple[Semantic, ...]] = {
    "buildings": (Semantic.BUILDING,),
    "road": (Semantic.ROAD, Semantic.MARKING, Semantic.PAVEMENT),
    "cars": (Semantic.PARKED_CAR,),
    "trees": (Semantic.TREE, Semantic.HEDGE),
    "everything": tuple(s for s in Semantic if s != Semantic.SKY),
}
"""by name: what is seen"""


@dataclass(frozen=True, eq=False)
class Shot:
    """One keyframe."""

    frame: Frame
    found: DepthImage
    seconds: float


def drives(town: District, conditions: list[str], work: Path, frames: int) -> list[Path]:
    """Lidar drives along one route."""
    path = town.network.drive(path_length(frames, "robotcar", DriveStyle()) + 1, 0)
    folders = []
    for number, name in enumerate(conditions):
        factors = condition_named(name).factors
        recorded = record(
            town, path, factors, work / "recording", "robotcar", number=number, frames=frames, cameras=(), run=Run(1)
        )
        folders.append(recorded.folder)
    return folders


def shoot(town: District, condition: str, folder: Path, blocks: Path, count: int, options: DepthOptions) -> list[Shot]:
    """Keyframes distributed over a drive, except its ends."""
    recording = read_robotcar(folder)
    nodes = make_nodes(recording)
    window = SubmapWindow(nodes, build_blocks(recording, nodes, blocks, Run(1)))
    truth = np.loadtxt(folder.parent / "truth" / folder.name / "poses.csv", delimiter=",", skiprows=1, dtype=object)
    times = np.array([int(t) for t in truth[:, 0]])
    values = truth[:, 1:].astype(np.float64)
    T_world_car = transform_from_tq(values[:, :3], values[:, 3:])
    factors = condition_named(condition).factors
    renderer = Renderer(compose(town, factors), factors, town.lamps, town.seed)
    inside = np.flatnonzero((nodes.travelled_m > 30) & (nodes.travelled_m < nodes.travelled_m[-1] - 30))
    shots = []
    for node in inside[np.linspace(0, len(inside) - 1, count).astype(int)]:
        submap = window.at(int(node))
        begin = time.process_time()
        found = scene_depth(make_scene(submap, options), CAMERA, invert(T_RIG_CAM), options)
        seconds = time.process_time() - begin
        T_world_cam = (
            interpolate_trajectory(times, T_world_car, nodes.times_ns[node : node + 1])[0]
            @ T_RIG_VEHICLE @ T_VEHICLE_RIG @ T_RIG_CAM
        )  # fmt: skip
        shots.append(Shot(renderer.render(CAMERA, T_world_cam, int(node)), found, seconds))
    return shots


def at_jump(depth: Floats) -> Mask:
    """The pixels within two pixels of a jump of the true depth by more than a tenth."""
    filled = np.where(depth > 0, depth, np.float32(1e3))
    kernel = np.ones((5, 5), np.uint8)
    return np.asarray(cv2.dilate(filled, kernel) > 1.1 * cv2.erode(filled, kernel))


def row(name: str, shots: list[Shot], model: tuple[float, float, float]) -> str:
    """A row of the table."""
    errors, scaled, modelled, jumps, chosen, sky = [], [], [], [], 0, 0
    for shot in shots:
        depth, truth = shot.found.depth, shot.frame.depth
        of = np.isin(shot.frame.semantic, CLASSES[name]) & (truth > 0) & (truth < 80)
        known = of & (depth > 0)
        error = depth[known] - truth[known]
        errors.append(error)
        scaled.append(error / shot.found.sigma[known])
        z = depth[known].astype(np.float64)
        modelled.append(error / (model[0] + model[1] * z + model[2] * z * z))
        jumps.append(np.stack([at_jump(truth)[known], np.abs(error) > 0.1 + 0.03 * truth[known]]))
        chosen += int(of.sum())
        sky += int(((truth <= 0) & (depth > 0)).sum())
    error, e, m = np.concatenate(errors), np.concatenate(scaled), np.concatenate(modelled)
    jump, wrong = np.concatenate(jumps, axis=1)
    size = np.abs(error)
    near, fit = np.abs(e) < 5, np.abs(m) < 5
    return (
        f"{name:11s} {len(error) / max(chosen, 1):7.1%} {np.median(size):8.3f} {np.percentile(size, 95):8.3f} "
        f"{np.median(error):+8.3f} {np.mean(size > 0.1):7.1%} {np.mean(wrong):7.2%} {np.mean(wrong & jump):7.2%} "
        f"{np.mean(wrong & ~jump):7.2%} {np.mean(e[near] ** 2):6.2f} {np.mean(m[fit] ** 2):6.2f} "
        f"{np.mean(np.abs(e) > 3):6.2%} {sky if name == 'everything' else 0:6d}"
    )


HEAD = (
    f"{'':11s} {'covered':>7s} {'median m':>8s} {'95 % m':>8s} {'bias m':>8s} {'>10 cm':>7s} {'wrong':>7s} "
    f"{'at edge':>7s} {'inside':>7s} {'nes':>6s} {'model':>6s} {'>3 sg':>6s} {'sky px':>6s}"
)


def picture(shot: Shot) -> Image:
    """A picture of the image with the edges of the depth, the depth, the true depth and the error (red: too near)."""
    depth, truth = shot.found.depth, shot.frame.depth

    def coloured(values: Floats) -> Image:
        shade = np.clip(np.log(np.maximum(values, 1) / 2) / np.log(40), 0, 1)
        image = cv2.applyColorMap((255 - 255 * shade).astype(np.uint8), cv2.COLORMAP_TURBO)
        image[values <= 0] = 0
        return np.asarray(image)

    rgb = cv2.cvtColor(shot.frame.rgb, cv2.COLOR_RGB2BGR)
    filled = np.where(depth > 0, depth, np.float32(0))
    kernel = np.ones((3, 3), np.uint8)
    edges = (cv2.dilate(filled, kernel) > 1.1 * cv2.erode(filled, kernel)) & (depth > 0)
    rgb[edges] = (0, 0, 255)
    known = (depth > 0) & (truth > 0)
    error = np.where(known, depth - truth, 0) / np.maximum(0.1 + 0.03 * truth, 0.1)
    shown = np.full((*depth.shape, 3), 255, np.uint8)
    shown[known] = np.clip(255 - 255 * np.abs(error[known, None]) * np.array([1, 1, 1]), 0, 255)
    shown[known & (error > 0), 0] = 255
    shown[known & (error < 0), 2] = 255
    shown[depth <= 0] = 90
    shown[(depth > 0) & (truth <= 0)] = (0, 255, 255)
    return np.vstack([np.hstack([rgb, coloured(depth)]), np.hstack([shown, coloured(truth)])])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--work", type=Path, default=Path("depth-benchmark"), help="folder that keeps drives and blocks"
    )
    parser.add_argument("--conditions", default="Sunny,Rain,Snow")
    parser.add_argument("--frames", type=int, default=640, help="frames of each drive, at 16 per second")
    parser.add_argument("--keyframes", type=int, default=12, help="keyframes of each drive")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of keyframes")
    arguments = parser.parse_args()
    town = make_district(0, "train", 400.0)
    conditions = arguments.conditions.split(",")
    options = DepthOptions()
    for name, folder in zip(conditions, drives(town, conditions, arguments.work, arguments.frames), strict=True):
        blocks = arguments.work / "blocks" / folder.name
        shots = shoot(town, name, folder, blocks, arguments.keyframes, options)
        model = fit_sigma(shot.found for shot in shots)
        print(f"\n{name}: sigma = {model[0]:.4f} + {model[1]:.5f} z + {model[2]:.6f} z^2 m; "
              f"{np.median([s.seconds for s in shots]):.2f} s a keyframe (one core, CPU time)")  # fmt: skip
        print(HEAD)
        for kind in CLASSES:
            print(row(kind, shots, model))
        if arguments.pictures:
            arguments.pictures.mkdir(parents=True, exist_ok=True)
            for k, shot in enumerate(shots):
                cv2.imwrite(str(arguments.pictures / f"{name}_{k:02d}.png"), picture(shot))


if __name__ == "__main__":
    main()
