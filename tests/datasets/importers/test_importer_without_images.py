"""Lidar drives without images become datasets of poses alone, whose pairs hold the same targets as pairs of images."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import Outcome, relocbench
from recording_reading import hashes
from refusals import assert_names
from rig_drives import RigDrives, rig_drives
from robotcar_street import RobotCarStreet

from relocbench.geometry import invert, rotation_angle

SMALL = (
    *("--submap", 30, "--keyframe-distance", 1.5, "--query-distance", 3, "--max-distance", 3),
    *("--matcher", "fgr", "--cameras", "none"),
)

pytestmark = pytest.mark.thorough


def build(out: Path, *arguments: object) -> Outcome:
    return relocbench("build-dataset", "robotcar", "--out", out, "-j", 1, *SMALL, *arguments)


@pytest.fixture(scope="module")
def drives(robotcar_street: RobotCarStreet) -> RigDrives:
    return rig_drives(robotcar_street, *SMALL)


def test_pairs_of_the_rig_are_right_to_centimetres_and_their_sigmas_too(drives: RigDrives) -> None:
    assert drives.outcome.status == 0, drives.outcome.err
    pairs = drives.dataset.pair_set(drives.pair_set).all_pairs
    accepted = [p for p in pairs if p.accepted]
    assert len(pairs) >= 8
    assert len(accepted) >= 0.9 * len(pairs)
    errors, normalised = [], []
    for pair in accepted:
        assert pair.T_query_ref is not None
        wrong = drives.exact(pair) @ invert(pair.T_query_ref)
        errors.append((np.linalg.norm(wrong[:3, 3]), np.degrees(rotation_angle(wrong[:3, :3]))))
        normalised.append(np.mean(np.square(wrong[:3, 3] / np.array(pair.axis_sigmas, dtype=np.float64))))
    metres, degrees = np.array(errors).T
    assert np.median(metres) < 0.03
    assert metres.max() < 0.10
    assert degrees.max() < 0.15
    assert np.mean(normalised) < 2.5


def test_every_pair_has_its_sigmas_or_its_reason_and_times_are_those_of_scans(drives: RigDrives) -> None:
    dataset = drives.dataset
    scans = [{int(p.stem) * 1000 for p in (folder / "lms_front").glob("*.bin")} for folder in drives.folders]
    pairs = dataset.pair_set(drives.pair_set).all_pairs
    assert {p.source for p in pairs} == {"lidar registration, pose graph"}
    for pair in pairs:
        assert pair.ref_timestamp_ns in scans[0]
        assert pair.query_timestamp_ns in scans[1]
        sigmas = (*pair.axis_sigmas, pair.sigma_translation_m, pair.sigma_rotation_deg)
        assert all(s is not None and 0 < s <= 0.15 for s in sigmas) if pair.accepted else pair.reason
        assert pair.overlap is None
    gaps = np.diff(sorted(p.query_timestamp_ns for p in pairs))
    assert (gaps > 0).all()


def test_the_dataset_has_frames_and_neither_images_nor_depth(drives: RigDrives) -> None:
    for name in drives.dataset.traversal_names:
        traversal = drives.dataset.traversal(name)
        assert (traversal.cameras, traversal.frames) == ([], ["rig"])
        assert traversal.file.source.endswith("poses of the rig at scans of lms_front")
        assert {p.name for p in traversal.layout.root.iterdir()} == {"traversal.yaml", "poses.csv"}
    assert not (drives.out / "correspondences").exists()
    assert "rig: " in drives.outcome.err
    checked = relocbench("validate", drives.out)
    assert checked.status == 0, checked.out


def test_the_ground_truth_is_drawn_without_images(drives: RigDrives, tmp_path: Path) -> None:
    done = relocbench("inspect", drives.out, "--ground-truth", tmp_path / "gt", "--pairs", 2, "-q")
    assert done.status == 0, done.err
    names = {p.name for p in (tmp_path / "gt").rglob("*.png")}
    assert {"residuals.png", "map.png", "overlay_01.png"} <= names
    assert not any(name.startswith("keyframe") for name in names)


def test_a_build_that_is_run_again_ends_with_the_same_bytes(drives: RigDrives, tmp_path: Path) -> None:
    shutil.copytree(drives.out, tmp_path / "d")
    before = hashes(tmp_path / "d")
    (tmp_path / "d" / "dataset.yaml").unlink()
    shutil.rmtree(tmp_path / "d" / "pairs")
    assert build(tmp_path / "d", *drives.folders).status == 0
    assert hashes(tmp_path / "d") == before


def test_predictions_on_it_are_scored(drives: RigDrives, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "r", "--json", "-q")
    outcome = relocbench("evaluate", "-d", drives.out, "-m", "identity", "-m", "clock", *out)
    assert outcome.status == 0, outcome.err
    scored = json.loads(outcome.out)["methods"]
    assert scored["identity"][drives.pair_set]["all"]["coverage"] == 1.0


def test_stereo_depth_of_no_images_is_refused_before_any_work(drives: RigDrives, tmp_path: Path) -> None:
    outcome = build(tmp_path / "d", *drives.folders, "--depth", "stereo")
    assert outcome.status == 2
    assert_names(outcome.complaint, "", None, "--depth stereo")
    assert not (tmp_path / "d").exists()
