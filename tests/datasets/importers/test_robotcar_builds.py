"""Drives that need more care than two good ones along one road: builds of minutes, killed ones and refused ones."""

from __future__ import annotations

import csv
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from killing import Fault, run_until_killed
from recording_reading import hashes
from refusals import assert_names
from robotcar_street import SMALL, Built, Elsewhere, RobotCarStreet, build_robotcar, record_robotcar

from relocbench.arrays import Array
from relocbench.geometry import invert, se3_exp, transform_to_tq

GAP_US = (2_000_000, 2_700_000)
"""after the first step of visual odometry"""

pytestmark = pytest.mark.thorough


@pytest.mark.thorough
def test_a_build_killed_twice_and_for_two_workers_ends_with_the_same_bytes(
    robotcar_street: RobotCarStreet, robotcar_built: Built, tmp_path: Path
) -> None:
    out = tmp_path / "dataset"
    arguments = ["build-dataset", "robotcar", *robotcar_street.folders, *SMALL, "--out", out, "-q"]

    registrations = Fault(r"groundtruth/registrations/.*\.journal$", 2, ("append",), "main")
    depth = Fault(r"traversals/[^/]+/depth/.*\.png$", 3, ("rename",), "main")
    for number, stage in enumerate((registrations, depth)):  # within the submaps: test_groundtruth_submaps
        command = ["python", "-m", "relocbench", *arguments, "-j", 2 - number]
        run_until_killed(command, stage, tmp_path / f"trace{number}")
        assert not (out / "dataset.yaml").exists()
    journals = list(out.glob("groundtruth/registrations/*"))
    assert journals
    assert all(p.suffix == ".csv" for p in journals)
    assert relocbench(*arguments, "-j", 2).status == 0
    assert hashes(out) == hashes(robotcar_built.root)


def copied(drives: RobotCarStreet, folder: Path) -> tuple[Path, Path]:
    """Reference and query in a folder of their own, to be damaged."""
    for source in (drives.reference.folder, drives.query.folder):
        shutil.copytree(source, folder / source.name)
    for name in ("extrinsics", "models", "tags"):
        shutil.copytree(drives.reference.folder.parent / name, folder / name)
    return folder / drives.reference.name, folder / drives.query.name


def pose_words(drives: RobotCarStreet, built: Built, moved: Array) -> str:
    """``--first-pose`` of a moment in the middle of the drive; the truth is multiplied by ``moved``."""
    pair = built.dataset.pair_set(drives.pair_set).pairs[5]
    rig = built.dataset.traversal(drives.query.name).T_rig_cam("stereo_left")
    T_ref_query = rig @ invert(drives.exact(pair)) @ invert(rig) @ moved
    t, q = transform_to_tq(T_ref_query)
    return " ".join(map(str, [pair.ref_timestamp_ns, pair.query_timestamp_ns, *t.tolist(), *q.tolist()]))


@pytest.mark.thorough
def test_limits_of_sigma_hold_and_a_right_first_pose_is_taken(
    robotcar_street: RobotCarStreet, robotcar_built: Built, tmp_path: Path
) -> None:
    out = tmp_path / "dataset"
    first = pose_words(robotcar_street, robotcar_built, np.eye(4))
    outcome = build_robotcar(
        out,
        robotcar_street.reference.folder,
        robotcar_street.query.folder,
        "--max-sigma",
        0.0002,
        "--first-pose",
        first,
    )
    assert outcome.status == 2
    complaint = next(line for line in outcome.err.splitlines() if line.startswith("relocbench: "))
    assert_names(complaint, "", None, robotcar_street.query.name, "0.0002 m")
    assert not any(re.search(r"query node \d+", line) for line in outcome.err.splitlines()), outcome.err
    with next((out / "groundtruth" / "registrations").glob("*.csv")).open(newline="") as stream:
        assert all(row["trusted"] == "1" for row in csv.DictReader(stream))


