"""``--recipe open3d``: the plain recipe is what it says, and its datasets are complete."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
import street_clouds as clouds
from command_line import Outcome, relocbench
from recording_reading import hashes
from refusals import assert_names
from rig_drives import RigDrives, rig_drives
from robotcar_street import RobotCarStreet

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.recipe.answers import SOURCE
from relocbench.datasets.groundtruth.recipe.chain import RawSubmaps
from relocbench.datasets.groundtruth.recipe.open3d_pair import Cloud, Open3dFit, Open3dOptions, refine, search
from relocbench.datasets.importers.robotcar.recording import read_robotcar_drives
from relocbench.geometry import apply, hat, invert, make_transform, rotation_angle, so3_exp
from relocbench.progress import Silent

OPTIONS = Open3dOptions()
T_STREET_REF, T_STREET_QUERY = clouds.pose(100.0, 0.3, 1.0), clouds.pose(101.2, -0.6, -2.0)
TRUTH = invert(T_STREET_REF) @ T_STREET_QUERY


def off(T: Array, true: Array) -> tuple[float, float]:
    """Metres and degrees."""
    wrong = invert(true) @ T
    return float(np.linalg.norm(wrong[:3, 3])), float(np.degrees(rotation_angle(wrong[:3, :3])))


@pytest.fixture(scope="module")
def street() -> tuple[Cloud, Cloud]:
    """The clouds of two drives through one street."""
    town = clouds.irregular(3)
    parts = (clouds.submap(town, 1, T_STREET_REF), clouds.submap(town, 2, T_STREET_QUERY))
    ref, query = (Cloud.of(part.points.astype(np.float64), OPTIONS) for part in parts)
    return ref, query


@pytest.mark.thorough
def test_ransac_and_icp_find_the_pose_of_two_clouds_without_a_prediction(street: tuple[Cloud, Cloud]) -> None:
    found = [refine(*street, search(*street, OPTIONS), OPTIONS) for _ in range(2)]
    metres, degrees = off(found[0].T_ref_query, TRUTH)
    assert metres < 0.1
    assert degrees < 0.2
    assert found[0].refusal(OPTIONS) == ""
    # The same seed searches the same way, whatever the threads of Open3D do.
    assert np.array_equal(found[0].T_ref_query, found[1].T_ref_query)
    assert np.array_equal(found[0].information, found[1].information)


def test_the_information_matrix_is_that_of_corresponding_points() -> None:
    """By its definition: the sum of J^T J, with the derivative J of points by the twist on the right of the pose."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-20, 20, size=(500, 3))
    T_ref_query = make_transform(so3_exp(np.array([0.1, -0.2, 1.0])), [5.0, -3.0, 1.0])
    # A point in each voxel, so that thinning leaves all of them, and each finds itself.
    options = Open3dOptions(fine_m=1e-3, icp_reach_m=0.2, icp_iterations=0)
    ref, query = Cloud.of(apply(T_ref_query, points), options), Cloud.of(points, options)
    fit = refine(ref, query, T_ref_query, options)
    jacobians = [T_ref_query[:3, :3] @ np.hstack([np.eye(3), -hat(p)]) for p in points]
    expected = np.sum([J.T @ J for J in jacobians], axis=0)
    assert np.allclose(fit.information, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("fitness", "rmse_m", "reason"),
    [(0.9, 0.1, ""), (0.41, 0.1, "fitness 0.41 is below 0.6"), (0.9, 0.31, "RMSE 0.310 m exceeds 0.2 m")],
)
def test_fitness_and_rmse_alone_decide(fitness: float, rmse_m: float, reason: str) -> None:
    assert Open3dFit(np.eye(4), fitness, rmse_m, np.eye(6)).refusal(OPTIONS) == reason


SMALL = (
    *("--submap", 30, "--keyframe-distance", 3, "--query-distance", 4, "--max-distance", 3),
    *("--recipe", "open3d", "--cameras", "none"),
)


def build(out: Path, *arguments: object) -> Outcome:
    return relocbench("build-dataset", "robotcar", "--out", out, "-j", 1, *SMALL, *arguments)


@pytest.fixture(scope="module")
def drives(robotcar_street: RobotCarStreet) -> RigDrives:
    return rig_drives(robotcar_street, *SMALL)


