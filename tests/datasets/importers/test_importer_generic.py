"""The generic folder, made up from a rendered street corner with known depth and poses."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from refusals import ErrorData, refused
from repository import DOCS
from small_dataset import render, small_camera, small_pose

from relocbench.arrays import Array, Image
from relocbench.datasets.checks.validation import validate_dataset
from relocbench.datasets.core import images
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import pose_fields
from relocbench.datasets.core.schema import TraversalFile
from relocbench.datasets.importers.generic import dataset as importer
from relocbench.datasets.importers.generic.scans import read_lidar_file
from relocbench.datasets.sensors.pose_tables import read_trajectory
from relocbench.datasets.sensors.trajectories import timed_files, traversal_names
from relocbench.errors import DatasetError
from relocbench.execution import Run
from relocbench.files import load_yaml
from relocbench.geometry import Camera, interpolate, invert, make_transform, so3_exp
from relocbench.progress import Silent
from relocbench.tracking import KeyframePoints

START_NS = 1_600_000_000_000_000_000
STEP_NS = 100_000_000
PINHOLE = small_camera(96, 72)
FISHEYE = Camera("equidistant", 96, 72, 60.0, 60.0, 47.0, 36.0, (0.02, -0.01, 0.003, -0.001))


def frame_time(frame: float) -> int:
    return START_NS + round(frame * STEP_NS)


def pose(frame: float, lateral_m: float = 0.0) -> Array:
    """(4, 4) ``T_world_rig``: constant speed along a straight line and about one axis."""
    return make_transform(so3_exp([0.0, 0.02 * frame, 0.0]), [lateral_m, 0.0, 0.2 * frame])


def camera_yaml(camera: Camera, extra: str = "") -> str:
    values = "".join(f"{k}: {list(v) if isinstance(v, tuple) else v}\n" for k, v in camera.to_dict().items())
    return values + extra


def write_poses(
    folder: Path, frames: list[float], lateral_m: float = 0.0, seconds: bool = True, later_ns: int = 0
) -> None:
    lines = []
    for frame in frames:
        time = frame_time(frame) + later_ns
        text = f"{time // 10**9}.{time % 10**9:09d}" if seconds else str(time)
        lines.append(f"{text} {' '.join(pose_fields(pose(frame, lateral_m)))}\n")
    (folder / "poses.txt").write_text("# t tx ty tz qx qy qz qw\n" + "".join(lines))


def write_folder(
    root: Path,
    name: str = "summer",
    frames: int = 4,
    lateral_m: float = 0.0,
    extra: str = "",
    suffix: str = ".png",
    later_ns: int = 0,
) -> Path:
    """A pinhole folder with 16-bit depth in millimetres; image times as seconds when ``suffix`` is a JPEG's."""
    folder = root / name
    for frame in range(frames):
        time = frame_time(frame) + later_ns
        image, depth = render(PINHOLE, pose(frame, lateral_m))
        stem = str(time) if suffix == ".png" else f"{time // 10**9}.{time % 10**9:09d}"
        path = folder / "images" / f"{stem}{suffix}"
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), image)
        (folder / "depth").mkdir(exist_ok=True)
        cv2.imwrite(str(folder / "depth" / f"{stem}.png"), np.rint(depth * 1000).astype(np.uint16))
    (folder / "camera.yaml").write_text(camera_yaml(PINHOLE, f"depth_scale: 0.001\n{extra}"))
    write_poses(folder, [float(f) for f in range(frames)], lateral_m, later_ns=later_ns)
    return folder


def build(sources: list[Path], out: Path, **options: object) -> Dataset:
    chosen = importer.Options.model_validate({"correspondences": 20, **options})
    return importer.build(sources, chosen, out, Silent(), Run())


