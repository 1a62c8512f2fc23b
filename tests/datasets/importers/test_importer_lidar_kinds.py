"""KITTI sequences and generic folders with lidar become datasets across drives, by the command a user types."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from command_line import Outcome, relocbench
from fenced_street import fenced_street_mesh
from recording_reading import hashes
from small_street import SolidTexture, StraightRoad, Street

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.jobs.recording import record
from relocbench.geometry import invert, rotation_angle, transform_to_tq

FRAMES = 26
SMALL = ("--submap", 20, "--depth-submap", 12, "--keyframe-distance", 2, "--query-distance", 3, "--correspondences", 50)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def kitti(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sequences along one street."""
    out = tmp_path_factory.mktemp("kitti")
    for number in range(2):
        record(
            Street(),
            StraightRoad(),
            Factors(),
            out,
            "kitti",
            frames=FRAMES,
            scale=0.15,
            rings=16,
            azimuths=360,
            number=number,
            renderer_factory=SolidTexture,
            compose=fenced_street_mesh,
        )
    return out


def exact(root: Path, sequence: str) -> np.ndarray:
    """(N, 4, 4) ``T_world_cam0``."""
    lines = (root / "truth" / sequence / "poses_cam0.txt").read_text().splitlines()
    return np.array([[*map(float, line.split()), 0, 0, 0, 1] for line in lines]).reshape(-1, 4, 4)


def worst(root: Path, dataset: Dataset, pair_set: str) -> tuple[float, float]:
    """Metres and degrees, of pairs whose times count tenths of seconds."""
    there, here = exact(root, "00"), exact(root, "01")
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


def test_sequences_of_kitti_are_brought_together_and_their_odometry_is_kept(kitti: Path, tmp_path: Path) -> None:
    out = tmp_path / "dataset"
    arguments = ("kitti-lidar", out, kitti, "--sequence", "00,01")
    outcome = build(*arguments)
    assert outcome.status == 0, outcome.err
    metres, degrees = worst(kitti, Dataset(out), "kitti_00__kitti_01__image_0")
    assert metres < 0.10
    assert degrees < 0.15
    assert "lidar against stereo with image_1" in outcome.err
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
    T_cam0_lidar = np.array([*map(float, lines["Tr"].split()), 0, 0, 0, 1]).reshape(4, 4)

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


def test_generic_folders_with_lidar_are_brought_together(kitti: Path, tmp_path: Path) -> None:
    drives = [generic_drive(kitti, number, tmp_path / name) for number, name in (("00", "summer"), ("01", "winter"))]
    out = tmp_path / "dataset"
    outcome = build("generic-lidar", out, *drives, "--matcher", "fgr")
    assert outcome.status == 0, outcome.err
    metres, degrees = worst(kitti, Dataset(out), "summer__winter__cam0")
    assert metres < 0.10
    assert degrees < 0.15
    assert not (out / "groundtruth" / "odometry").exists()
    assert relocbench("validate", out).status == 0


@pytest.mark.parametrize(
    ("kind", "arguments", "words"),
    [
        ("kitti-lidar", ["--sequence", "00"], "two or more sequences"),
        ("kitti-lidar", ["--sequence", "00,00"], "names a sequence twice"),
        ("kitti-lidar", ["--sequence", "00,07"], "sequences/07: no such folder"),
        ("kitti-lidar", ["--sequence", "00,01", "--cameras", "image_7"], "has no images of a camera 'image_7'"),
        ("generic-lidar", [], "needs a reference and at least one query, got 1"),
    ],
)
def test_what_cannot_be_built_is_one_line_and_status_2(
    kitti: Path, tmp_path: Path, kind: str, arguments: list[object], words: str
) -> None:
    outcome = build(kind, tmp_path / "dataset", kitti, *arguments)
    assert outcome.status == 2
    assert "Traceback" not in outcome.err
    assert words in outcome.err


def test_a_scan_that_is_cut_off_is_named(kitti: Path, tmp_path: Path) -> None:
    shutil.copytree(kitti, tmp_path / "kitti")
    scan = tmp_path / "kitti" / "sequences" / "01" / "velodyne" / "000005.bin"
    scan.write_bytes(scan.read_bytes()[:-3])
    outcome = build("kitti-lidar", tmp_path / "dataset", tmp_path / "kitti", "--sequence", "00,01")
    assert outcome.status == 2
    assert "01/velodyne/000005.bin: " in outcome.err
