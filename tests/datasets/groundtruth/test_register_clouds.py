"""Registration of two clouds: exact in its frames and scale, and refused where it cannot be told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from register_scenes import Pair, depth_pair, room_pair, unrelated_depth

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.clouds.alternatives import shifts_as_close
from relocbench.datasets.groundtruth.clouds.cloud import Cloud
from relocbench.datasets.groundtruth.clouds.distinct import Distinct, distinct_evidence, outside_largest_planes
from relocbench.datasets.groundtruth.clouds.field_of_view import field_of_view
from relocbench.datasets.groundtruth.clouds.folders import with_one_origin
from relocbench.datasets.groundtruth.clouds.judging import holds_nearly, judge
from relocbench.datasets.groundtruth.clouds.preparing import prepare
from relocbench.datasets.groundtruth.clouds.register import (
    CloudRegistration,
    CloudRegistrationOptions,
    register_clouds,
)
from relocbench.datasets.groundtruth.registration.global_registration import pose_difference
from relocbench.datasets.groundtruth.registration.scene_scale import SceneScale, SceneSize, scale_of, scene_size
from relocbench.datasets.groundtruth.submaps.free_space import make_patches
from relocbench.datasets.groundtruth.verification.evidence import Evidence
from relocbench.errors import DatasetError
from relocbench.geometry import apply, invert, make_transform, se3_exp, se3_log, so3_exp

NAN = float("nan")
GOOD = Evidence(0.95, 0.95, 0.01, 0.01, NAN, NAN, 0.01, (1.0, 0.0, 0.0), 0.01, 0.9, 0.9, 0.9, 0.9)


@pytest.fixture(scope="module")
def pair() -> Pair:
    return room_pair(1)


@pytest.fixture(scope="module")
def found(pair: Pair) -> CloudRegistration:
    return register_clouds(pair.a, pair.b)


@pytest.mark.thorough
def test_two_scans_of_a_room_are_registered_and_trusted(pair: Pair, found: CloudRegistration) -> None:
    assert found.trusted, found.reason
    metres, degrees = pose_difference(pair.T_a_b, found.T_a_b)
    assert metres < 0.003
    assert degrees < 0.05
    assert "free space of both" in found.rests_on
    error = se3_log(invert(found.T_a_b) @ pair.T_a_b)
    assert error @ found.information @ error / 6 < 4


@pytest.mark.thorough
def test_a_cloud_and_its_moved_copy_give_the_motion(pair: Pair) -> None:
    T = make_transform(so3_exp([0.2, -0.1, 2.0]), [3.0, -1.0, 0.5])
    copy = Cloud("copy", apply(T, pair.a.points))
    near = T @ se3_exp(np.full(6, 0.01))
    back = register_clouds(copy, Cloud("cloud", pair.a.points), CloudRegistrationOptions(initial=near))
    assert back.trusted, back.reason
    metres, degrees = pose_difference(T, back.T_a_b)
    assert metres < 0.005
    assert degrees < 0.1
    assert "free space could not be judged" in back.rests_on


@pytest.mark.thorough
def test_swapped_clouds_give_the_inverse(pair: Pair, found: CloudRegistration) -> None:
    near = invert(found.T_a_b) @ se3_exp(np.full(6, -0.01))
    swapped = register_clouds(pair.b, pair.a, CloudRegistrationOptions(initial=near))
    metres, degrees = pose_difference(invert(found.T_a_b), swapped.T_a_b)
    assert swapped.trusted == found.trusted
    assert metres < 0.002
    assert degrees < 0.05


@pytest.mark.thorough
def test_the_size_of_the_scene_does_not_matter(pair: Pair, found: CloudRegistration) -> None:
    def smaller(cloud: Cloud) -> Cloud:
        return replace(cloud, points=cloud.points / 40)

    small = register_clouds(smaller(pair.a), smaller(pair.b))
    assert small.trusted, small.reason
    T = np.array(small.T_a_b)
    T[:3, 3] *= 40
    assert pose_difference(found.T_a_b, T)[0] < 0.002
    np.testing.assert_allclose(40 * small.sigma_m, found.sigma_m, rtol=0.3)


@pytest.mark.thorough
def test_corners_of_different_rooms_fit_each_other_and_are_refused() -> None:
    apart = unrelated_depth(9002)
    found = register_clouds(apart.a, apart.b)
    assert found.evidence.overlap_ref > 0.9
    assert found.evidence.overlap_query > 0.9
    assert found.reason
    # Even where all else is good, what lies outside of three planes decides.
    a, b = (side.prepared for side in found.sides)
    assert distinct_evidence(a, b, best_of(found)).share < 0.05


@pytest.mark.thorough
def test_views_of_a_depth_camera_are_not_held_to_what_lies_beside_its_image() -> None:
    """Before its field of view was looked at, 42 % of what it \"could see\" overlapped."""
    view = depth_pair(9003)
    found = register_clouds(view.a, view.b, CloudRegistrationOptions(initial=view.T_a_b))
    assert found.evidence.overlap_ref > 0.9
    assert found.evidence.overlap_query > 0.9
    assert found.reason, "a bare corner, which fits any other"