@pytest.fixture(scope="module")
def unusual(robotcar_street: RobotCarStreet, robotcar_built: Built, tmp_path_factory: pytest.TempPathFactory) -> Built:
    """A gap in the visual odometry, a first pose 6 m off, empty scans, depth by stereo."""
    folder = tmp_path_factory.mktemp("unusual")
    reference, query = copied(robotcar_street, folder)
    path = query / "vo" / "vo.csv"
    header, *rows = path.read_text().splitlines()
    start = int(rows[0].split(",")[1])
    kept = [row for row in rows if not GAP_US[0] <= int(row.split(",")[0]) - start <= GAP_US[1]]
    assert len(kept) < len(rows) - 8
    path.write_text("\n".join([header, *kept]) + "\n")
    for scan in sorted((query / "lms_rear").glob("*.bin"))[20:24]:
        scan.write_bytes(np.zeros((541, 3)).tobytes())
    out = folder / "dataset"
    first = pose_words(robotcar_street, robotcar_built, se3_exp(np.array([6.0, 0, 0, 0, 0, 0])))
    others = ("--depth", "stereo", "--cameras", "stereo_left", "--max-angle", 50)
    outcome = build_robotcar(out, reference, query, "--first-pose", first, *others)
    assert outcome.status == 0, outcome.err
    return Built(out, outcome)


def test_pairs_in_a_gap_of_the_odometry_are_rejected_and_the_rest_is_right(
    robotcar_street: RobotCarStreet, unusual: Built
) -> None:
    rows = unusual.table(robotcar_street.pair_set)
    gap = [int(r["query_timestamp_ns"]) for r in rows if "odometry" in r["reason"]]
    accepted = [int(r["query_timestamp_ns"]) for r in rows if r["accepted"] == "true"]
    assert gap
    # Beyond the gap the drive is found again.
    assert min(accepted) < min(gap) < max(gap) < max(accepted)
    errors = robotcar_street.errors(unusual.dataset)
    assert errors.translation_error_m.max() < 0.10
    assert errors.rotation_error_deg.max() < 0.15


def test_a_wrong_first_pose_is_found_out(unusual: Built) -> None:
    assert re.search(r"query node \d+", unusual.outcome.err)


def test_depth_by_stereo_is_dense_and_says_so(robotcar_street: RobotCarStreet, unusual: Built) -> None:
    traversal = unusual.dataset.traversal(robotcar_street.reference.name)
    assert "depth from stereo" in traversal.layout.traversal_yaml.read_text()
    depth = [traversal.depth("stereo_left", t) for t in traversal.keyframe_timestamps("stereo_left")]
    assert all(d is not None and (d > 0).mean() > 0.05 for d in depth)


def complaint_of(drives: RobotCarStreet, query: Path, out: Path) -> str:
    outcome = build_robotcar(out, drives.reference.folder, query)
    assert outcome.status == 2
    return next(line for line in outcome.err.splitlines() if line.startswith("relocbench: "))


def test_a_drive_the_other_way_has_no_keyframe_that_looks_its_way(
    robotcar_street: RobotCarStreet, tmp_path: Path
) -> None:
    path = Elsewhere(start_m=-32.0, backwards=True)
    query = record_robotcar(tmp_path, 3, "Sunny", path, ("stereo/left",), 48)
    assert re.search(r" 60 deg: 1[78]\d deg", complaint_of(robotcar_street, query.folder, tmp_path / "dataset"))


def test_drives_that_never_meet_are_refused(robotcar_street: RobotCarStreet, tmp_path: Path) -> None:
    query = record_robotcar(tmp_path, 2, "Sunny", Elsewhere(start_m=110.0), ("stereo/left",), 16)
    complaint = complaint_of(robotcar_street, query.folder, tmp_path / "dataset")
    assert_names(complaint, "", None, query.name)
    assert not (tmp_path / "dataset" / "dataset.yaml").exists()
