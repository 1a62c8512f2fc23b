"""The pose graph of two drives: covariances, wrong registrations named, pairs refused for true reasons.

``benchmarks/lidar/stated_uncertainty.py`` shows over many drives that covariances are those of the errors.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from refusals import refused
from simulated_blocks import Planes, submap_registrations
from simulated_graph import (
    CAMERA,
    INDEPENDENT,
    NO_EVIDENCE,
    WHITE,
    Drive,
    drive,
    registrations,
    slid,
    translation_errors,
    true_error,
    two_drives,
    with_gross_errors,
)

from relocbench.arrays import Mask
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.pairs.outcome import Outcomes
from relocbench.datasets.groundtruth.pose_graph.consensus import RunOptions
from relocbench.datasets.groundtruth.pose_graph.graph import Solution, optimise
from relocbench.datasets.groundtruth.pose_graph.local_edges import LocalOptions, neighbouring_blocks, refine_locally
from relocbench.datasets.groundtruth.pose_graph.odometry_noise import OdometryNoise, estimate
from relocbench.datasets.groundtruth.pose_graph.odometry_scale import scales_of
from relocbench.datasets.groundtruth.pose_graph.selection import GraphOptions
from relocbench.datasets.groundtruth.registration.submap_pair import unregistered
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.datasets.synthetic.drives.odometry import OdometryErrors
from relocbench.errors import ConfigError
from relocbench.geometry import adjoint, invert, se3_exp, se3_log


def used(solution: Solution) -> Mask:
    return np.array([not v for v in solution.verdicts])


def lone_nodes(count: int = 2) -> Nodes:
    """Nodes of which odometry says nothing."""
    return Nodes(
        np.arange(count), np.tile(np.eye(4), (count, 1, 1)), np.arange(count, dtype=float) * 2.0, np.arange(count)
    )


def test_a_single_registration_comes_out_with_its_own_covariance_in_our_order() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 6)) * np.array([0.02, 0.01, 0.03, 1e-3, 2e-3, 5e-4])[:, None]
    covariance = A @ A.T
    T = se3_exp([1.0, -2.0, 0.3, 0.2, -0.1, 1.0])
    registration = Registration(0, 0, T, np.linalg.inv(covariance), NO_EVIDENCE)
    solution = optimise(lone_nodes(1), lone_nodes(1), [registration])
    found, P = solution.pose(0, 0), solution.covariance(0, 0)
    np.testing.assert_allclose(found, T, atol=1e-9)
    np.testing.assert_allclose(P, covariance, rtol=1e-3, atol=1e-12)


def test_covariances_are_those_of_the_dense_normal_equations() -> None:
    reference, query, found = two_drives(30.0, 1)
    solution = optimise(reference.nodes, query.nodes, found, options=INDEPENDENT)
    edges, T = solution.edges, solution.T_world_node
    scales = scales_of(solution.drives, edges)
    # Poses, then the odometry's scales: 30 m of road are three pieces of either drive.
    assert scales.number.max() == 5
    assert scales.neighbours.tolist() == [[0, 1], [1, 2], [3, 4], [4, 5]]
    poses = 6 * len(T)
    H = np.zeros((poses + 6, poses + 6))
    for e in range(len(edges)):
        first, second, scale = edges.first[e], edges.second[e], scales.number[e]
        J = np.zeros((6, len(H)))
        J[:, 6 * first : 6 * first + 6] = -adjoint(invert(T[second]) @ T[first])
        J[:, 6 * second : 6 * second + 6] = np.eye(6)
        if scale >= 0:
            J[:3, poses + scale] = -invert(edges.T_first_second[e])[:3, :3] @ edges.T_first_second[e, :3, 3]
        H += J.T @ edges.information[e] @ J
    for scale in scales.begins:
        H[poses + scale, poses + scale] += scales.sigma**-2
    for m, n in scales.neighbours + poses:
        H[np.ix_([m, n], [m, n])] += np.array([[1, -1], [-1, 1]]) * scales.neighbour_sigma**-2
    joint = np.zeros_like(H)
    joint[6:, 6:] = np.linalg.inv(H[6:, 6:])
    ref, query_node = 7, 9
    a, b = 6 * ref, 6 * (len(reference.nodes) + query_node)
    B = np.hstack([-adjoint(invert(T[b // 6]) @ T[ref]), np.eye(6)])
    rows = np.r_[a : a + 6, b : b + 6]
    expected = B @ joint[np.ix_(rows, rows)] @ B.T
    covariance = solution.covariance(ref, query_node)
    sigma = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(covariance / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=0.02)


def test_where_nothing_holds_the_way_the_error_of_the_scale_adds_up() -> None:
    reference, query, found = two_drives(120.0, 12)
    known = [r for r in found if query.nodes.travelled_m[r.query] < 60]
    options = replace(INDEPENDENT, estimate_noise=False)
    noise = OdometryNoise(along_m=0.002)
    solution = optimise(reference.nodes, query.nodes, known, noise, options)
    last = max(r.query for r in known)
    arc_length = query.nodes.travelled_m - query.nodes.travelled_m[last]
    along = {
        d: float(np.sqrt(solution.covariance(n, n)[0, 0]))
        for d in (20, 40)
        for n in [int(np.argmin(np.abs(arc_length - d)))]
    }
    # As a random walk it would grow by sqrt(2); an unknown scale doubles it, one that wanders does more.
    assert along[20] > 3 * np.sqrt(2 * 20) * 0.002
    assert 1.8 < along[40] / along[20] < 2.8


@pytest.mark.thorough
def test_gross_errors_are_left_out_and_named() -> None:
    reference, query, found = two_drives(160.0, 3)
    rng = np.random.default_rng(30)
    found, wrong = with_gross_errors(found, rng)
    solution = optimise(reference.nodes, query.nodes, found, options=INDEPENDENT)
    assert wrong.sum() > 8
    assert not used(solution)[wrong].any()
    assert used(solution)[~wrong].mean() > 0.98
    errors = translation_errors(solution, reference, query)
    assert np.median(errors) < 0.012
    assert errors.max() < 0.06


def test_a_node_that_was_found_nowhere_changes_nothing() -> None:
    reference, query, found = two_drives(60.0, 4)
    last = found[-1]
    nowhere = unregistered((-1, last.query), np.full((4, 4), np.nan), "not found: nothing looks alike")
    without = optimise(reference.nodes, query.nodes, found[:-1])
    solution = optimise(reference.nodes, query.nodes, [*found[:-1], nowhere])
    assert solution.verdicts == (*without.verdicts, "not found: nothing looks alike")
    np.testing.assert_array_equal(solution.T_world_node, without.T_world_node)


def test_the_same_registrations_give_the_same_bytes() -> None:
    reference, query, found = two_drives(60.0, 4)
    one, other = (optimise(reference.nodes, query.nodes, found) for _ in range(2))
    assert one.T_world_node.tobytes() == other.T_world_node.tobytes()
    assert one.covariance(5, 6).tobytes() == other.covariance(5, 6).tobytes()


@pytest.mark.thorough
def test_information_that_promises_too_much_is_taken_down() -> None:
    rng = np.random.default_rng(5)
    reference, query = drive(80.0, rng, WHITE), drive(80.0, rng, WHITE, 0.7)
    found = registrations(reference, query, rng, stated=1 / 3)
    solution = optimise(reference.nodes, query.nodes, found, options=INDEPENDENT)
    assert 6.0 < solution.information_factor < 12.0


@pytest.mark.thorough
@pytest.mark.parametrize("metres", [5.0, 0.6])
def test_a_run_that_agrees_with_itself_but_slid_along_the_street_is_left_out(metres: float) -> None:
    reference, query, found = two_drives(400.0, 7)
    wrong = np.array([80 <= r.query < 115 for r in found])
    found = [slid(r, se3_exp([metres, 0, 0, 0, 0, 0])) if w else r for r, w in zip(found, wrong, strict=True)]
    solution = optimise(reference.nodes, query.nodes, found)
    assert not used(solution)[wrong].any()
    assert used(solution)[~wrong].mean() > 0.95
    assert "contradicts a longer run" in solution.verdicts[int(np.flatnonzero(wrong)[20])]
    middle = len(reference.nodes) + 97
    assert solution.arc_length_to_trusted[middle].min() > 30.0
    assert solution.arc_length_to_trusted[len(reference.nodes) + 40].max() < 10.0


def test_of_two_runs_of_like_length_that_contradict_each_other_neither_is_believed() -> None:
    reference, query, found = two_drives(200.0, 8)
    found = [slid(r, se3_exp([8.0, 0, 0, 0, 0, 0])) if r.query >= 40 else r for r in found]
    solution = optimise(reference.nodes, query.nodes, found)
    assert not used(solution).any()
    assert "none is much longer" in solution.verdicts[0]
    assert not solution.connected(3, 3)


def test_a_jump_that_all_registrations_share_shows_as_stress_in_the_odometry() -> None:
    reference, query, found = two_drives(240.0, 9, WHITE)
    found = [slid(r, se3_exp([0.5, 0, 0, 0, 0, 0])) if r.query >= 60 else r for r in found]
    nothing_is_thrown_out = replace(
        GraphOptions(), runs=RunOptions(closure_m=5.0), significance=1e-300, estimate_noise=False
    )
    solution = optimise(reference.nodes, query.nodes, found, options=nothing_is_thrown_out)
    assert used(solution).all()
    stressed = {first % len(reference.nodes) for first, _ in solution.contradicted_odometry()}
    assert 59 in stressed
    assert all(50 <= node <= 70 for node in stressed)


@pytest.mark.thorough
def test_stretches_between_gaps_are_tied_by_registrations_alone() -> None:
    reference, query, found = two_drives(160.0, 10)
    piece = (np.arange(len(query.nodes)) >= 40).astype(np.int64)
    T_odom_node = query.nodes.T_odom_node.copy()
    T_odom_node[40:] = se3_exp([30.0, 5.0, 1.0, 0.1, 0.0, 2.0]) @ T_odom_node[40:]
    broken = replace(query.nodes, T_odom_node=T_odom_node, segment=piece)
    solution = optimise(reference.nodes, broken, found)
    errors = [np.linalg.norm(true_error(reference, query, j, j, solution.pose(j, j))[:3]) for j in range(80)]
    assert max(errors) < 0.06
    alone = optimise(reference.nodes, broken, [r for r in found if r.query < 40])
    assert alone.connected(0, 39)
    assert not alone.connected(0, 40)
    with pytest.raises(ValueError, match="40"):
        alone.covariance(0, 40)


def road_driven_twice() -> tuple[Nodes, Drive, Drive, list[Registration], list[Registration]]:
    """The reference's nodes and truth, the query, and its registrations against the first and the second time."""
    rng = np.random.default_rng(11)
    once, query = drive(200.0, rng, OdometryErrors()), drive(200.0, rng, OdometryErrors(), 0.7)
    again = drive(200.0, rng, OdometryErrors(), -0.5)
    count = len(once.nodes)
    # The second pass follows in the same odometry, half a metre and a few degrees wrong by then.
    T_join = se3_exp([0.4, -0.3, 0.1, 0.0, 0.0, 0.05])
    back = once.nodes.T_odom_node[-1] @ invert(once.T_world_node[-1]) @ again.T_world_node[0] @ T_join
    nodes = Nodes(
        np.concatenate([once.nodes.times_ns, once.nodes.times_ns + 10**12]),
        np.concatenate([once.nodes.T_odom_node, back @ invert(again.nodes.T_odom_node[0]) @ again.nodes.T_odom_node]),
        np.concatenate([once.nodes.travelled_m, once.nodes.travelled_m + 400.0]),
        np.repeat([0, 1], count),
    )
    both = Drive(nodes, np.concatenate([once.T_world_node, again.T_world_node]))
    second = [replace(r, ref=r.ref + count) for r in registrations(again, query, rng)]
    return nodes, both, query, registrations(once, query, rng), second


