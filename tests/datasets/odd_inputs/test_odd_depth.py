"""Depth whose unit contradicts the poses, at every door that takes depth images."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from odd_inputs import odd_input
from refusals import Notes, noted
from small_dataset import make_small_dataset, render, small_camera, small_pose

from relocbench.arrays import Array, Floats, Image
from relocbench.datasets.checks.validation import validate_dataset
from relocbench.datasets.core import images
from relocbench.datasets.core.pairfile import pose_fields
from relocbench.datasets.importers.colmap import dataset as colmap
from relocbench.datasets.importers.generic import dataset as generic
from relocbench.datasets.importers.kapture import dataset as kapture
from relocbench.datasets.importers.tum_rgbd import dataset as tum_rgbd
from relocbench.datasets.pairs.depth_scale import DepthFrame, depth_scale
from relocbench.execution import Run
from relocbench.geometry import invert, transform_to_tq
from relocbench.progress import Silent

FRAMES, SPACING_M = 5, 0.25
CAMERA = small_camera()
MM = 1000.0


def views() -> list[tuple[Array, Image, Floats]]:
    """Pose (4, 4), image and depth in metres of frames along a street."""
    poses = [small_pose(k, spacing_m=SPACING_M, lateral_m=0.1 * k) for k in range(FRAMES)]
    return [(pose, *render(CAMERA, pose)) for pose in poses]


def camera_words(separator: str = " ") -> str:
    fx, fy, cx, cy = CAMERA.fx, CAMERA.fy, CAMERA.cx + 0.5, CAMERA.cy + 0.5
    return separator.join(map(str, ("PINHOLE", CAMERA.width, CAMERA.height, fx, fy, cx, cy)))


def world_to_camera(pose: Array) -> tuple[float, ...]:
    """qw, qx, qy, qz, tx, ty, tz"""
    t, q = transform_to_tq(invert(pose))
    return (float(q[3]), *map(float, q[:3]), *map(float, t))


def written(path: Path, image: NDArray[Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image)


def as_generic(root: Path, units: float) -> tuple[Any, Any]:
    lines = []
    for k, (pose, image, depth) in enumerate(views(), start=1):
        written(root / f"images/{k}000000000.png", image)
        written(root / f"depth/{k}000000000.png", np.rint(depth * units).astype(np.uint16))
        lines.append(f"{k}.0 {' '.join(pose_fields(pose))}\n")
    (root / "poses.txt").write_text("".join(lines))
    values = "".join(f"{key}: {list(v) if isinstance(v, tuple) else v}\n" for key, v in CAMERA.to_dict().items())
    (root / "camera.yaml").write_text(values + "depth_scale: 0.001\n")
    return generic, {}


def as_tum(root: Path, units: float) -> tuple[Any, Any]:
    folder = root
    lines = []
    for k, (pose, _, depth) in enumerate(views(), start=1):
        large = cv2.resize(depth, (640, 480), interpolation=cv2.INTER_NEAREST)
        written(folder / f"rgb/{k}.0.png", np.full((480, 640), 90, np.uint8))
        written(folder / f"depth/{k}.0.png", np.rint(large * 5 * units).astype(np.uint16))
        lines.append(f"{k}.0 {' '.join(pose_fields(pose))}\n")
    (folder / "groundtruth.txt").write_text("".join(lines))
    for kind in ("rgb", "depth"):
        (folder / f"{kind}.txt").write_text("".join(f"{k}.0 {kind}/{k}.0.png\n" for k in range(1, FRAMES + 1)))
    return tum_rgbd, {"intrinsics": ("ros-default",)}


def as_kapture(root: Path, units: float) -> tuple[Any, Any]:
    trajectories, images_, depths = [], [], []
    for k, (pose, image, depth) in enumerate(views(), start=1):
        written(root / f"sensors/records_data/{k}.png", image)
        (root / f"sensors/records_data/{k}.depth").write_bytes((depth * units / MM).astype("<f4").tobytes())
        trajectories.append(f"{k}, cam, {', '.join(map(str, world_to_camera(pose)))}")
        images_.append(f"{k}, cam, {k}.png")
        depths.append(f"{k}, depth, {k}.depth")
    sensors = [f"cam, cam, camera, {camera_words(', ')}", f"depth, depth, depth, {camera_words(', ')}"]
    for name, lines in (
        ("sensors", sensors),
        ("trajectories", trajectories),
        ("records_camera", images_),
        ("records_depth", depths),
        ("rigs", ["rig, cam, 1, 0, 0, 0, 0, 0, 0", "rig, depth, 1, 0, 0, 0, 0, 0, 0"]),
    ):
        (root / f"sensors/{name}.txt").write_text("# kapture format: 1.1\n" + "\n".join(lines) + "\n")
    text = (root / "sensors/trajectories.txt").read_text()
    (root / "sensors/trajectories.txt").write_text(text.replace(", cam, ", ", rig, "))
    return kapture, {}


def as_colmap(root: Path, units: float) -> tuple[Any, Any]:
    lines = []
    for k, (pose, image, depth) in enumerate(views(), start=1):
        written(root / f"images/{k}.png", image)
        written(root / f"depth/{k}.png", np.rint(depth * units).astype(np.uint16))
        lines.append(f"{k} {' '.join(map(str, world_to_camera(pose)))} 1 {k}.png\n\n")
    for name, text in (("cameras", f"1 {camera_words()}\n"), ("images", "".join(lines)), ("points3D", "")):
        (root / f"{name}.txt").write_text(text)
    return colmap, {"depth": root / "depth", "depth_scale": 1000.0}


DOORS = {"generic": as_generic, "tum-rgbd": as_tum, "kapture": as_kapture, "colmap": as_colmap}


def notes_of(made: Callable[[Path, float], tuple[Any, Any]], folder: Path, units: float) -> list[str]:
    folder.mkdir()
    importer, options = made(folder, units)
    notes = Notes()
    settings = importer.Options.model_validate({"correspondences": 0, **options})
    importer.build([folder], settings, folder.parent / f"{folder.name}_out", notes, Run(1))
    return [note for note in notes.notes if "times too" in note]


@pytest.mark.thorough
@pytest.mark.parametrize("door", DOORS)
def test_depth_that_contradicts_the_poses_is_told_at_every_door(door: str, tmp_path: Path) -> None:
    assert notes_of(DOORS[door], tmp_path / "right", MM) == []
    (note,) = notes_of(DOORS[door], tmp_path / "wrong", 256.0)
    told = float(re.search(r"([\d.]+) times too small", note)[1])  # type: ignore[index]
    assert told == pytest.approx(MM / 256.0, rel=0.03)


def test_the_recorded_depth_in_256ths_is_told_with_its_unit(tmp_path: Path) -> None:
    source = odd_input("33_depth_scale")
    for name, told in (("in_256ths", 1), ("in_mm", 0)):
        notes = Notes()
        settings = generic.Options.model_validate({"correspondences": 0})
        generic.build([source / name], settings, tmp_path / name, notes, Run(1))
        found = [note for note in notes.notes if "times too small" in note]
        assert len(found) == told
        assert all(noted([note], "camera.yaml", "1/256 m") for note in found)


@pytest.mark.parametrize("factor", [1e-3, 0.3, 1.0, 1e3])
def test_the_factor_is_found_over_all_units_and_not_where_it_cannot_be_told(factor: float) -> None:
    depths = [depth * np.float32(factor) for _, _, depth in views()]
    frames = [DepthFrame(CAMERA, view[0], partial(np.copy, depth)) for view, depth in zip(views(), depths, strict=True)]
    found = depth_scale(frames)
    assert found is not None
    assert found.factor == pytest.approx(1 / factor, rel=0.03)
    assert found.contradicts == (factor != 1.0)
    assert depth_scale([DepthFrame(CAMERA, np.eye(4), frame.read) for frame in frames]) is None
    wall = np.full((CAMERA.height, CAMERA.width), 3.0, dtype=np.float32)  # as far from everywhere: any scale fits
    beside = [small_pose(0, lateral_m=0.1 * k) for k in range(FRAMES)]
    assert depth_scale([DepthFrame(CAMERA, pose, lambda: wall) for pose in beside]) is None


@pytest.mark.thorough
def test_validate_names_the_depth_that_contradicts_the_poses(tmp_path: Path) -> None:
    dataset = make_small_dataset(tmp_path / "D", correspondences=0)
    findings = validate_dataset(dataset.layout.root, Silent())
    assert findings.faults == []
    traversal = dataset.traversal("summer")
    for time in traversal.timestamps("cam0"):
        path = traversal.layout.depth("cam0", time)
        if path.exists():
            images.write_depth(path, images.read_depth(path) * 0.3)
    faults = [f for f in validate_dataset(dataset.layout.root, Silent()).faults if "times too" in f.message]
    assert [fault.path for fault in faults] == [traversal.layout.root / "depth" / "cam0"]
