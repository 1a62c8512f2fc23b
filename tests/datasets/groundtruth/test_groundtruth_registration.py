"""Registration of submaps: planes, refinement, guesses, free space, verdicts and tracking, on streets of planes."""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import street_clouds as clouds
from refusals import refused
from scipy.stats import theilslopes

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.blocks import Nodes, Surface
from relocbench.datasets.groundtruth.icp.backends import icp_by_backend
from relocbench.datasets.groundtruth.icp.icp import IcpOptions, Linearised, linearise, linearise_both, run_icp
from relocbench.datasets.groundtruth.registration import along_drive, lengths, place_recognition
from relocbench.datasets.groundtruth.registration.along_drive import DriveRegistrationOptions, register_along
from relocbench.datasets.groundtruth.registration.global_registration import (
    GlobalOptions,
    Prior,
    describe,
    distinct,
    guesses,
)
from relocbench.datasets.groundtruth.registration.hypotheses import (
    HypothesisOptions,
    SearchResult,
    choose_hypothesis,
    promising_guesses,
)
from relocbench.datasets.groundtruth.registration.lengths import may_hold_by_chance, ratio_of_lengths
from relocbench.datasets.groundtruth.registration.place_recognition import MapPrior
from relocbench.datasets.groundtruth.registration.submap_pair import Guess, PreparedDrive, unregistered
from relocbench.datasets.groundtruth.submaps.free_space import FreeSpace
from relocbench.datasets.groundtruth.submaps.planes import Sample, balanced, direction_bins, grid_planes
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.groundtruth.verification.alternatives import ShiftOptions, alternatives, shifted_poses
from relocbench.datasets.groundtruth.verification.evidence import Evidence, Registration
from relocbench.datasets.groundtruth.verification.verification import (
    Thresholds,
    explained_by_one,
    verdict,
    verification_evidence,
)
from relocbench.datasets.groundtruth.voxels.thinning import first_in_voxels
from relocbench.errors import ConfigError
from relocbench.geometry import apply, invert, make_transform, rotation_angle, se3_exp, se3_log

Pair = tuple[PreparedSubmap, PreparedSubmap]
RNG = np.random.default_rng(0)
T_STREET_REF, T_STREET_QUERY = clouds.pose(100.0, 0.3, 1.0), clouds.pose(101.2, -0.6, -2.0)
TRUTH = invert(T_STREET_REF) @ T_STREET_QUERY


def error(T: Array, truth: Array = TRUTH) -> tuple[float, float]:
    """Metres and degrees."""
    d = invert(truth) @ T
    return float(np.linalg.norm(d[:3, 3])), float(np.degrees(rotation_angle(d[:3, :3])))


@pytest.fixture(scope="module")
def pair() -> Pair:
    street = clouds.irregular(3)
    return PreparedSubmap(clouds.submap(street, 1, T_STREET_REF)), PreparedSubmap(
        clouds.submap(street, 2, T_STREET_QUERY)
    )