@pytest.mark.thorough
def test_raw_submaps_hold_the_points_of_the_road_around_a_time(drives: RigDrives) -> None:
    recording = read_robotcar_drives(list(drives.folders), cameras=(), reporter=Silent())[0]
    middle = int(recording.odometry.times_ns[len(recording.odometry.times_ns) // 2])
    begin, end = RawSubmaps(recording, 10.0).span(middle)
    way = recording.odometry.at(np.array([begin, middle, end - 1], dtype=np.int64))[:, :3, 3]
    assert np.linalg.norm(np.diff(way, axis=0), axis=1) == pytest.approx([5.0, 5.0], abs=0.8)
    short, long = (len(RawSubmaps(recording, metres).around(middle)) for metres in (5.0, 20.0))
    assert 2 * short < long


@pytest.mark.thorough
def test_the_dataset_is_complete_and_says_what_made_it(drives: RigDrives) -> None:
    assert drives.outcome.status == 0, drives.outcome.err
    assert "first pair by Open3D's global registration" in drives.outcome.err
    assert len(drives.pairs) >= 6
    accepted = [pair for pair in drives.pairs if pair.accepted]
    assert len(accepted) >= 0.8 * len(drives.pairs)
    assert {pair.source for pair in drives.pairs} == {SOURCE}
    assert not any(pair.has_calibrated_sigmas for pair in drives.pairs)
    assert "not calibrated" in drives.outcome.err
    for pair in accepted:
        assert pair.T_query_ref is not None
        metres, degrees = off(pair.T_query_ref, drives.exact(pair))
        assert metres < 0.3
        assert degrees < 1.0
        sigmas = (*pair.axis_sigmas, pair.sigma_translation_m, pair.sigma_rotation_deg)
        assert all(sigma is not None and 0 < sigma < 0.15 for sigma in sigmas)
    assert relocbench("validate", drives.out).status == 0
    # None of the builder's own stages took part.
    assert {p.name for p in (drives.out / "groundtruth").iterdir()} == {"blocks", "recipe", "registrations", "graph"}


@pytest.mark.thorough
def test_a_build_that_was_interrupted_ends_with_the_same_bytes(drives: RigDrives, tmp_path: Path) -> None:
    shutil.copytree(drives.out, tmp_path / "d")
    before = hashes(tmp_path / "d")
    (tmp_path / "d" / "dataset.yaml").unlink()
    shutil.rmtree(tmp_path / "d" / "groundtruth" / "graph")
    table = next((tmp_path / "d" / "groundtruth" / "recipe").iterdir())
    stamp = table.stat().st_mtime_ns
    assert build(tmp_path / "d", *drives.folders).status == 0
    assert hashes(tmp_path / "d") == before
    assert table.stat().st_mtime_ns == stamp


@pytest.mark.thorough
def test_a_first_pose_is_taken_as_it_is_given(drives: RigDrives, tmp_path: Path) -> None:
    """Neither searched for nor verified: with one that is far off, everything after it is lost and rejected."""
    pair = drives.pairs[len(drives.pairs) // 2]
    wrong = invert(drives.exact(pair)) @ make_transform(np.eye(3), [0.0, 2.5, 0.0])
    numbers = [*map(str, pair.key), *map(repr, wrong[:3, 3].tolist()), "0 0 0 1"]
    outcome = build(tmp_path / "d", *drives.folders, "--first-pose", " ".join(numbers))
    assert "global registration" not in outcome.err
    with next((tmp_path / "d" / "groundtruth" / "recipe").glob("*.csv")).open() as stream:
        trusted = [row["trusted"] == "1" for row in csv.DictReader(stream)]
    assert np.mean(trusted) < 0.5, outcome.err


@pytest.mark.parametrize(
    ("given", "names"),
    [(("--icp", "open3d"), ("icp",)), (("--matcher", "fgr", "--max-sigma", "0.1"), ("matcher", "max_sigma"))],
)
def test_options_that_the_recipe_has_not_are_refused(
    tmp_path: Path, given: tuple[str, ...], names: tuple[str, ...]
) -> None:
    outcome = build(tmp_path / "d", tmp_path / "summer", tmp_path / "winter", *given)
    assert outcome.status == 2
    assert_names(outcome.complaint, "", None, "open3d", *names)
    assert not (tmp_path / "d").exists()