def best_of(found: CloudRegistration) -> Array:
    """``T_A_B`` of the nodes, enlarged."""
    a, b = (side.prepared.T_cloud_node for side in found.sides)
    return np.asarray(invert(a) @ found.scale.enlarged(found.T_a_b) @ b)


@pytest.mark.thorough
def test_a_wrong_initial_pose_is_refused(pair: Pair) -> None:
    wrong = pair.T_a_b @ make_transform(so3_exp([0, 0, 0.9]), [0.6, 0.4, 0.0])
    refused = register_clouds(pair.a, pair.b, CloudRegistrationOptions(initial=wrong))
    assert not refused.trusted or pose_difference(pair.T_a_b, refused.T_a_b)[0] < 0.01


@pytest.mark.thorough
def test_a_cube_looks_alike_from_all_sides_and_is_refused() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, size=(30_000, 3))
    axis = rng.integers(3, size=len(points))
    points[np.arange(len(points)), axis] = rng.choice([-1.0, 1.0], len(points))
    points += 0.002 * rng.normal(size=points.shape)
    half = len(points) // 2
    a, b = Cloud("a", points[:half]), Cloud("b", points[half:])
    alike = register_clouds(a, b, CloudRegistrationOptions(initial=np.eye(4)))
    assert "ambiguous" in alike.reason


PERIOD_M = 4.8


def street_with_windows(rng: np.random.Generator, at_m: float, turn: Array) -> Cloud:
    """A scan of a road between two facades whose windows lie 0.3 m deep and repeat themselves."""
    count = 40_000
    along, up, side = rng.uniform(-30, 30, count) + at_m, rng.uniform(-1.7, 5, count), rng.choice([-1, 1], count)
    deep = (along % PERIOD_M < 1.4) & (up > 0) & (up < 3)
    facades = np.column_stack([along, side * (6 + 0.3 * deep), up])
    road = np.column_stack([along, rng.uniform(-6, 6, count), np.full(count, -1.7)])[::2]
    windows = PERIOD_M * rng.integers(-5, 6, count) + rng.choice([0, 1.4], count)
    reveals = np.column_stack([windows, side * rng.uniform(6, 6.3, count), rng.uniform(0, 3, count)])[::5]
    points = np.concatenate([facades, road, reveals]) - [at_m, 0, 0]
    points = apply(turn, points + 0.01 * rng.normal(size=points.shape))
    return Cloud("scan", points, np.zeros_like(points), supposed=True)


@pytest.mark.thorough
@pytest.mark.parametrize("yaw_deg", [-3.0, 1.8])
def test_a_pose_that_is_two_periods_of_a_street_off_finds_the_right_one(yaw_deg: float) -> None:
    rng, turn = np.random.default_rng(1), make_transform(so3_exp([0, 0, np.radians(yaw_deg)]), np.zeros(3))
    a, b = (street_with_windows(rng, at_m, turn) for at_m in (0.0, 2.0))
    scale = scale_of([scene_size(cloud.points) for cloud in (a, b)])
    one, other = (prepare(cloud, scale).prepared for cloud in (a, b))
    along = turn[:3, 0]
    right = invert(one.T_cloud_node) @ make_transform(np.eye(3), 2.0 * along) @ other.T_cloud_node
    wrong = make_transform(np.eye(3), 2 * PERIOD_M * along) @ right
    found = shifts_as_close(one.planes, other.planes, wrong, scale)
    assert min(pose_difference(right, T)[0] for T in found) < 0.1