@pytest.mark.thorough
def test_a_road_that_the_reference_drove_twice_is_closed_through_the_query() -> None:
    nodes, both, query, first, second = road_driven_twice()
    count = len(nodes) // 2
    solution = optimise(nodes, query.nodes, first + second)
    assert used(solution).mean() > 0.98
    for j in range(0, len(query.nodes), 7):
        for i in (j, j + count):
            assert np.linalg.norm(true_error(both, query, i, j, solution.pose(i, j))[:3]) < 0.05


@pytest.mark.thorough
def test_blocks_meet_where_registrations_say_so_and_not_where_drift_puts_them() -> None:
    nodes, _, query, first, second = road_driven_twice()
    count = len(nodes) // 2
    tied = 40.0
    """metres up to which the second time is registered; from there on only its drifted odometry tells where it was"""
    known = [r for r in second if query.nodes.travelled_m[r.query] < tied]
    solution = optimise(nodes, query.nodes, first + known)
    options = LocalOptions()
    pairs = neighbouring_blocks(solution, options)
    furthest = {again: max(q for r, q in pairs if (r >= count) == again) for again in (False, True)}
    assert furthest[False] == len(query.nodes) - 1
    arc_length = float(query.nodes.travelled_m[furthest[True]])
    assert tied < arc_length <= tied + options.trusted_within_m
    apart = np.linalg.norm(solution.T_world_ref[count:, :3, 3] - solution.T_world_query[:, :3, 3], axis=1)
    assert (apart[furthest[True] + 1 :] < options.reach_m).any()  # near in space they would be
    assert len(neighbouring_blocks(optimise(nodes, query.nodes, first + second), options)) > len(pairs)


