"""Calibration of lidars: how errors enter, what the evidence is, and which causes are found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from relocbench.arrays import Array
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.calibration.adjustment import Adjustment, CalibrationEdges, Reduced
from relocbench.datasets.groundtruth.calibration.correction import CorrectedLidar, corrected
from relocbench.datasets.groundtruth.calibration.estimation import CalibrationEvidence, about, node_twists
from relocbench.datasets.groundtruth.calibration.faults import calibrate, find_causes
from relocbench.datasets.groundtruth.calibration.files import (
    RoundFolders,
    read_calibration,
    read_evidence,
    write_calibration,
    write_evidence,
)
from relocbench.datasets.groundtruth.calibration.lidar_fits import corrections_of, distances, placed
from relocbench.datasets.groundtruth.calibration.messages import open_kinds, report_lines
from relocbench.datasets.groundtruth.calibration.unknowns import RIG, SIZE, Cause, DriveLidars, Sensors, moves
from relocbench.datasets.groundtruth.pose_graph.both_drives import BothDrives
from relocbench.datasets.groundtruth.pose_graph.edges import Edges, Kind
from relocbench.datasets.groundtruth.pose_graph.odometry_noise import OdometryNoise
from relocbench.datasets.groundtruth.pose_graph.odometry_scale import scales_of
from relocbench.datasets.sensors.recording import FieldRecording, Scan, Trajectory
from relocbench.errors import DatasetError
from relocbench.geometry import adjoint, apply, invert, make_transform, se3_exp, se3_log, so3_exp

SUMMER = DriveLidars("summer", ("front", "rear"))
WINTER = DriveLidars("winter", ("front", "rear"))
SENSORS = Sensors((SUMMER, WINTER))
LATE_S = 0.05
COUNT = 60


def test_a_late_lidar_places_what_it_measured_as_the_correction_says() -> None:
    twist = np.array([8.0, 0.2, -0.1, 0.02, -0.03, 0.5])
    unknowns = np.array([0.01, -0.02, 0.03, 0.004, -0.002, 0.003, 0.02])
    p = np.array([3.0, -7.0, 2.0])
    right = apply(se3_exp(-unknowns[6] * twist) @ se3_exp(unknowns[:6]), p)
    u = moves(twist) @ unknowns
    assert np.linalg.norm(right - (p + u[:3] + np.cross(u[3:], p))) < 0.002  # of second order


@given(st.lists(st.floats(-0.05, 0.05), min_size=6, max_size=6), st.lists(st.floats(-2, 2), min_size=3, max_size=3))
def test_a_twist_about_a_place_moves_points_as_turning_about_it_does(xi: list[float], place: list[float]) -> None:
    small, at = np.array(xi) * 1e-3, np.array(place)
    p = np.array([4.0, 1.0, -2.0])
    turned = at + so3_exp(small[3:]) @ (p - at) + small[:3]
    assert np.allclose(apply(se3_exp(about(at) @ small), p), turned, atol=1e-7)


def test_corrections_turn_and_shift_as_their_twists_say() -> None:
    u = np.array([[0.1, -0.2, 0.3, 0.0, 0.0, 0.02], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    (R, shift), (nothing, none) = corrections_of(u)
    assert np.allclose(R, so3_exp([0.0, 0.0, 0.02]))
    assert np.allclose(shift, [0.1, -0.2, 0.3])
    assert np.allclose(nothing, np.eye(3))
    assert not none.any()


@pytest.mark.thorough
def test_points_and_planes_are_corrected_about_where_the_rig_was() -> None:
    rng = np.random.default_rng(0)
    points, rigs, off = rng.normal(size=(5, 3)) * 10, rng.normal(size=(5, 3)), rng.normal(size=5)
    normals = rng.normal(size=(5, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    u, T_a_b, middle = rng.normal(size=(1, 6)) * 0.01, se3_exp(rng.normal(size=6)), rigs.mean(axis=0)
    ((R, shift),) = corrections_of(u)
    there = rigs + (points - rigs) @ R.T + u[0, :3]
    moved, facing, back, back_facing = placed(points, normals, rigs, R, shift, T_a_b, R, shift, middle)
    assert np.allclose(moved, there)
    assert np.allclose(facing, normals @ R.T)
    # They are searched for where they would be if what lidar a measured were not corrected.
    assert np.allclose(middle + (back - middle) @ R.T + u[0, :3], apply(T_a_b, moved))
    assert np.allclose(back_facing @ R.T, facing @ T_a_b[:3, :3].T)
    J, apart = distances(there + off[:, None] * facing, points, normals, rigs, np.eye(4), R, shift)
    assert np.allclose(apart, off)
    assert np.allclose(J[:, :3], facing)


def test_causes_are_those_of_the_rig_of_drives_and_of_single_lidars() -> None:
    names = {str(cause) for cause in SENSORS.causes()}
    assert {
        "extrinsics of all lidars",
        "time of winter",
        "extrinsics of summer/rear",
        "time of all drives/rear",
    } <= names
    one = Sensors((DriveLidars("a", ("top",)), DriveLidars("b", ("top",))))
    assert {str(c) for c in one.causes()} == {
        "extrinsics of all lidars", "extrinsics of a", "time of a", "extrinsics of b", "time of b",
    }  # fmt: skip


def test_a_lidar_that_odometry_was_computed_from_has_no_error() -> None:
    sensors = Sensors((DriveLidars("a", ("top",), "top"), DriveLidars("b", ("top",), "top")))
    assert sensors.causes() == []
    assert not sensors.prior().any()
    both = Sensors((DriveLidars("a", ("top", "low"), "top"), SUMMER))
    assert not both.prior(both.causes())[:SIZE, :SIZE].any()
    assert Cause("a/low", "time") in both.causes()
    assert Cause("a", "time") not in both.causes()


def _evidence_of(truth: Array, seed: int = 0, sigma: float = 1e-3) -> Reduced:
    """Direct measurements of the unknowns: of each the value, with noise."""
    rng = np.random.default_rng(seed)
    A = np.eye(SENSORS.unknowns) / sigma**2
    return Reduced(A, A @ (truth + sigma * rng.normal(size=SENSORS.unknowns)))


@pytest.mark.parametrize("seed", range(5))
def test_nothing_is_found_where_nothing_is_wrong(seed: int) -> None:
    assert find_causes(_evidence_of(np.zeros(SENSORS.unknowns), seed), SENSORS) == ()


@pytest.mark.parametrize(
    ("cause", "size"),
    [
        (Cause("winter", "time"), LATE_S),
        (Cause("winter/rear", "time"), LATE_S),
        (Cause(RIG, "extrinsics"), 0.02),
        (Cause("all drives/rear", "extrinsics"), 0.02),
    ],
)
def test_the_cause_is_named_and_measured(cause: Cause, size: float) -> None:
    spread = SENSORS.spread(cause)
    truth = spread @ np.full(spread.shape[1], size)
    found = calibrate(_evidence_of(truth), SENSORS)
    assert found.causes == (cause,)
    assert np.abs(found.errors - truth).max() < 5e-3
    assert (np.abs(found.errors - truth) <= 5 * found.sigmas.ravel() + 1e-4).all()


@pytest.mark.parametrize(("known_ms", "late_ms", "least"), [(2, 0, 0), (2, 5, 0), (2, 10, 8), (8, 10, 0)])
def test_a_late_clock_is_found_or_within_its_sigma(known_ms: int, late_ms: int, least: int) -> None:
    """How late one drive's lidars are relative to the other's is measured to so many milliseconds."""
    winter, summer = (SENSORS.spread(Cause(name, "time"))[:, 0] for name in ("winter", "summer"))
    relative, truth = (winter - summer) / 2, winter * late_ms / 1e3
    squared, found = [], 0
    for seed in range(12):
        calibration = calibrate(_evidence_of(truth, seed, sigma=known_ms / 1e3), SENSORS)
        off = relative @ (calibration.errors - truth)
        squared.append(off**2 / (relative @ calibration.covariance @ relative))
        found += Cause("winter", "time") in calibration.causes
    assert np.mean(squared) < 12.0  # of six axes that are judged together
    assert found >= least
    assert late_ms or not found


def test_lidars_that_agree_make_an_error_that_they_share_less_likely() -> None:
    common = SENSORS.spread(Cause(RIG, "extrinsics"))
    A = (np.eye(SENSORS.unknowns) - common @ np.linalg.pinv(common)) / 3e-4**2  # what they share is not measured
    prior = SENSORS.prior()
    given = np.sqrt(common.T @ prior @ common / len(SENSORS) ** 2).diagonal()

    def unseen(truth: Array) -> Array:
        """(6,) standard deviations of the mean of all lidars, in units of those that are assumed."""
        found = calibrate(Reduced(A, A @ truth), SENSORS)
        return np.asarray(np.sqrt(np.diag(common.T @ found.covariance @ common)) / len(SENSORS) / given)

    assert (unseen(np.zeros(SENSORS.unknowns)) < 0.4).all()
    typical = np.random.default_rng(3).multivariate_normal(np.zeros(SENSORS.unknowns), prior, size=8)
    assert np.mean([unseen(truth) for truth in typical]) > 0.65


def test_errors_that_are_not_corrected_count_as_uncertainty() -> None:
    truth = np.zeros(SENSORS.unknowns)
    late = SIZE * SENSORS.number("winter", 1) + 6
    truth[late] = LATE_S
    found = calibrate(_evidence_of(truth), SENSORS)
    assert np.sqrt(found.uncorrected(0 * truth)[late, late]) == pytest.approx(LATE_S, rel=0.05)
    assert np.sqrt(found.uncorrected(truth)[late, late]) < 0.1 * LATE_S


def test_a_cause_is_judged_by_all_that_is_wrong_and_not_by_what_is_left_after_a_correction() -> None:
    truth = SENSORS.spread(Cause("winter", "time")) @ np.array([LATE_S])
    half = 0.5 * truth
    reduced = _evidence_of(truth - half).about(half)
    found = calibrate(reduced, SENSORS)
    assert found.causes == (Cause("winter", "time"),)
    assert np.abs(found.errors - truth).max() < 5e-3


def test_only_what_is_in_error_is_corrected() -> None:
    late = SENSORS.spread(Cause("winter", "time")).any(axis=1)
    truth = np.where(late, LATE_S, 0.0)
    tilted = SIZE * SENSORS.number("winter", 0) + 4
    # Less than what a lidar should be good to, but measured.
    truth[tilted] = 0.0005
    found = calibrate(_evidence_of(truth, sigma=1e-4), SENSORS)
    assert found.causes == (Cause("winter", "time"),)
    assert found.errors[tilted] == pytest.approx(0.0005, abs=2e-4)
    assert (found.in_error == late).all()
    assert (found.correction == np.where(late, found.errors, 0.0)).all()
    assert found.uncorrected(found.correction)[tilted, tilted] >= found.errors[tilted] ** 2
    assert not calibrate(_evidence_of(0 * truth), SENSORS).correction.any()


def test_what_is_not_observed_is_not_guessed() -> None:
    blind = Reduced(np.zeros((SENSORS.unknowns,) * 2), np.zeros(SENSORS.unknowns))
    found = calibrate(blind, SENSORS)
    assert found.causes == ()
    assert not found.errors.any()
    assert set(open_kinds(blind, SENSORS)["winter/rear"]) == {"time", "rotation", "position"}


def _drives(late_s: float) -> tuple[BothDrives, Array, Array, CalibrationEdges, Edges]:
    """Two drives along a winding road; every pair of blocks is measured, the query's by a lidar that is late.

    Returns the drives, true poses, poses to start from, what was measured, and the odometry.
    """
    rng = np.random.default_rng(4)
    steps = [make_transform(so3_exp([0, 0, 0.15 * np.sin(k / 4)]), [2.0, 0, 0]) for k in range(COUNT - 1)]
    T = [np.eye(4)]
    for step in steps:
        T.append(T[-1] @ step)
    poses = np.concatenate([np.array(T), np.array(T)])
    way = np.tile(2.0 * np.arange(COUNT), 2)
    drives = BothDrives(COUNT, poses, way, np.repeat([0, 1], COUNT))
    speed = 6 + 3 * np.sin(np.arange(COUNT) / 5)
    twists = np.zeros((2 * COUNT, 6))
    for k in range(COUNT):
        step = se3_log(steps[min(k, COUNT - 2)])
        twists[[k, COUNT + k]] = step / 2.0 * speed[k]
    first, second = np.arange(COUNT), COUNT + np.arange(COUNT)
    measured = invert(poses[first]) @ poses[second] @ se3_exp(-late_s * twists[second])
    measured = measured @ se3_exp(1e-3 * rng.normal(size=(COUNT, 6)) * [1, 1, 1, 0.1, 0.1, 0.1])
    information = np.tile(np.diag([1e6] * 3 + [1e8] * 3), (COUNT, 1, 1))
    by = np.zeros((COUNT, 6, SENSORS.unknowns))
    at = SIZE * SENSORS.number("winter", 0)
    for e in range(COUNT):
        by[e, :, at : at + SIZE] = moves(twists[second[e]])
    edges = Edges(first, second, measured, information, np.full(COUNT, Kind.REGISTRATION))
    start = poses @ se3_exp(0.02 * rng.normal(size=(2 * COUNT, 6)) * [1, 1, 1, 0.1, 0.1, 0.1])
    return drives, poses, start, CalibrationEdges(edges, by), drives.odometry(OdometryNoise())


@pytest.mark.parametrize("late_s", [0.0, LATE_S])
def test_the_adjustment_finds_a_late_lidar_where_speed_and_turn_change(late_s: float) -> None:
    drives, truth, start, measured, odometry = _drives(late_s)
    T, value = start, np.zeros(SENSORS.unknowns)
    prior = SENSORS.prior([Cause("winter/front", "time")])
    for _ in range(3):
        adjustment = Adjustment(T, odometry, scales_of(drives, odometry), measured)
        reduced = Reduced(adjustment.reduced.A, adjustment.reduced.h + adjustment.reduced.A @ value)
        estimate, covariance = reduced.estimate(prior)
        T = T @ se3_exp(adjustment.step(estimate - value))
        residual = measured.edges.residuals(T) + measured.by_calibration @ (estimate - value)
        measured = replace(measured, edges=replace(measured.edges, T_first_second=measured.edges.T_first_second
                           @ se3_exp(-(measured.by_calibration @ (estimate - value)))))  # fmt: skip
        value = estimate
    at = SIZE * SENSORS.number("winter", 0) + 6
    sigma = float(np.sqrt(covariance[at, at]))
    assert sigma < 2e-3
    assert abs(value[at] - late_s) < max(5 * sigma, 1e-3)
    assert np.abs(residual).max() < 0.02
    relative = invert(T[:COUNT]) @ T[COUNT:]
    assert np.abs(se3_log(invert(invert(truth[:COUNT]) @ truth[COUNT:]) @ relative)).max() < 0.05


def test_poses_move_with_the_calibration_as_the_adjustment_says() -> None:
    drives, _, start, measured, odometry = _drives(0.0)
    adjustment = Adjustment(start, odometry, scales_of(drives, odometry), measured)
    change = np.zeros(SENSORS.unknowns)
    change[SIZE * SENSORS.number("winter", 0) + 6] = 0.01
    by = np.einsum("nik,k->ni", adjustment.by_calibration, change)
    assert np.allclose(adjustment.step(change) - adjustment.step(0 * change), by)
    apart = by[COUNT:] - np.einsum("nij,nj->ni", adjoint(invert(start[COUNT:]) @ start[:COUNT]), by[:COUNT])
    assert 0.02 < apart[:, 0].mean() < 0.1  # some 6 m/s for 10 ms, along the street


class _Stream:
    name, pattern, max_range_m, sigma_m = "front", "spinning", 60.0, 0.02
    T_rig_lidar = make_transform(np.eye(3), [1.0, 0.0, 1.5])
    times_ns = np.arange(5, dtype=np.int64) * 100_000_000

    def read(self, index: int) -> Scan:
        return Scan(np.ones((2, 3)), np.full(2, self.times_ns[index]))


def _recording(name: str) -> FieldRecording:
    times = np.arange(11, dtype=np.int64) * 100_000_000
    T = np.array([se3_exp(np.array([0.8 * k, 0, 0, 0, 0, 0.02 * k])) for k in range(11)])
    lidars = (_Stream(), replace_name(_Stream(), "rear"))
    return FieldRecording(name, Path(name), Condition(), Trajectory(times, T), lidars)  # type: ignore[arg-type]


def replace_name(stream: _Stream, name: str) -> _Stream:
    stream.name = name
    return stream


def test_a_corrected_recording_has_earlier_times_and_other_extrinsics() -> None:
    errors = np.zeros(SENSORS.unknowns)
    at = SIZE * SENSORS.number("winter", 1)
    errors[at : at + SIZE] = [0.1, 0, 0, 0, 0, np.radians(1), LATE_S]
    given = _recording("winter")
    right = corrected(given, SENSORS, errors)
    assert right.lidars[0] is given.lidars[0]
    rear = right.lidars[1]
    assert isinstance(rear, CorrectedLidar)
    assert (rear.name, rear.pattern) == ("rear", "spinning")
    assert np.array_equal(rear.times_ns, _Stream.times_ns - 50_000_000)
    assert np.array_equal(rear.read(2).times_ns, _Stream().read(2).times_ns - 50_000_000)
    assert np.allclose(rear.T_rig_lidar, se3_exp(errors[at : at + 6]) @ _Stream.T_rig_lidar)


def test_the_twist_at_a_node_is_that_of_the_odometry() -> None:
    recording = _recording("winter")
    nodes = Nodes(np.array([500_000_000]), recording.odometry.at(np.array([500_000_000])), np.zeros(1))
    assert np.allclose(node_twists(recording.odometry, nodes)[0], [8.0, 0, 0, 0, 0, 0.2], atol=1e-3)


def test_evidence_and_findings_are_kept_on_disk(tmp_path: Path) -> None:
    truth = np.zeros(SENSORS.unknowns)
    truth[SIZE * SENSORS.number("winter", 1) + 6] = LATE_S
    reduced = _evidence_of(truth)
    by = np.random.default_rng(1).normal(size=(7, 6, SENSORS.unknowns))
    path = tmp_path / "a.npz"
    write_evidence(path, CalibrationEvidence(reduced, by, 99))
    read = read_evidence(path, SENSORS.unknowns, 7)
    assert np.array_equal(read.reduced.A, reduced.A)
    assert np.array_equal(read.by_calibration, by)
    assert read.count == 99
    before = path.read_bytes()
    write_evidence(path, read)
    assert path.read_bytes() == before
    with refused(DatasetError, "a.npz"):
        read_evidence(path, SENSORS.unknowns, 8)
    path.write_bytes(before[:-10])
    with refused(DatasetError, "a.npz"):
        read_evidence(path, SENSORS.unknowns, 7)
    found = calibrate(reduced, SENSORS)
    places = RoundFolders({"summer": tmp_path / "blocks/summer"}, {"winter": tmp_path / "registrations"})
    file = write_calibration(tmp_path, found, truth, open_kinds(reduced, SENSORS), 1, places)
    assert read_calibration(tmp_path) == file
    assert read_calibration(tmp_path / "none").causes == ()
    told = list(report_lines(file, found, 99))
    assert any("winter/rear was 50.0 ms late" in line for line in told)
    (tmp_path / "calibration.yaml").write_text("causes: 3\n")
    with refused(DatasetError, "calibration.yaml"):
        read_calibration(tmp_path)