@pytest.mark.thorough
def test_a_sensor_whose_beams_would_cross_the_cloud_is_refuted(pair: Pair) -> None:
    scale = scale_of([scene_size(pair.a.points)])
    assert prepare(pair.a, scale).sensor == "supposed"
    beside = replace(pair.a, points=pair.a.points + np.array([6.0, 0.5, 0.2]))
    assert prepare(beside, scale).sensor == "refuted"


@given(factor=st.floats(0.01, 100), seed=st.integers(0, 1000))
def test_reducing_an_enlarged_scene_is_exact(factor: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scale = SceneScale(factor, "")
    T = make_transform(so3_exp(rng.normal(size=3)), rng.normal(size=3))
    np.testing.assert_allclose(scale.reduced(scale.enlarged(T)), T, atol=1e-12)
    A = rng.normal(size=(6, 6))
    information, xi = A @ A.T, 1e-3 * rng.normal(size=6)
    enlarged = np.concatenate([factor * xi[:3], xi[3:]])
    np.testing.assert_allclose(xi @ scale.reduced_information(information) @ xi, enlarged @ information @ enlarged)
    np.testing.assert_allclose(
        scale.reduced(scale.enlarged(T) @ se3_exp(enlarged)), T @ se3_exp(xi), atol=1e-12 * max(factor, 1 / factor)
    )


@given(radius=st.floats(0.05, 500), spacing=st.floats(1e-4, 0.02), noise=st.floats(1e-5, 2e-3))
@settings(max_examples=50)
def test_noise_and_spacing_of_an_enlarged_scene_stay_within_tolerance(
    radius: float, spacing: float, noise: float
) -> None:
    scale = scale_of([SceneSize(radius, spacing * radius, noise * radius)])
    assert scale.factor <= 1.8 or scale.factor * noise * radius <= 0.02 * (1 + 1e-9)
    assert scale.factor <= 1.8 or scale.factor * spacing * radius <= 0.25 * (1 + 1e-9)
    assert 0 < scale.detail <= 1


def test_missing_evidence_counts_against_a_pose_unless_no_beam_can_tell() -> None:
    scale = SceneScale(1.0, "")
    assert judge(GOOD, scale, "both").reason.startswith("free space: nothing")
    assert not judge(GOOD, scale, "none").reason
    assert judge(replace(GOOD, violations_query=0.5), scale, "A").reason.startswith("free space")
    assert not judge(replace(GOOD, violations_query=0.5), scale, "B").reason.startswith("free space: 50 %")
    assert judge(replace(GOOD, overlap_ref=NAN), scale, "none").reason.startswith("overlap")


def test_a_pose_just_outside_of_a_limit_still_makes_another_one_ambiguous() -> None:
    evidence = replace(GOOD, violations_ref=0.0, violations_query=0.0)
    scale = SceneScale(1.0, "")
    for known in ("both", "none"):
        for outdoors in (False, True):
            assert holds_nearly(replace(evidence, overlap_ref=0.79), scale, known, outdoors)
            assert not holds_nearly(replace(evidence, overlap_ref=0.2), scale, known, outdoors)
            assert not holds_nearly(replace(evidence, detail_ref=NAN), scale, known, outdoors)


@pytest.mark.parametrize(
    ("share", "overlap_there", "overlap", "said"),
    [
        (0.5, 0.9, 0.9, ""),
        (0.1, 0.9, 0.9, "plain"),
        (0.0, float("nan"), 0.9, "plain"),
        (0.5, 0.3, 0.9, "overlap: outside"),
        (0.5, float("nan"), 0.9, "overlap: outside of three planes the other cloud measured nothing"),
        (0.5, 0.5, 0.65, ""),
        (0.3, 0.9, 0.65, "overlap: B"),
        (0.5, 0.9, 0.5, "overlap: B"),
    ],
)
def test_indoors_three_planes_are_no_evidence_and_much_besides_them_is(
    share: float, overlap_there: float, overlap: float, said: str
) -> None:
    evidence = replace(GOOD, violations_ref=0.0, violations_query=0.0, overlap_ref=overlap)
    verdict = judge(evidence, SceneScale(1.0, ""), "both", lambda: Distinct(share, overlap_there))
    assert verdict.reason.startswith(said)
    assert bool(verdict.reason) == bool(said)


def test_the_largest_planes_are_left_out_and_what_stands_beside_them_stays() -> None:
    rng = np.random.default_rng(0)
    points, normals, of_plane = [], [], []
    for axis in range(3):
        wall = rng.uniform(0, 10, size=(4000, 3))
        wall[:, axis] = 0.02 * rng.normal(size=len(wall))
        points.append(wall)
        normals.append(np.tile(np.eye(3)[axis], (len(wall), 1)))
        of_plane += [True] * len(wall)
    tilted = so3_exp([0.5, 0.6, 0.0])
    box = np.column_stack([rng.uniform(0, 3, size=(1500, 2)), np.zeros(1500)]) @ tilted.T + 4.0
    points.append(box)
    normals.append(np.tile(tilted[:, 2], (len(box), 1)))
    patches = make_patches(np.concatenate(points), np.concatenate(normals), np.zeros((13_500, 3)), 0.5)
    outside = outside_largest_planes(patches)
    on_box = np.abs(patches.normals @ tilted[:, 2]) > 0.99
    assert on_box.sum() > 20
    np.testing.assert_array_equal(outside, on_box)


@given(seed=st.integers(0, 1000), across=st.floats(0.1, 1.5), up=st.floats(0.1, 1.5), turn=st.floats(-3, 3))
@settings(max_examples=30)
def test_the_field_of_view_of_a_camera_is_its_pyramid(seed: int, across: float, up: float, turn: float) -> None:
    rng = np.random.default_rng(seed)
    T = make_transform(so3_exp([turn, 0.3, -turn]), rng.normal(size=3))

    def rays(width: float, height: float) -> Array:
        sides = rng.uniform(-1, 1, size=(4000, 2)) * [width, height]
        return apply(T, np.column_stack([sides, np.ones(4000)]) * rng.uniform(0.5, 9, size=(4000, 1)))

    view = field_of_view(T[:3, 3], rays(across, up))
    assert view.holds(rays(0.9 * across, 0.9 * up)).mean() > 0.99
    assert not view.holds(apply(T, np.array([[1.05 * across, 0, 1], [0, -1.05 * up, 1], [0, 0, -1]]))).any()


def test_a_scanner_that_turns_or_has_one_line_has_everything_in_view() -> None:
    rng = np.random.default_rng(0)
    around = rng.normal(size=(2000, 3))
    line = np.column_stack([rng.uniform(-1, 1, 500), np.zeros(500), np.ones(500)])
    for points in (around, line, around[:10], np.zeros((100, 3))):
        assert field_of_view(np.zeros(3), points).holds(-around).all()


def test_large_coordinates_of_one_region_get_one_origin() -> None:
    points = np.arange(30.0).reshape(10, 3)
    a = Cloud("a", points, origin=np.array([691_000.0, 5_334_000.0, 500.0]))
    b = Cloud("b", points, origin=np.array([691_200.0, 5_334_000.0, 500.0]))
    np.testing.assert_allclose(with_one_origin(a, b).points, points + np.array([200.0, 0.0, 0.0]))
    far = replace(b, origin=np.array([100_000.0, 0.0, 0.0]))
    assert with_one_origin(a, far) is far


def test_clouds_without_extent_are_refused() -> None:
    with refused(DatasetError, "", None, "b"):
        register_clouds(Cloud("a", np.random.default_rng(0).normal(size=(500, 3))), Cloud("b", np.ones((500, 3))))