def test_noise_grows_with_the_way_however_it_is_cut_and_is_refused_where_it_is_none() -> None:
    noise = OdometryNoise()
    np.testing.assert_allclose(noise.variance(np.array(6.0)), 3 * noise.variance(np.array(2.0)))
    assert np.all(noise.variance(np.array(0.0)) > 0)
    with refused(ConfigError):
        OdometryNoise(along_m=0.0)
    few = estimate(noise, np.full(5, 2.0), np.zeros((5, 6)), np.zeros((5, 6)))
    assert few == noise  # five edges say nothing of six variances


@pytest.mark.thorough
def test_local_edges_beat_rigid_submaps_that_drift() -> None:
    rng, errors = np.random.default_rng(0), OdometryErrors()
    reference, query = drive(120.0, rng, errors), drive(120.0, rng, errors, 0.7)
    planes = Planes(reference, query, rng)
    start = optimise(reference.nodes, query.nodes, submap_registrations(planes, half=15, every=3))
    fine = refine_locally(start, planes, LocalOptions(correlation=1.0, reach_m=5.0))
    rigid, local = (np.median(translation_errors(s, reference, query)) for s in (start, fine))
    assert local < 0.5 * rigid


def trajectory(one: Drive) -> Trajectory:
    return Trajectory(one.nodes.times_ns, one.nodes.T_odom_node)


