"""KITTI sequences and generic folders with lidar become datasets across drives, by the command a user types."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from command_line import Outcome, relocbench
from kitti_street import FRAMES
from recording_reading import hashes
from refusals import assert_names

from relocbench.datasets.core.dataset import Dataset
from relocbench.geometry import invert, rotation_angle, transform_to_tq

SMALL = (
    *("--submap", 20, "--depth-submap", 10, "--keyframe-distance", 5, "--query-distance", 4, "--correspondences", 50),
    *("--calibration", "given"),
)


def exact(root: Path, sequence: str) -> np.ndarray:
    """(N, 4, 4) ``T_world_cam0``."""
    lines = (root / "truth" / sequence / "poses_cam0.txt").read_text().splitlines()
    return np.array([[*map(float, line.split()), 0, 0, 0, 1] for line in lines]).reshape(-1, 4, 4)


def T_cam0_lidar_of(root: Path) -> np.ndarray:
    lines = (root / "sequences" / "00" / "calib.txt").read_text().splitlines()
    numbers = dict(line.split(": ", 1) for line in lines if ": " in line)["Tr"]
    return np.array([*map(float, numbers.split()), 0, 0, 0, 1]).reshape(4, 4)


def worst(root: Path, dataset: Dataset, pair_set: str, T_cam0_frame: np.ndarray | None = None) -> tuple[float, float]:
    """Metres and degrees, of pairs whose times count tenths of seconds.

    Args:
        T_cam0_frame: (4, 4) of the frame whose poses are paired; default: the camera.
    """
    T_cam0_frame = np.eye(4) if T_cam0_frame is None else T_cam0_frame
    there, here = exact(root, "00") @ T_cam0_frame, exact(root, "01") @ T_cam0_frame
    errors = []
    for pair in dataset.pair_set(pair_set).pairs:
        ref, query = pair.ref_timestamp_ns // 10**8, pair.query_timestamp_ns // 10**8
        assert pair.T_query_ref is not None
        wrong = there[ref] @ invert(pair.T_query_ref) @ invert(here[query])
        wrong = invert(here[query]) @ wrong @ here[query]
        errors.append((np.linalg.norm(wrong[:3, 3]), np.degrees(rotation_angle(wrong[:3, :3]))))
    assert len(errors) >= 4
    metres, degrees = np.array(errors).max(axis=0).tolist()
    return metres, degrees


def build(kind: str, out: Path, *arguments: object) -> Outcome:
    return relocbench("build-dataset", kind, *arguments, "--out", out, "-j", 1, *SMALL)


@pytest.mark.thorough
def test_sequences_of_kitti_are_brought_together_with_and_without_images(kitti_street: Path, tmp_path: Path) -> None:
    out = tmp_path / "dataset"
    chosen = ("--sequence", "00,01", "--odometry", "poses", "--matcher", "fgr")
    outcome = build("kitti-lidar", out, kitti_street, *chosen)
    assert outcome.status == 0, outcome.err
    metres, degrees = worst(kitti_street, Dataset(out), "kitti_00__kitti_01__image_0")
    assert metres < 0.10
    assert degrees < 0.15
    assert "image_1" in outcome.err
    # Images and scans of KITTI have the same times, so that a build without images pairs the same moments.
    alone = tmp_path / "alone"
    assert build("kitti-lidar", alone, kitti_street, *chosen, "--cameras", "none").status == 0
    (of_images,), (of_rig,) = (Dataset(folder).pair_sets() for folder in (out, alone))
    T_rig_cam = Dataset(out).traversal("kitti_00").T_rig_cam("image_0")
    by_key = {p.key: p for p in of_images.pairs}
    both = [p for p in of_rig.pairs if p.key in by_key]
    assert len(both) >= 4
    for pair in both:
        T_query_ref = by_key[pair.key].T_query_ref
        assert T_query_ref is not None
        assert pair.T_query_ref is not None
        np.testing.assert_allclose(pair.T_query_ref, T_rig_cam @ T_query_ref @ invert(T_rig_cam), atol=1e-6)


@pytest.mark.thorough
def test_the_default_matcher_finds_them_by_odometry_from_scans_which_is_kept(
    kitti_street: Path, tmp_path: Path
) -> None:
    out = tmp_path / "dataset"
    arguments = ("kitti-lidar", out, kitti_street, "--sequence", "00,01")
    assert build(*arguments).status == 0
    metres, degrees = worst(kitti_street, Dataset(out), "kitti_00__kitti_01__image_0")
    assert metres < 0.10
    assert degrees < 0.15
    kept = sorted((out / "groundtruth" / "odometry").iterdir())
    assert [p.name for p in kept] == ["kitti_00.csv", "kitti_01.csv"]
    before = hashes(out), [p.stat().st_mtime_ns for p in kept]
    (out / "dataset.yaml").unlink()
    shutil.rmtree(out / "groundtruth" / "graph")
    assert build(*arguments).status == 0
    assert (hashes(out), [p.stat().st_mtime_ns for p in kept]) == before


def generic_drive(kitti: Path, sequence: str, folder: Path) -> Path:
    """The same drive in the generic layout, its exact motion as odometry."""
    source = kitti / "sequences" / sequence
    for number in range(FRAMES):
        for name, source_file, target in (
            ("lidar", source / "velodyne" / f"{number:06d}.bin", folder / "lidar" / "top" / f"{number * 10**8}.bin"),
            ("image", source / "image_0" / f"{number:06d}.png", folder / "images" / "cam0" / f"{number * 10**8}.png"),
        ):
            assert source_file.exists(), name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source_file, target)
    lines = dict(line.split(": ", 1) for line in (source / "calib.txt").read_text().splitlines() if ": " in line)
    fx, _, cx, _, _, fy, cy = map(float, lines["P0"].split()[:7])
    T_cam0_lidar = T_cam0_lidar_of(kitti)

    def transform(pose: np.ndarray) -> dict[str, list[float]]:
        t, q = transform_to_tq(pose)
        return {"translation_m": t.tolist(), "quaternion_xyzw": q.tolist()}

    image = cv2.imread(str(next((folder / "images" / "cam0").iterdir())), cv2.IMREAD_UNCHANGED)
    assert image is not None
    height, width = image.shape[:2]
    camera = {"model": "pinhole", "width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    cameras = {"cam0": camera | {"T_rig_cam": transform(invert(T_cam0_lidar))}}
    (folder / "camera.yaml").write_text(yaml.safe_dump({"cameras": cameras}))
    lidar = {"pattern": "spinning", "T_rig_lidar": transform(np.eye(4)), "max_range": 100, "sigma": 0.02}
    (folder / "lidar.yaml").write_text(yaml.safe_dump({"rig_axes": "forward-left-up", "lidars": {"top": lidar}}))
    poses = exact(kitti, sequence) @ T_cam0_lidar
    t, q = transform_to_tq(invert(poses[0]) @ poses)
    rows = [f"{k * 10**8} {' '.join(map(repr, row))}" for k, row in enumerate(np.hstack([t, q]).tolist())]
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    return folder


@pytest.mark.thorough
@pytest.mark.parametrize("camera", ["none", "cam0"])
def test_generic_folders_with_lidar_are_brought_together(kitti_street: Path, tmp_path: Path, camera: str) -> None:
    names = {"00": "summer", "01": "winter"}
    drives = [generic_drive(kitti_street, number, tmp_path / name) for number, name in names.items()]
    out = tmp_path / "dataset"
    outcome = build("generic-lidar", out, *drives, "--matcher", "fgr", "--cameras", camera)
    assert outcome.status == 0, outcome.err
    paired = ("summer__winter__cam0",) if camera == "cam0" else ("summer__winter__rig", T_cam0_lidar_of(kitti_street))
    metres, degrees = worst(kitti_street, Dataset(out), *paired)
    assert metres < 0.10
    assert degrees < 0.15
    assert not (out / "groundtruth" / "odometry").exists()
    assert relocbench("validate", out).status == 0


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("kind", "arguments", "place", "names"),
    [
        ("kitti-lidar", ["--sequence", "00"], "", ()),
        ("kitti-lidar", ["--sequence", "00,00"], "", ()),
        ("kitti-lidar", ["--sequence", "00,07"], "sequences/07", ()),
        ("generic-lidar", [], "", ("1",)),
    ],
)
def test_what_cannot_be_built_is_one_line_and_status_2(
    kitti_street: Path, tmp_path: Path, kind: str, arguments: list[object], place: str, names: tuple[str, ...]
) -> None:
    outcome = build(kind, tmp_path / "dataset", kitti_street, *arguments)
    assert outcome.status == 2
    assert_names(outcome.complaint, place, None, *names)