def test_one_folder_is_paired_with_itself_by_steps_and_keeps_the_true_poses(tmp_path: Path) -> None:
    extra = "depth_sigma: [0.01, 0, 0.002]\ncondition: {weather: rain, season: autumn}\nlocation: corner\n"
    dataset = build([write_folder(tmp_path, extra=extra)], tmp_path / "out", pair_step=(1, -2))
    (pair_set,) = dataset.pair_sets()
    assert pair_set.name == "summer__summer__cam0"
    assert sorted(p.group for p in pair_set.pairs) == ["step_-2"] * 2 + ["step_1"] * 3
    for pair in pair_set.pairs:
        r, q = ((t - START_NS) / STEP_NS for t in pair.key)
        assert pair.T_query_ref is not None
        np.testing.assert_allclose(pair.T_query_ref, invert(pose(q)) @ pose(r), atol=2e-9)
        assert pair.overlap is not None
        assert pair.overlap > 0.5
    traversal = dataset.traversal("summer")
    assert str(traversal.condition) == "rain, autumn"
    assert traversal.file.cameras["cam0"].depth_sigma == (0.01, 0.0, 0.002)


def test_two_folders_are_paired_across_by_nearness(tmp_path: Path) -> None:
    months = 10**16
    sources = [write_folder(tmp_path), write_folder(tmp_path, "winter", frames=2, lateral_m=0.1, later_ns=months)]
    (pair_set,) = build(sources, tmp_path / "out").pair_sets()
    assert pair_set.name == "summer__winter__cam0"
    assert [p.key for p in pair_set.pairs] == [(frame_time(i), frame_time(i) + months) for i in range(2)]
    for i, pair in enumerate(pair_set.pairs):
        assert pair.T_query_ref is not None
        np.testing.assert_allclose(pair.T_query_ref, invert(pose(i, 0.1)) @ pose(i), atol=2e-9)


def test_depth_units_become_metres_and_images_are_linked(tmp_path: Path) -> None:
    folder = write_folder(tmp_path)
    dataset = build([folder], tmp_path / "out")
    traversal = dataset.traversal("summer")
    image, depth = render(PINHOLE, pose(1))
    stored = traversal.depth("cam0", frame_time(1))
    assert stored is not None
    np.testing.assert_allclose(stored, depth, atol=0.5e-3 + 0.5 / 256)
    np.testing.assert_array_equal(traversal.image("cam0", frame_time(1)), image)
    assert dataset.layout.traversal("summer").image("cam0", frame_time(1)).is_symlink()


def test_images_named_in_seconds_are_the_same_nanoseconds(tmp_path: Path) -> None:
    dataset = build([write_folder(tmp_path, suffix=".jpg")], tmp_path / "out", copy_images=True)
    assert dataset.traversal("summer").timestamps("cam0") == [frame_time(i) for i in range(4)]
    assert not dataset.layout.traversal("summer").image("cam0", frame_time(0), ".jpg").is_symlink()


@pytest.mark.parametrize("seconds", [True, False])
def test_poses_are_interpolated_to_image_times_and_never_extrapolated(tmp_path: Path, seconds: bool) -> None:
    folder = write_folder(tmp_path, frames=5)
    write_poses(folder, [0.5, 1.5, 3.2], seconds=seconds)
    dataset = build([folder], tmp_path / "out")
    poses = dataset.traversal("summer").poses
    assert list(poses) == [frame_time(i) for i in (1, 2, 3)]
    for i, (before, after) in zip((1, 2, 3), ((0.5, 1.5), (1.5, 3.2), (1.5, 3.2)), strict=True):
        expected = interpolate(pose(before), pose(after), (i - before) / (after - before))
        np.testing.assert_allclose(poses[frame_time(i)], expected, atol=1e-7)
        np.testing.assert_allclose(poses[frame_time(i)], pose(i), atol=1e-7)


def test_a_gap_in_the_poses_is_not_interpolated_over(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, frames=6)
    write_poses(folder, [0.0, 1.0, 4.0, 5.0])
    dataset = build([folder], tmp_path / "out", max_pose_gap=0.25)
    assert list(dataset.traversal("summer").poses) == [frame_time(i) for i in (0, 1, 4, 5)]