def test_pairs_come_out_camera_to_camera_with_sigmas_along_across_and_above_the_street() -> None:
    reference, query, found = two_drives(80.0, 13)
    solution = optimise(reference.nodes, query.nodes, found, options=INDEPENDENT)
    outcomes = Outcomes(solution, (reference.nodes, trajectory(reference)), (query.nodes, trajectory(query)), found)
    for j in range(5, 35, 6):
        ref_ns, query_ns = int(reference.nodes.times_ns[j - 2]), int(query.nodes.times_ns[j])
        outcome = outcomes.of(ref_ns, query_ns, CAMERA, CAMERA)
        assert outcome.accepted, outcome.reason
        assert outcome.T_query_ref is not None
        assert outcome.covariance is not None
        true = invert(reference.T_world_node[j - 2] @ CAMERA) @ query.T_world_node[j] @ CAMERA
        error = se3_log(outcome.T_query_ref @ true)
        assert error @ np.linalg.solve(outcome.covariance, error) / 6 < 5
        sigmas = np.array([outcome.sigma_along_m, outcome.sigma_across_m, outcome.sigma_height_m], dtype=np.float64)
        assert sigmas[0] > sigmas[2]
        assert outcome.sigma_translation_m == pytest.approx(float(np.sqrt(np.mean(sigmas**2))))
    pair = outcomes.of(int(reference.nodes.times_ns[8]), int(query.nodes.times_ns[10]), CAMERA, CAMERA).pair()
    assert pair.sigma_along_m is not None
    assert pair.T_query_ref is not None


