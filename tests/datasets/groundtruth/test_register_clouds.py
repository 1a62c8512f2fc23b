"""Registration of two clouds: exact in its frames and scale, and refused where it cannot be told."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from repository import TRUTH

from relocbench.datasets.groundtruth.clouds.cloud import Cloud
from relocbench.datasets.groundtruth.clouds.folders import with_one_origin
from relocbench.datasets.groundtruth.clouds.judging import judge
from relocbench.datasets.groundtruth.clouds.preparing import prepare
from relocbench.datasets.groundtruth.clouds.register import (
    CloudRegistration,
    CloudRegistrationOptions,
    register_clouds,
)
from relocbench.datasets.groundtruth.registration.global_registration import pose_difference
from relocbench.datasets.groundtruth.registration.scene_scale import SceneScale, SceneSize, scale_of, scene_size
from relocbench.datasets.groundtruth.verification.evidence import Evidence
from relocbench.errors import DatasetError
from relocbench.geometry import apply, invert, make_transform, se3_exp, se3_log, so3_exp

sys.path.insert(0, str(TRUTH))
from register_scenes import Pair, room_pair, unrelated_rooms

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def pair() -> Pair:
    return room_pair(1)


@pytest.fixture(scope="module")
def found(pair: Pair) -> CloudRegistration:
    return register_clouds(pair.a, pair.b)


def test_two_scans_of_a_room_are_registered_and_trusted(pair: Pair, found: CloudRegistration) -> None:
    assert found.trusted, found.reason
    metres, degrees = pose_difference(pair.T_a_b, found.T_a_b)
    assert metres < 0.003
    assert degrees < 0.05
    assert "free space of both" in found.rests_on
    error = se3_log(invert(found.T_a_b) @ pair.T_a_b)
    assert error @ found.information @ error / 6 < 4


def test_a_cloud_and_its_moved_copy_give_the_motion(pair: Pair) -> None:
    T = make_transform(so3_exp([0.2, -0.1, 2.0]), [3.0, -1.0, 0.5])
    copy = Cloud("copy", apply(T, pair.a.points))
    back = register_clouds(copy, Cloud("cloud", pair.a.points))
    assert back.trusted, back.reason
    metres, degrees = pose_difference(T, back.T_a_b)
    assert metres < 0.005
    assert degrees < 0.1
    assert "free space could not be judged" in back.rests_on


def test_swapped_clouds_give_the_inverse(pair: Pair, found: CloudRegistration) -> None:
    swapped = register_clouds(pair.b, pair.a)
    metres, degrees = pose_difference(invert(found.T_a_b), swapped.T_a_b)
    assert swapped.trusted == found.trusted
    assert metres < 0.002
    assert degrees < 0.05


def test_the_size_of_the_scene_does_not_matter(pair: Pair, found: CloudRegistration) -> None:
    def smaller(cloud: Cloud) -> Cloud:
        return replace(cloud, points=cloud.points / 40)

    small = register_clouds(smaller(pair.a), smaller(pair.b))
    assert small.trusted, small.reason
    T = np.array(small.T_a_b)
    T[:3, 3] *= 40
    assert pose_difference(found.T_a_b, T)[0] < 0.002
    np.testing.assert_allclose(40 * small.sigma_m, found.sigma_m, rtol=0.3)


def test_different_rooms_are_refused() -> None:
    apart = unrelated_rooms(2)
    assert register_clouds(apart.a, apart.b).reason


def test_a_wrong_initial_pose_is_refused_and_a_right_one_kept(pair: Pair) -> None:
    wrong = pair.T_a_b @ make_transform(so3_exp([0, 0, 0.9]), [0.6, 0.4, 0.0])
    kept = register_clouds(pair.a, pair.b, CloudRegistrationOptions(initial=pair.T_a_b @ se3_exp(np.full(6, 0.01))))
    assert kept.trusted, kept.reason
    refused = register_clouds(pair.a, pair.b, CloudRegistrationOptions(initial=wrong))
    assert not refused.trusted or pose_difference(pair.T_a_b, refused.T_a_b)[0] < 0.01


def test_a_cube_looks_alike_from_all_sides_and_is_refused() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, size=(30_000, 3))
    axis = rng.integers(3, size=len(points))
    points[np.arange(len(points)), axis] = rng.choice([-1.0, 1.0], len(points))
    points += 0.002 * rng.normal(size=points.shape)
    half = len(points) // 2
    alike = register_clouds(Cloud("a", points[:half]), Cloud("b", points[half:]))
    assert "ambiguous" in alike.reason or "weak" in alike.reason


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
    nan = float("nan")
    good = Evidence(0.95, 0.95, 0.01, 0.01, nan, nan, 0.01, (1.0, 0.0, 0.0), 0.01, 0.9, 0.9, 0.9, 0.9)
    scale = SceneScale(1.0, "")
    assert judge(good, scale, "both").reason.startswith("free space: nothing")
    assert not judge(good, scale, "none").reason
    assert judge(replace(good, violations_query=0.5), scale, "A").reason.startswith("free space")
    assert not judge(replace(good, violations_query=0.5), scale, "B").reason.startswith("free space: 50 %")
    assert judge(replace(good, overlap_ref=nan), scale, "none").reason.startswith("overlap")


def test_large_coordinates_of_one_region_get_one_origin() -> None:
    points = np.arange(30.0).reshape(10, 3)
    a = Cloud("a", points, origin=np.array([691_000.0, 5_334_000.0, 500.0]))
    b = Cloud("b", points, origin=np.array([691_200.0, 5_334_000.0, 500.0]))
    np.testing.assert_allclose(with_one_origin(a, b).points, points + np.array([200.0, 0.0, 0.0]))
    far = replace(b, origin=np.array([100_000.0, 0.0, 0.0]))
    assert with_one_origin(a, far) is far


def test_clouds_without_extent_are_refused() -> None:
    with pytest.raises(DatasetError, match="cloud b has all its points in one place"):
        register_clouds(Cloud("a", np.random.default_rng(0).normal(size=(500, 3))), Cloud("b", np.ones((500, 3))))