def test_images_of_a_distorted_camera_are_undistorted_with_their_depth_and_points(tmp_path: Path) -> None:
    """What a fisheye saw, rendered through its own model, becomes what the pinhole camera of the same K sees."""
    folder = tmp_path / "fisheye"
    for kind in ("images", "depth", "points"):
        (folder / kind).mkdir(parents=True)
    wide = Camera("pinhole", 400, 300, 60.0, 60.0, 199.5, 149.5)
    v, u = np.mgrid[: FISHEYE.height, : FISHEYE.width].astype(np.float64)
    rays, _ = FISHEYE.unproject(np.stack([u, v], axis=-1))
    at = wide.project(rays)[0].astype(np.float32)
    for frame in range(2):
        big_image, big_depth = render(wide, pose(frame))
        image = cv2.remap(big_image, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        depth = cv2.remap(big_depth, at[..., 0], at[..., 1], cv2.INTER_NEAREST)
        time = frame_time(frame)
        cv2.imwrite(str(folder / "images" / f"{time}.png"), image)
        cv2.imwrite(str(folder / "depth" / f"{time}.png"), np.rint(depth * 1000).astype(np.uint16))
    # The lens sees the second point, in the corner of its image, and the pinhole camera does not.
    pixel = np.array([[80.0, 60.0], [0.0, 0.0]])
    points = KeyframePoints(pixel, np.array([0.25, 0.5]), np.array([0.01, 0.01]))
    images.write_points(folder / "points" / f"{frame_time(0)}.csv", points)
    (folder / "camera.yaml").write_text(camera_yaml(FISHEYE, "depth_scale: 0.001\n"))
    write_poses(folder, [0.0, 1.0])

    traversal = build([folder], tmp_path / "out").traversal("fisheye")
    camera = traversal.camera("cam0")
    assert camera == FISHEYE.pinhole()
    expected_image, expected_depth = render(camera, pose(0))
    raw = images.read_image(folder / "images" / f"{frame_time(0)}.png")
    undone = np.median(np.abs(smooth(traversal.image("cam0", frame_time(0))) - smooth(expected_image)))
    assert undone < 3
    assert undone < 0.3 * np.median(np.abs(smooth(raw) - smooth(expected_image)))
    stored = traversal.depth("cam0", frame_time(0))
    assert stored is not None
    seen = (stored > 0) & (expected_depth > 0)
    assert seen.mean() > 0.5
    nearest_pixel = np.median(np.abs(stored - expected_depth)[seen] / expected_depth[seen])
    assert nearest_pixel < 0.02
    moved = traversal.points("cam0", frame_time(0))
    assert moved is not None
    rays, _ = FISHEYE.unproject(pixel)
    expected, _ = camera.project(rays)
    assert camera.contains(expected, border=-0.5).tolist() == [True, False]
    np.testing.assert_allclose(moved.uv, expected[:1], atol=1e-9)
    np.testing.assert_array_equal(moved.inverse_depth, [0.25])
    assert not dataset_image_is_link(tmp_path / "out", "fisheye")
    assert not validate_dataset(tmp_path / "out", Silent()).faults


def smooth(image: Image) -> Array:
    """Without the fine texture that two resamplings blur; the borders left off."""
    return np.asarray(cv2.GaussianBlur(image.astype(np.float64), (0, 0), 2.0)[6:-6, 6:-6])


def dataset_image_is_link(out: Path, traversal: str) -> bool:
    return any(p.is_symlink() for p in (out / "traversals" / traversal / "images").rglob("*.png"))


def test_several_cameras_lie_in_subfolders_and_give_a_pair_set_each(tmp_path: Path) -> None:
    folder = tmp_path / "rig"
    T_rig_right = make_transform(so3_exp([0.0, 0.1, 0.0]), [0.3, 0.0, 0.0])
    cameras = {"left": np.eye(4), "right": T_rig_right}
    text = "cameras:\n"
    for name, T_rig_cam in cameras.items():
        t, q = np.split(np.array([float(f) for f in pose_fields(T_rig_cam)]), [3])
        entry = {**PINHOLE.to_dict(), "depth_scale": 0.001}
        entry["distortion"] = []
        entry["T_rig_cam"] = {"translation_m": t.tolist(), "quaternion_xyzw": q.tolist()}
        text += f"  {name}: {entry}\n"
        for frame in range(2):
            image, depth = render(PINHOLE, pose(frame) @ T_rig_cam)
            images.write_image(folder / "images" / name / f"{frame_time(frame)}.png", image)
            (folder / "depth" / name).mkdir(parents=True, exist_ok=True)
            path = folder / "depth" / name / f"{frame_time(frame)}.png"
            cv2.imwrite(str(path), np.rint(depth * 1000).astype(np.uint16))
    (folder / "camera.yaml").write_text(text)
    write_poses(folder, [0.0, 1.0])
    dataset = build([folder], tmp_path / "out")
    assert dataset.pair_set_names == ["rig__rig__left", "rig__rig__right"]
    (pair,) = dataset.pair_set("rig__rig__right").pairs
    truth = invert(pose(1) @ T_rig_right) @ pose(0) @ T_rig_right
    assert pair.T_query_ref is not None
    np.testing.assert_allclose(pair.T_query_ref, truth, atol=1e-9)


@pytest.mark.thorough
def test_worker_processes_give_the_same_dataset(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, frames=3)
    options = importer.Options(correspondences=20)
    alone = importer.build([folder], options, tmp_path / "one", Silent(), Run())
    shared = importer.build([folder], options, tmp_path / "two", Silent(), Run(workers=2))
    assert alone.fingerprint == shared.fingerprint


def test_an_unfinished_build_is_resumed_to_the_same_bytes(tmp_path: Path) -> None:
    folder = write_folder(tmp_path)
    whole = build([folder], tmp_path / "out").fingerprint
    (tmp_path / "out" / "dataset.yaml").unlink()
    depth = tmp_path / "out" / "traversals" / "summer" / "depth" / "cam0" / f"{frame_time(1)}.png"
    depth.write_bytes(depth.read_bytes()[:40])
    assert build([folder], tmp_path / "out").fingerprint == whole


def test_unknown_key_of_the_camera_is_named_with_its_line(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, extra="focal: 3\n")
    with refused(DatasetError, "camera.yaml", None, "focal"):
        build([folder], tmp_path / "out")


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("no_poses", ("poses.txt", None, "missing")),
        ("bad_pose", ("poses.txt", 3, "8 columns", "found 3")),
        ("backwards", ("poses.txt", 3, "line 2")),
        ("other_clock", ("poses.txt", None, 2_000_000_000)),
        ("no_images", ("images", None, "TIMESTAMP.png")),
        ("bad_name", ("first.png", None, "first")),
        ("wrong_size", ("", None, "48x36", "96x72")),
        ("truncated", (f"images/{frame_time(1)}.png", None, "truncated")),
        ("no_scale", ("camera.yaml", None, "depth_scale")),
        ("orphan_depth", ("5.png", None, "no image", "depth")),
        ("no_depth", ("summer", None, "keyframe", "depth")),
    ],
)
def test_faults_of_a_folder_are_named_with_file_and_line(tmp_path: Path, fault: str, message: ErrorData) -> None:
    folder = write_folder(tmp_path)
    poses, image = folder / "poses.txt", folder / "images" / f"{frame_time(1)}.png"
    lines = poses.read_text().splitlines()
    if fault == "no_poses":
        poses.unlink()
    elif fault == "bad_pose":
        poses.write_text("\n".join([*lines[:2], "1.0 2 3"]) + "\n")
    elif fault == "backwards":
        poses.write_text("\n".join([lines[0], lines[2], lines[1]]) + "\n")
    elif fault == "other_clock":
        poses.write_text("".join(f"{i}.0 0 0 0 0 0 0 1\n" for i in range(3)))
    elif fault == "no_images":
        for path in (folder / "images").iterdir():
            path.unlink()
        for path in (folder / "depth").iterdir():
            path.unlink()
    elif fault == "bad_name":
        image.rename(folder / "images" / "first.png")
    elif fault == "wrong_size":
        cv2.imwrite(str(image), np.zeros((36, 48), np.uint8))
    elif fault == "truncated":
        image.write_bytes(image.read_bytes()[:200])
    elif fault == "no_scale":
        (folder / "camera.yaml").write_text(camera_yaml(PINHOLE))
    elif fault == "orphan_depth":
        (folder / "depth" / f"{frame_time(1)}.png").rename(folder / "depth" / "5.png")
    else:
        for path in (folder / "depth").iterdir():
            path.unlink()
    with refused(DatasetError, *message):
        build([folder], tmp_path / "out")