def test_at_the_ends_of_the_common_road_the_place_along_it_is_less_certain() -> None:
    reference, query, found = two_drives(80.0, 13)
    solution = optimise(reference.nodes, query.nodes, found, options=INDEPENDENT)
    outcomes = Outcomes(solution, (reference.nodes, trajectory(reference)), (query.nodes, trajectory(query)), found)
    last = len(query.nodes) - 1
    for node, factor in ((0, 1.5), (20, 1.0), (last, 1.5)):
        times = int(reference.nodes.times_ns[node]), int(query.nodes.times_ns[node])
        outcome, T = outcomes.of(*times, CAMERA, CAMERA), adjoint(invert(CAMERA))
        C = CAMERA[:3, :3] @ (T @ solution.covariance(node, node) @ T.T)[:3, :3] @ CAMERA[:3, :3].T
        assert outcome.sigma_along_m == pytest.approx(factor * np.sqrt(C[0, 0]), rel=0.02)
        assert outcome.sigma_across_m == pytest.approx(np.sqrt(C[1, 1]), rel=0.02)


def test_between_nodes_a_pose_follows_the_odometry_and_is_less_certain() -> None:
    reference, query, found = two_drives(100.0, 14)
    fine = query.nodes
    coarse = Nodes(fine.times_ns[::4], fine.T_odom_node[::4], fine.travelled_m[::4])
    fewer = [replace(r, query=r.query // 4) for r in found if r.query % 4 == 0]
    solution = optimise(reference.nodes, coarse, fewer, options=INDEPENDENT)
    outcomes = Outcomes(solution, (reference.nodes, trajectory(reference)), (coarse, trajectory(query)), fewer)
    at, between = (
        outcomes.of(int(reference.nodes.times_ns[20]), int(query.nodes.times_ns[n]), CAMERA, CAMERA) for n in (20, 22)
    )
    assert at.sigma_along_m is not None
    assert between.sigma_along_m is not None
    assert between.T_query_ref is not None
    assert between.sigma_along_m > at.sigma_along_m
    true = invert(query.T_world_node[22] @ CAMERA) @ reference.T_world_node[20] @ CAMERA
    np.testing.assert_allclose(between.T_query_ref, true, atol=0.05)


@pytest.mark.thorough
def test_refused_pairs_say_why() -> None:
    reference, query, found = two_drives(300.0, 15)
    found = [
        replace(r, reason="free space: 12 % of the walls were seen through") if 60 <= r.query < 100 else r
        for r in found
    ]
    solution = optimise(reference.nodes, query.nodes, found)
    outcomes = Outcomes(solution, (reference.nodes, trajectory(reference)), (query.nodes, trajectory(query)), found)

    def reason(ref: int, query_node: int) -> str:
        outcome = outcomes.of(int(reference.nodes.times_ns[ref]), int(query.nodes.times_ns[query_node]), CAMERA, CAMERA)
        assert outcome.pair().accepted == (outcome.reason == "")
        return outcome.reason

    assert reason(30, 30) == ""
    assert reason(10, 30) in {f"no keyframe within 10 m: nearest {n} m" for n in (38, 39, 40)}
    assert reason(80, 80).startswith("not registered within 15 m, nearest")
    assert reason(80, 80).endswith("free space: 12 % of the walls were seen through")
    assert reason(64, 64).startswith("sigma along the street 0.")
    after = int(query.nodes.times_ns[-1]) + 1
    assert (
        outcomes.of(int(reference.nodes.times_ns[3]), after, CAMERA, CAMERA).reason
        == "no odometry at the time of the query"
    )
    nothing = optimise(reference.nodes, query.nodes, [])
    outcomes = Outcomes(nothing, (reference.nodes, trajectory(reference)), (query.nodes, trajectory(query)))
    assert reason(30, 30) == "not registered: no registration was found there"


def test_the_solver_is_loaded_when_it_is_needed() -> None:
    modules = "relocbench.datasets.groundtruth.pairs.outcome, relocbench.datasets.groundtruth.pose_graph.local_edges"
    subprocess.run([sys.executable, "-c", f"import sys, {modules}\nassert 'gtsam' not in sys.modules"], check=True)