def test_nearest_planes_are_those_of_a_search_through_all() -> None:
    points, normals = RNG.uniform(-5, 5, size=(3000, 3)), RNG.normal(size=(3000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    planes = grid_planes(points, normals, np.ones(3000), np.zeros((3000, 3)), 0.8)
    asked, facing = RNG.uniform(-6, 6, size=(500, 3)), normals[:500]
    found = planes.nearest(asked, facing, 0.7, 0.5)
    apart = np.linalg.norm(asked[:, None] - planes.points[None], axis=2)
    apart[facing @ planes.normals.T < 0.5] = np.inf
    expected = np.where(apart.min(axis=1) < 0.7, apart.argmin(axis=1), -1)
    np.testing.assert_array_equal(found, expected)
    assert 50 < np.count_nonzero(found >= 0) < 500


def test_a_grid_is_not_searched_further_than_it_can() -> None:
    planes = grid_planes(np.zeros((1, 3)), np.array([[0, 0, 1.0]]), np.ones(1), np.zeros((1, 3)), 0.5)
    with pytest.raises(ValueError, match=r"0\.5"):
        planes.nearest(np.zeros((1, 3)), np.zeros((1, 3)), 0.6)


def test_thinning_leaves_one_point_a_voxel() -> None:
    points = RNG.uniform(-2, 2, size=(2000, 3))
    kept = points[first_in_voxels(points, 0.5)]
    cells = np.floor(kept / 0.5)
    assert len(np.unique(cells, axis=0)) == len(kept) == len(np.unique(np.floor(points / 0.5), axis=0))


def test_sampling_gives_rare_directions_their_share() -> None:
    normals = np.repeat([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], [9900, 100], axis=0)
    rows = balanced(direction_bins(normals), 400, np.ones(10000))
    assert np.count_nonzero(rows >= 9900) == 100
    assert np.count_nonzero(rows < 9900) == 300
    assert len(np.unique(rows)) == len(rows)


@pytest.mark.parametrize("planes_rescaled", [False, True])
def test_linearisation_is_the_derivative(planes_rescaled: bool) -> None:
    centres = RNG.uniform(-20, 20, size=(40, 3))
    normals = RNG.normal(size=(40, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lever_arms = RNG.uniform(-5, 5, size=(40, 3))
    planes = grid_planes(centres, normals, np.ones(40), lever_arms, 1.0)
    T = se3_exp([0.3, -0.2, 0.1, 0.1, 0.2, -0.3])
    points = apply(invert(T), centres + 0.02 * RNG.normal(size=(40, 3)))
    facing = normals @ T[:3, :3]

    def at(x: Array) -> Linearised:
        rescaled, moved = (planes.rescaled(x[6]), points) if planes_rescaled else (planes, points + x[6] * lever_arms)
        sample = Sample(moved, facing, np.ones(40), lever_arms)
        return linearise(rescaled, sample, T @ se3_exp(x[:6]), 0.9, 1e6, IcpOptions(drift_per_m=0.0), planes_rescaled)

    here, small = at(np.zeros(7)), 1e-5
    assert here.count == 40
    costs = [
        [0.5 * float(np.sum(at(sign * small * np.eye(7)[k]).residuals ** 2)) for sign in (1, -1)] for k in range(7)
    ]
    np.testing.assert_allclose(here.g, [(a - b) / (2 * small) for a, b in costs], rtol=1e-4, atol=1e-7)
    slope = np.column_stack([(at(small * e).g - at(-small * e).g) / (2 * small) for e in np.eye(7)])
    np.testing.assert_allclose(slope, here.H, rtol=0.05, atol=0.02 * np.abs(here.H).max())


def test_both_ways_pull_in_the_same_direction(pair: Pair) -> None:
    options = IcpOptions()
    wrong = np.array([0.05, -0.04, 0.03, 0.002, -0.003, 0.004])
    ref, query = ((side.planes.level(1), side.planes.sample(1)) for side in pair)
    problem = linearise_both(ref, query, TRUTH @ se3_exp(wrong), 0.5, 0.5, options)
    step = -np.linalg.solve(problem.H[:6, :6], problem.g[:6])
    np.testing.assert_allclose(step, -wrong, atol=0.03)
    np.testing.assert_allclose(step[3:], -wrong[3:], atol=0.002)


def test_refinement_finds_the_pose_from_a_metre_away(pair: Pair) -> None:
    start = TRUTH @ se3_exp([0.8, -0.5, 0.2, 0.01, -0.01, np.radians(3.0)])
    found = run_icp(pair[0].planes, pair[1].planes, start, IcpOptions())
    metres, degrees = error(found.T_ref_query)
    assert metres < 0.006
    assert degrees < 0.03


def longer(submap: Submap, share: float) -> Submap:
    """As odometry would lay it that tells every way longer by a share."""
    return replace(
        submap,
        points=submap.points + np.float32(share) * submap.origins,
        origins=submap.origins * np.float32(1 + share),
    )


@pytest.mark.parametrize("share", [0.03, -0.02])
def test_refinement_finds_by_how_much_one_odometry_is_longer(pair: Pair, share: float) -> None:
    # Here places on the road see what stands beside them: origins lie along x only, as those of a car do.
    query = PreparedSubmap(longer(pair[1].submap, share))
    start = TRUTH @ se3_exp([0.3, -0.2, 0.05, 0.005, -0.005, 0.01])
    found = run_icp(pair[0].planes, query.planes, start, IcpOptions())
    assert found.scale_error == pytest.approx(1 / (1 + share) - 1, abs=5e-4)
    metres, degrees = error(found.T_ref_query)
    assert metres < 0.01
    assert degrees < 0.05
    rigid = run_icp(pair[0].planes, query.planes, start, IcpOptions(scale_error_sigma=0.0))
    assert rigid.scale_error == 0
    assert error(rigid.T_ref_query)[0] > 2 * metres


def test_what_stands_far_ahead_alone_is_worth_less_with_the_scale_error_unknown(pair: Pair) -> None:
    def far_ahead(submap: Submap) -> Submap:
        keep = submap.origins[:, 0] > 15
        names = ("points", "normals", "origins", "surface", "steady", "block")
        return replace(submap, **{name: getattr(submap, name)[keep] for name in names})

    ref, query = (PreparedSubmap(far_ahead(side.submap)) for side in pair)
    known, unknown = (
        run_icp(ref.planes, query.planes, TRUTH, IcpOptions(drift_per_m=0.0, scale_error_sigma=sigma)).information
        for sigma in (1e-6, 0.02)
    )
    sigma_known, sigma_unknown = (float(np.sqrt(np.linalg.inv(information)[0, 0])) for information in (known, unknown))
    # 15 m of street tell the scale error only roughly, and its error counts as often as the street is metres away.
    assert sigma_unknown > 5 * sigma_known


def test_refinement_gives_the_same_bytes(pair: Pair) -> None:
    start = TRUTH @ se3_exp([0.3, -0.2, 0.1, 0, 0, 0.02])
    a = run_icp(pair[0].planes, pair[1].planes, start)
    ref, query = (PreparedSubmap(side.submap).planes for side in pair)
    b = run_icp(ref, query, start)
    assert a.T_ref_query.tobytes() == b.T_ref_query.tobytes()
    assert a.information.tobytes() == b.information.tobytes()


def test_bare_walls_hold_nothing_along_the_street() -> None:
    street = clouds.irregular(3, deepest=0.0)
    ref, query = (PreparedSubmap(clouds.submap(street, k, T)) for k, T in enumerate((T_STREET_REF, T_STREET_QUERY)))
    start = TRUTH @ se3_exp([0.4, 0.2, 0.1, 0, 0, 0.01])
    found = run_icp(ref.planes, query.planes, start, IcpOptions(drift_per_m=0.0, turn_per_m=0.0))
    apart = se3_log(invert(TRUTH) @ found.T_ref_query)
    assert np.linalg.norm(apart[1:3]) < 0.02
    assert abs(apart[0]) > 0.2
    assert verdict(verification_evidence(ref, query, found.T_ref_query, found.information)).startswith(
        "weak along the street"
    )


def wall(y: float, origins_y: float, surface: Surface = Surface.STRUCTURE, low: float = 3.0) -> Submap:
    """A wall of 10 m by 3 m at a distance, measured from places along x."""
    x, z = (v.ravel() for v in np.meshgrid(np.arange(0, 10, 0.1), np.arange(low, low + 3, 0.1)))
    points = np.column_stack([x, np.full(len(x), y), z]).astype(np.float32)
    origins = np.column_stack([x, np.full(len(x), origins_y), np.full(len(x), 1.8)]).astype(np.float32)
    normals = np.tile(np.array([0, np.sign(origins_y - y), 0], np.float32), (len(x), 1))
    kind = np.full(len(x), surface, np.uint8)
    return Submap(points, normals, origins, kind, np.ones(len(x), np.float32), np.zeros(len(x), np.int32))


def test_a_wall_cannot_stand_where_beams_went_through() -> None:
    near, far = FreeSpace(wall(6.0, 0.0, low=2.5)), FreeSpace(wall(15.0, 0.0))
    nothing = np.zeros(len(near.patches), dtype=bool)
    through = near.votes_of(far.beams, np.eye(4))
    assert through.violations(nothing) > 0.9
    reached = near.votes_of(near.beams, np.eye(4))
    assert reached.violations(nothing) == 0.0
    assert np.mean(reached.reached > 0) > 0.9
    behind = far.votes_of(near.beams, np.eye(4))
    assert np.isnan(behind.violations(np.zeros(len(far.patches), dtype=bool)))


def test_what_both_have_measured_contradicts_nothing() -> None:
    near, far = FreeSpace(wall(6.0, 0.0)), FreeSpace(wall(15.0, 0.0))
    assert near.votes_of(far.beams, np.eye(4)).violations(np.ones(len(near.patches), dtype=bool)) == 0.0


def test_leaves_are_no_walls_and_low_things_count_less() -> None:
    assert len(FreeSpace(wall(6.0, 0.0, Surface.ROUGH)).patches) == 0
    assert set(FreeSpace(wall(6.0, 0.0, low=-1.5)).patches.weights) == {0.15}


def test_the_right_pose_is_trusted(pair: Pair) -> None:
    found = run_icp(pair[0].planes, pair[1].planes, TRUTH @ se3_exp([0.3, 0, 0, 0, 0, 0.01]))
    evidence = verification_evidence(*pair, found.T_ref_query, found.information)
    assert verdict(evidence) == ""
    assert min(evidence.overlap_ref, evidence.overlap_query) > 0.9
    assert max(evidence.violations_ref, evidence.violations_query) < 0.03


@pytest.mark.parametrize("shift", [5.0, -9.0, 20.0])
def test_a_shifted_pose_is_rejected_with_a_reason(pair: Pair, shift: float) -> None:
    T = make_transform(np.eye(3), [shift, 0, 0]) @ TRUTH
    reason = verdict(verification_evidence(*pair, T, 1e6 * np.eye(6)))
    assert reason.split()[0] in ("free", "overlap", "too", "details:")


def test_another_street_is_rejected(pair: Pair) -> None:
    other = PreparedSubmap(clouds.submap(clouds.irregular(77), 4, T_STREET_QUERY))
    found = run_icp(pair[0].planes, other.planes, TRUTH)
    assert verdict(verification_evidence(pair[0], other, found.T_ref_query, found.information))


GOOD = Evidence(0.95, 0.95, 0.01, 0.01, 0.01, 0.01, 0.05, (1.0, 0.0, 0.0), 0.1, 0.9, 0.9, 0.9, 0.9)


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({}, ()),
        ({"violations_query": 0.21}, ("free space", "21 %", "query's")),
        ({"overlap_ref": 0.08}, ("overlap", "8 %", "reference's")),
        ({"seen_query": 0.01}, ("1 %", "query's")),
        ({"weakest_sigma_m": 0.4}, ("along", "0.4 m")),
        ({"weakest_sigma_m": float("inf"), "weakest_direction": (float("nan"),) * 3}, ("inf m",)),
        ({"weakest_sigma_deg": 0.9}, ("rotation", "0.9 deg")),
        ({"residual_ref_m": 0.08}, ("residual", "0.080 m", "reference's")),
        ({"violations_ref": float("nan")}, ("free space", "reference's")),
        ({"detail_query": 0.2}, ("20 %", "query's")),
    ],
)
def test_a_verdict_names_what_decided(change: dict[str, Any], names: tuple[str, ...]) -> None:
    said = verdict(replace(GOOD, **change), Thresholds())
    assert bool(said) == bool(names)
    assert all(name in said for name in names)


def test_shifted_poses_hold_the_right_place_and_the_wrong_ones() -> None:
    street = clouds.periodic(6.0)
    ref, query = (
        PreparedSubmap(clouds.submap(street, k, T)).planes for k, T in enumerate((T_STREET_REF, T_STREET_QUERY))
    )
    off = make_transform(np.eye(3), [4.4, 0, 0]) @ TRUTH
    apart = [error(T)[0] for T in shifted_poses(ref, query, off, ShiftOptions(reach_m=14.0))]
    assert min(apart) < 0.5
    assert any(abs(a - 6.0) < 0.5 for a in apart)
    turned = [error(T)[1] for T in alternatives(ref, query, TRUTH, ShiftOptions(reach_m=14.0))]
    assert any(t > 175 for t in turned)


def _periodic_but(odd: tuple[float, ...]) -> clouds.Street:
    """A street of repeating fronts, some of which, at these places, stand further back."""
    street = clouds.periodic(6.0)
    depths = [np.where(np.isin(s, odd), 3.0, d) for s, d in zip(street.starts, street.depths, strict=True)]
    return replace(street, depths=(depths[0], depths[1]))


def test_only_what_one_of_two_poses_explains_decides_between_them() -> None:
    shifted = make_transform(np.eye(3), [6.0, 0, 0]) @ TRUTH
    for odd, decided in (((93.0, 114.0), True), ((), False)):
        street = _periodic_but(odd)
        ref, query = (PreparedSubmap(clouds.submap(street, k, T)) for k, T in enumerate((T_STREET_REF, T_STREET_QUERY)))
        right, wrong, seen = explained_by_one(ref, query, TRUTH, shifted)
        assert explained_by_one(ref, query, shifted, TRUTH) == pytest.approx((wrong, right, seen))
        assert (right > 3 * wrong and right > 0.03 * seen) == decided
        assert decided or right + wrong < 0.005 * seen


@pytest.mark.thorough
def test_different_parts_of_a_street_that_repeats_itself_are_ambiguous() -> None:
    o = DriveRegistrationOptions()

    def chosen(odd: tuple[float, ...], query_at: float, guess_m: float, confirmed: bool = True) -> SearchResult:
        street = _periodic_but(odd)
        drives = clouds.Drive(street, 1, 60.0, 110.0), clouds.Drive(street, 2, query_at, query_at + 50.0)
        ref, query = (PreparedDrive(drive, drive.nodes) for drive in drives)
        T = invert(drives[0].T_street_node[4]) @ clouds.pose(guess_m) @ invert(clouds.pose(query_at + 8.0))
        guess = (4, 4, T @ drives[1].T_street_node[4])
        said = {"possible": lambda guess: True, "confirmed": lambda guess: confirmed}
        return choose_hypothesis(ref, query, [guess], o.hypotheses, o.register, o.shift, **said)

    elsewhere = chosen((), 132.0, 68.0)
    assert elsewhere.best is None
    assert elsewhere.ambiguous
    assert chosen((75.0, 96.0, 111.0), 60.0, 68.0).best is not None
    # What decides between neighbouring houses may repeat itself too, in a longer period.
    longer = chosen((75.0, 105.0, 135.0, 165.0), 120.0, 68.0, confirmed=False)
    assert longer.best is None
    assert "the street repeats itself every" in longer.reason


@pytest.mark.thorough
def test_global_registration_repeats_and_finds_the_place(pair: Pair) -> None:
    options = GlobalOptions(iterations=10_000, seeds=(0,))
    ref, query = (describe(side.submap, options) for side in pair)
    found, again = (guesses(ref, query, None, options) for _ in range(2))
    assert [T.tobytes() for T in found] == [T.tobytes() for T in again]
    assert min(error(T)[0] for T in found) < 1.0
    refined = [run_icp(pair[0].planes, pair[1].planes, T) for T in found]
    assert min(error(r.T_ref_query)[0] for r in refined) < 0.01


def test_a_prior_limits_position_and_turn() -> None:
    prior = Prior(np.eye(4), 2.0, 5.0)
    assert prior.allows(se3_exp([5.9, 0, 0, 0, 0, np.radians(14.0)]))
    assert not prior.allows(se3_exp([6.1, 0, 0, 0, 0, 0]))
    assert not prior.allows(se3_exp([0, 0, 0, 0, 0, np.radians(16.0)]))
    assert Prior(np.eye(4), 2.0).allows(se3_exp([0, 0, 0, 0, 0, np.pi]))


def test_guesses_that_hardly_differ_are_one() -> None:
    near, far = se3_exp([0.3, 0, 0, 0, 0, 0.01]), se3_exp([3.0, 0, 0, 0, 0, 0])
    assert distinct([np.eye(4), near, far]) == [0, 2]


def test_a_missing_package_is_named(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    monkeypatch.setitem(sys.modules, "kiss_matcher", None)
    with refused(ConfigError, "", None, "small_gicp"):
        icp_by_backend("small_gicp", *pair, TRUTH, IcpOptions())
    options = GlobalOptions(matcher="kiss-matcher")
    ref, query = (describe(side.submap, options) for side in pair)
    with refused(ConfigError, "", None, "kiss-matcher"):
        guesses(ref, query, None, options)


def test_small_gicp_agrees(pair: Pair) -> None:
    found = icp_by_backend("small_gicp", *pair, TRUTH @ se3_exp([0.3, 0.1, 0, 0, 0, 0.01]), IcpOptions())
    assert error(found.T_ref_query)[0] < 0.02
    assert error(found.T_ref_query)[1] < 0.1


@pytest.mark.thorough
def test_kiss_matcher_finds_the_place(pair: Pair) -> None:
    options = GlobalOptions(matcher="kiss-matcher")
    ref, query = (describe(side.submap, options) for side in pair)
    found = guesses(ref, query, None, options)
    assert min(error(T)[0] for T in found) < 1.0
    assert min(error(T)[1] for T in found) < 5.0


def test_open3d_agrees(pair: Pair) -> None:
    found = icp_by_backend("open3d", *pair, TRUTH @ se3_exp([0.3, 0.1, 0, 0, 0, 0.01]), IcpOptions())
    assert error(found.T_ref_query)[0] < 0.01
    with refused(ConfigError, "", None, "icp"):
        icp_by_backend("icp", *pair, TRUTH, IcpOptions())  # type: ignore[arg-type]


def tracked(
    ref: clouds.Drive, query: clouds.Drive, first: Guess | None = None, prior: MapPrior | None = None
) -> tuple[list[Registration], list[float], list[str]]:
    said: list[str] = []
    options = DriveRegistrationOptions(step_m=8.0, search=GlobalOptions(iterations=10_000))
    found = register_along(ref, query, ref.nodes, query.nodes, prior, options, first=first, say=said.append)
    errors = [
        error(r.T_ref_query, invert(ref.T_street_node[r.ref]) @ query.T_street_node[r.query])[0]
        for r in found
        if r.trusted
    ]
    return found, errors, said


def test_a_coarse_registration_tells_right_guesses_from_wrong_ones() -> None:
    street = clouds.irregular(3)
    one, other = clouds.Drive(street, 1, 60.0, 66.0), clouds.Drive(street, 2, 62.0, 66.0)
    truth = invert(one.T_street_node[0]) @ other.T_street_node[0]
    off = ((9.0, 0.0), (0.8, 0.03), (-14.0, 0.0), (0.5, 0.0), (0.0, 3.1))
    guesses = [(0, 0, truth @ se3_exp([x, 0, 0, 0, 0, turn])) for x, turn in off]
    ref, query = PreparedDrive(one, one.nodes), PreparedDrive(other, other.nodes)
    ((_, _, found),) = promising_guesses(ref, query, guesses, HypothesisOptions())
    assert error(found, truth)[0] < 0.2


@pytest.mark.thorough
def test_drives_that_gnss_puts_apart_are_found_without_it() -> None:
    street = clouds.irregular(3)
    ref, query = clouds.Drive(street, 1, 35.0, 90.0), clouds.Drive(street, 2, 40.0, 90.0, lateral=0.8)
    away = make_transform(np.eye(3), [60.0, 60.0, 0.0])
    found, errors, said = tracked(ref, query, prior=MapPrior(ref.T_street_node, away @ query.T_street_node))
    assert any(r.trusted for r in found)
    assert max(errors) < 0.05
    assert said == [
        "nothing holds where GNSS puts the drives; they are searched for each other without GNSS",
        "the drives were found without GNSS, which is wrong for one of them",
    ]


def test_drives_that_do_not_meet_are_searched_for_without_gnss_at_few_places(monkeypatch: pytest.MonkeyPatch) -> None:
    searched: list[tuple[bool, int]] = []

    def nothing(self: Any, node: int, thorough: bool) -> SearchResult:
        searched.append((self.prior is not None, node))
        return SearchResult(None, "nothing holds")

    monkeypatch.setattr(along_drive._DriveRegistration, "_search", nothing)
    monkeypatch.setattr(along_drive._DriveRegistration, "ratio_of_lengths", lambda self: None)
    street = clouds.irregular(3)
    ref, query = clouds.Drive(street, 1, 35.0, 90.0), clouds.Drive(street, 2, 0.0, 400.0)
    away = make_transform(np.eye(3), [900.0, 0.0, 0.0])
    found, _, said = tracked(ref, query, prior=MapPrior(ref.T_street_node, away @ query.T_street_node))
    assert not any(one.trusted for one in found)
    assert 5 < sum(with_gnss for with_gnss, _ in searched) < 12
    without = [node for with_gnss, node in searched if not with_gnss]
    assert 4 <= len(without) <= 5
    assert query.nodes.travelled_m[without[-1]] >= 300
    assert said[-1] == "they were not found without GNSS either"


@pytest.mark.thorough
def test_a_drive_is_tracked_from_one_pair_and_a_drive_that_goes_on_ends_with_the_reason() -> None:
    street = clouds.irregular(3)
    ref, query = clouds.Drive(street, 1, 35.0, 120.0), clouds.Drive(street, 2, 60.0, 160.0, lateral=0.8)
    first = (15, 2, invert(ref.T_street_node[15]) @ query.T_street_node[2] @ se3_exp([0.4, 0.1, 0, 0, 0, 0.02]))
    found, errors, said = tracked(ref, query, first=first)
    assert not said
    assert max(errors) < 0.05
    came_by = [r for r in found if query.T_street_node[r.query][0, 3] < 115]
    assert all(r.trusted for r in came_by)
    beyond = [r for r in found if query.T_street_node[r.query][0, 3] > 140]
    assert beyond
    assert all("did not come by" in r.reason for r in beyond)


@pytest.mark.thorough
def test_coarser_searches_follow_where_the_first_leads_to_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    street = clouds.irregular(3)
    ref, query = clouds.Drive(street, 1, 60.0, 100.0), clouds.Drive(street, 2, 62.0, 86.0)
    right = invert(ref.T_street_node[4]) @ query.T_street_node[0] @ se3_exp([0.4, 0.1, 0, 0, 0, 0.02])
    asked: list[tuple[float, int]] = []

    def by_features(_ref: PreparedDrive, _query: PreparedDrive, node: int, search: GlobalOptions) -> list[Guess]:
        asked.append((search.voxel_m, len(search.seeds)))
        return [(4, node, right)] if search.voxel_m > 1.2 else []

    monkeypatch.setattr(place_recognition, "guesses_by_features", by_features)
    found, errors, _ = tracked(ref, query)
    assert asked == [(0.7, 3), (1.0, 10), (1.4, 10)]
    assert all(r.trusted for r in found)
    assert max(errors) < 0.05


def test_registrations_of_drives_whose_lengths_differ_are_refused_for_that(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here they are given; ``benchmarks/lidar/sensor_faults.py`` finds them where odometry is too long."""
    ref, query = straight(1.0, 30), straight(0.9, 30)
    found = [Registration(k, k, np.eye(4), np.eye(6), GOOD) for k in range(30)]
    monkeypatch.setattr(along_drive._DriveRegistration, "run", lambda self, first: found)
    street = clouds.Drive(clouds.irregular(3), 1, 60.0, 64.0)
    said: list[str] = []
    refused_ones = register_along(street, street, ref, query, None, DriveRegistrationOptions(), say=said.append)
    (told,) = said
    assert [one.reason for one in refused_ones] == [told] * 30
    assert "10 %" in told


@pytest.mark.parametrize("stretch", [0.9, 1.0, 1.06])
def test_distances_between_registrations_tell_the_ratio_of_lengths(stretch: float) -> None:
    rng, count = np.random.default_rng(0), 30
    travelled = np.linspace(0.0, 4.0 * (count - 1), count)
    truth = np.array([se3_exp([x, 0.0, 0.0, 0.0, 0.0, 0.0]) for x in travelled])
    ref = Nodes(np.arange(count) * 10**9, truth, travelled)
    query = ref.stretched(stretch)
    near = [se3_exp(rng.normal(size=6) * [0.1, 0.1, 0.1, 0.01, 0.01, 0.01]) for _ in range(count)]
    found = [Registration(k, k, near[k], np.eye(6), GOOD, "") for k in range(count)]
    ratio = ratio_of_lengths(found, ref, query)
    assert ratio is not None
    assert abs(ratio.ratio - stretch) < ratio.margin < 0.02
    few_wrong = [replace(one, T_ref_query=one.T_ref_query @ se3_exp([3.0, 0, 0, 0, 0, 0])) for one in found[8:12]]
    ratio = ratio_of_lengths([*found[:8], *few_wrong, *found[12:]], ref, query)
    assert ratio is not None
    assert ratio.ratio == pytest.approx(stretch, abs=0.02)
    assert ratio_of_lengths([replace(one, reason="overlap") for one in found], ref, query) is None
    assert ratio_of_lengths(found[:7], ref, query) is None
    assert ratio_of_lengths(found, ref, replace(query, segment=np.arange(count) // 3)) is None


@pytest.mark.parametrize(
    ("trusted", "refused", "elsewhere", "by_chance"),
    [
        (30, 0, 0, False),
        (19, 11, 0, False),
        (17, 13, 0, True),
        # A wrong place leads off the reference's road, where nothing is compared.
        (9, 0, 21, True),
        (16, 0, 14, False),
        (9, 0, 0, False),
        (0, 0, 30, True),
    ],
)
def test_few_registrations_or_little_road_may_hold_by_chance(
    trusted: int, refused: int, elsewhere: int, by_chance: bool
) -> None:
    found = [Registration(k, k, np.eye(4), np.eye(6), GOOD) for k in range(trusted)]
    found += [Registration(k, k, np.eye(4), np.eye(6), GOOD, "overlap") for k in range(refused)]
    found += [unregistered((k, k), np.eye(4), "the reference did not come by") for k in range(elsewhere)]
    assert may_hold_by_chance(found, 4.0) == by_chance


def straight(stretch: float, count: int) -> Nodes:
    """Nodes four metres apart, along odometry that is ``stretch`` times as long."""
    travelled = np.linspace(0.0, 4.0 * (count - 1), count)
    truth = np.array([se3_exp([x, 0.0, 0.0, 0.0, 0.0, 0.0]) for x in travelled])
    return Nodes(np.arange(count) * 10**9, truth, travelled).stretched(stretch)


def test_drift_of_the_reference_from_lap_to_lap_makes_it_no_longer() -> None:
    count, laps = 200, 4
    step = se3_exp([4.0, 0, 0, 0, 0, 2 * np.pi / count])
    lap = np.array([np.linalg.matrix_power(step, k) for k in range(count)])
    drifted = np.concatenate([se3_exp([0, 10.0 * k, 0, 0, 0, 0.09 * k]) @ lap for k in range(laps)])
    ref = Nodes(np.arange(laps * count) * 10**9, drifted, np.linspace(0.0, 4.0 * (laps * count - 1), laps * count))
    query = Nodes(np.arange(count) * 10**9, lap, np.linspace(0.0, 4.0 * (count - 1), count))
    # Each quarter of the query's lap was found on another lap of the reference.
    found = [Registration(k + k * laps // count * count, k, np.eye(4), np.eye(6), GOOD) for k in range(count)]
    ratio = ratio_of_lengths(found, ref, query)
    assert ratio is not None
    assert ratio.ratio == pytest.approx(1.0, abs=1e-3)


def test_the_margin_of_a_ratio_reaches_to_its_farther_limit() -> None:
    count = 75
    nodes, slipped = straight(1.0, count), se3_exp([-8.0, 0, 0, 0, 0, 0])
    found = [Registration(k, k, slipped if k > count // 2 else np.eye(4), np.eye(6), GOOD) for k in range(count)]
    ratio = ratio_of_lengths(found, nodes, nodes)
    assert ratio is not None
    # Nearly half of the pairs of registrations tell that both are equally long.
    assert ratio.ratio > 1.02
    assert ratio.ratio - ratio.margin < 1.005


def test_registrations_of_a_query_that_stands_tell_no_ratio() -> None:
    nodes = straight(1.0, 20)
    found = [Registration(k, 5, np.eye(4), np.eye(6), GOOD) for k in range(20)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert ratio_of_lengths(found, nodes, nodes) is None


def test_a_long_drive_is_thinned_before_its_registrations_are_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    compared: list[int] = []

    def counted(y: Array, x: Array, alpha: float) -> Any:
        compared.append(len(x))
        return theilslopes(y, x, alpha=alpha)

    monkeypatch.setattr(lengths, "_MOST", 30)
    monkeypatch.setattr(lengths, "theilslopes", counted)
    nodes = straight(1.0, 59)
    found = [Registration(k, k, np.eye(4), np.eye(6), GOOD) for k in range(59)]
    assert ratio_of_lengths(found, nodes, nodes) is not None
    assert compared == [30]


def test_neither_bends_nor_drift_nor_a_second_lap_make_a_drive_longer() -> None:
    for seed in range(20):
        rng, count = np.random.default_rng(seed), 120
        nodes = []
        # Two laps of a roundabout, the query 1.5 m further inside.
        for radius, scale, drift in ((15.0, 1.0, 1e-3), (13.5, 1.01, -1e-3)):
            step = se3_exp([2.0 / 15.0 * radius * scale, 0, 0, 0, 0, 2.0 / 15.0 + drift])
            poses = np.array([np.linalg.matrix_power(step, k) for k in range(count)])
            nodes.append(Nodes(np.arange(count) * 10**9, poses, np.linspace(0.0, step[0, 3] * (count - 1), count)))
        ref, query = nodes
        found = []
        for k in range(0, count, 2):
            beside = se3_exp([0.0, 1.5, 0, 0, 0, 0]) @ se3_exp(rng.normal(size=6) * [0.3, 0.05, 0.05, 0.01, 0.01, 0.01])
            found.append(Registration(k, k, beside, np.eye(6), GOOD, ""))
        for chosen in (found, found[20:28]):
            ratio = ratio_of_lengths(chosen, ref, query)
            assert ratio is not None
            assert not ratio.exceeds(0.04)


def test_what_is_ambiguous_is_not_searched_on(monkeypatch: pytest.MonkeyPatch) -> None:
    street = clouds.irregular(3)
    ref, query = clouds.Drive(street, 1, 60.0, 80.0), clouds.Drive(street, 2, 62.0, 66.0)
    asked: list[float] = []

    def nothing_found(_ref: PreparedDrive, _query: PreparedDrive, _node: int, search: GlobalOptions) -> list[Guess]:
        asked.append(search.voxel_m)
        return []

    monkeypatch.setattr(place_recognition, "guesses_by_features", nothing_found)
    monkeypatch.setattr(
        along_drive, "choose_hypothesis", lambda *a: SearchResult(None, "ambiguous: two poses", ambiguous=True)
    )
    found, errors, _ = tracked(ref, query)
    assert asked == [0.7, 0.7, 0.7]  # once to find the drives, twice to find a stretch that makes them fit
    assert not errors
    assert all("ambiguous" in r.reason for r in found)


@pytest.mark.thorough
def test_a_wrong_first_pair_is_found_out() -> None:
    street = clouds.irregular(3)
    ref, query = clouds.Drive(street, 1, 60.0, 100.0), clouds.Drive(street, 2, 62.0, 100.0)
    wrong = (8, 2, make_transform(np.eye(3), [12.0, 0, 0]) @ invert(ref.T_street_node[8]) @ query.T_street_node[2])
    found, errors, said = tracked(ref, query, first=wrong)
    assert "does not hold" in said[0]
    assert sum(r.trusted for r in found) >= len(found) - 1
    assert max(errors) < 0.05