def test_two_files_of_one_time_are_refused(tmp_path: Path) -> None:
    (tmp_path / "1.00.png").touch()
    (tmp_path / "1.0.png").touch()
    with refused(DatasetError, "1.00.png", None, "1.0.png"):
        timed_files(tmp_path)


def test_traversals_are_named_after_their_folders(tmp_path: Path) -> None:
    for name in ("my drive", "a__b", "x/run", "y/run"):
        (tmp_path / name).mkdir(parents=True)
    assert traversal_names([tmp_path / "my drive", tmp_path / "a__b"]) == ["my-drive", "a_b"]
    with refused(DatasetError, "", None, "run"):
        traversal_names([tmp_path / "x" / "run", tmp_path / "y" / "run"])
    with refused(DatasetError, "absent"):
        traversal_names([tmp_path / "absent"])


def test_quaternion_order_of_a_trajectory_is_what_the_caller_says(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    expected = small_pose(2, yaw_deg=40)
    t, (x, y, z, w) = (values := pose_fields(expected))[:3], values[3:]
    path.write_text(f"1.0 {' '.join([*t, w, x, y, z])}\n")
    np.testing.assert_allclose(read_trajectory(path, "wxyz").by_time[10**9], expected, atol=1e-12)
    assert not np.allclose(read_trajectory(path).by_time[10**9], expected, atol=0.1)


def code_blocks(document: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", (DOCS / document).read_text(), re.MULTILINE | re.DOTALL)


def test_camera_files_of_the_documentation_are_valid(tmp_path: Path) -> None:
    traversal, frames = code_blocks("file-formats.md", "yaml")
    single, rig, lidars = code_blocks("recording-formats.md", "yaml")
    (tmp_path / "lidar.yaml").write_text(lidars)
    assert list(read_lidar_file(tmp_path).lidars) == ["top"]
    path = tmp_path / "camera.yaml"
    path.write_text(single)
    assert load_yaml(path, importer.SingleCameraFile, "a camera").camera.model == "radtan"
    path.write_text(rig)
    T_rig_right = load_yaml(path, importer.RigFile, "cameras").cameras["right"].T_rig_cam.matrix
    np.testing.assert_array_equal(T_rig_right, make_transform(np.eye(3), [0.3, 0, 0]))
    path.write_text(traversal)
    assert load_yaml(path, TraversalFile, "a traversal").condition.tags == ("wet road",)
    path.write_text(f"name: winter\n{frames}")
    assert list(load_yaml(path, TraversalFile, "a traversal").frames) == ["rig"]


def test_the_importer_worked_out_in_the_documentation_works(tmp_path: Path) -> None:
    (code,) = code_blocks("add-a-data-format.md", "python")
    example: dict[str, Any] = {"__name__": "posed_images"}
    exec(compile(code, "add-a-data-format.md", "exec"), example)
    sources = []
    for name, lateral_m in (("summer", 0.0), ("winter", 0.1)):
        folder = tmp_path / name
        (folder / "depth").mkdir(parents=True)
        camera = PINHOLE
        (folder / "intrinsics.txt").write_text(f"96 72 {camera.fx} {camera.fy} {camera.cx} {camera.cy}\n")
        lines = []
        for frame in range(3):
            image, depth = render(camera, pose(frame, lateral_m))
            images.write_image(folder / "images" / f"{frame}.png", image)
            cv2.imwrite(str(folder / "depth" / f"{frame}.png"), np.rint(depth * 1000).astype(np.uint16))
            tx, ty, tz, qx, qy, qz, qw = pose_fields(invert(pose(frame, lateral_m)))
            lines.append(f"{frame}.png {qw} {qx} {qy} {qz} {tx} {ty} {tz}\n")
        (folder / "poses.txt").write_text("".join(lines))
        sources.append(folder)
    dataset = example["build"](sources, example["Options"](correspondences=20), tmp_path / "out", Silent(), Run())
    (pair_set,) = dataset.pair_sets()
    assert pair_set.name == "summer__winter__cam0"
    assert len(pair_set.pairs) == 3
    for frame, pair in enumerate(pair_set.pairs):
        np.testing.assert_allclose(pair.T_query_ref, invert(pose(frame, 0.1)) @ pose(frame), atol=1e-9)
        assert pair.overlap is not None
        assert pair.overlap > 0.7
