"""Real clouds with known poses for ``register_clouds.py``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from register_scenes import Pair

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.clouds.cloud import Cloud, cloud_of_file
from relocbench.datasets.sensors.cloud_files import read_cloud
from relocbench.datasets.sensors.cloud_poses import read_cloud_poses
from relocbench.geometry import interpolate_trajectory, invert, transform_from_tq

_CAMERA = (517.3, 516.5, 318.6, 255.3)
"""fx fy cx cy of freiburg1; its distortion is not removed, which moves points near the border by a few pixels"""
_DEPTH_UNIT = 1 / 5000
_CLOCK_S = -0.034
"""offset of the motion capture's clock: 0.02 s by the colour images, which are stamped 0.014 s before the depth images
of the same number"""
_NOWHERE = np.full((4, 4), np.nan)


def real_pairs(part: str, data: Path) -> Iterator[tuple[str, Pair]] | None:
    """The pairs of a part by name; None if its recording is not there."""
    graphs, kitti, tum = data / "lidar_submaps_with_graph", data / "kitti_odometry", data / "tum_rgbd"
    needed = {"kitti 07": [graphs], "newer college": [graphs], "tum rgbd": [tum],
              "other real": [graphs, kitti], "small gicp": [data / "small_gicp_demo"]}  # fmt: skip
    if not all(folder.is_dir() for folder in needed[part]):
        return None
    if part in ("kitti 07", "newer college"):
        folder = graphs / ("kitti_07_dump" if part == "kitti 07" else "newer_01")
        files = sorted(folder.glob("*/points.bin" if part == "kitti 07" else "planes_*.bin"))
        return _all_pairs(_clouds(files), read_cloud_poses(folder / "graph.txt", len(files)))
    if part == "small gicp":
        folder = needed[part][0]
        target, source = _clouds([folder / "target.ply", folder / "source.ply"])
        return iter([("demo", Pair(target, source, np.loadtxt(folder / "T_target_source.txt")))])
    scans = sorted((kitti / "sequences" / "00" / "velodyne").glob("*.bin"))
    if part == "tum rgbd":
        return _depth_pairs(tum)
    files = [graphs / "kitti_07_dump" / "000000" / "points.bin", graphs / "newer_01" / "planes_000000.bin", scans[0]]
    return _all_pairs(_clouds(files), np.array([_NOWHERE] * 3))


def _clouds(files: Sequence[Path]) -> list[Cloud]:
    return [cloud_of_file(read_cloud(file)) for file in files]


def _all_pairs(clouds: Sequence[Cloud], T: Array) -> Iterator[tuple[str, Pair]]:
    for i, j in combinations(range(len(clouds)), 2):
        known = np.isfinite(T[i]).all() and np.isfinite(T[j]).all()
        yield f"{i}-{j}", Pair(clouds[i], clouds[j], np.asarray(invert(T[i]) @ T[j]) if known else _NOWHERE)


def _depth_pairs(tum: Path) -> Iterator[tuple[str, Pair]]:
    """Views of one sequence, and of the two sequences, which show the same desk from 55 to 65 degrees apart."""
    views = {}
    for name, chosen in (("desk", (0, 4, 8)), ("xyz", (0, 9))):
        folder = tum / f"rgbd_dataset_freiburg1_{name}"
        files = sorted((folder / "depth").glob("*.png"))
        rows = np.loadtxt(folder / "groundtruth.txt")
        times = np.round(rows[:, 0] * 1e9).astype(np.int64)
        poses = transform_from_tq(rows[:, 1:4], rows[:, 4:] / np.linalg.norm(rows[:, 4:], axis=1, keepdims=True))
        for k in chosen:
            at = np.array([round((float(files[k].stem) + _CLOCK_S) * 1e9)])
            views[f"{name}{k}"] = (_depth_cloud(files[k]), interpolate_trajectory(times, poses, at)[0])
    for one, other in (("desk0", "desk4"), ("desk4", "desk8"), ("desk0", "desk8"), ("xyz0", "xyz9"), ("xyz0", "desk0")):
        (a, T_a), (b, T_b) = views[one], views[other]
        yield f"{one}-{other}", Pair(a, b, np.asarray(invert(T_a) @ T_b))


def _depth_cloud(file: Path) -> Cloud:
    depth = np.asarray(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), dtype=np.float64) * _DEPTH_UNIT
    v, u = np.nonzero((depth > 0) & (depth < 3.5))
    z, (fx, fy, cx, cy) = depth[v, u], _CAMERA
    points = np.column_stack([(u - cx) / fx * z, (v - cy) / fy * z, z])
    return Cloud(file.stem, points, np.zeros_like(points), supposed=True)
