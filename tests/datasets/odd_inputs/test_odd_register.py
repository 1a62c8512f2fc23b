"""Pairs of clouds that look right and are not: what they cannot tell, copies, and clouds in different units."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from odd_inputs import odd_input
from refusals import assert_names
from register_scenes import room_pair
from register_shapes import shape_pair

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.clouds.cloud import Cloud, cloud_of_file
from relocbench.datasets.groundtruth.clouds.copies import copied_share
from relocbench.datasets.groundtruth.clouds.judging import judge
from relocbench.datasets.groundtruth.clouds.open_directions import OpenDirections, open_directions
from relocbench.datasets.groundtruth.clouds.register import CloudRegistrationOptions, register_clouds
from relocbench.datasets.groundtruth.clouds.units import unit_guesses
from relocbench.datasets.groundtruth.registration.scene_scale import SceneScale
from relocbench.datasets.groundtruth.verification.evidence import Evidence
from relocbench.datasets.sensors.cloud_files import read_cloud
from relocbench.geometry import apply, make_transform, so3_exp

NOISE = 0.05
"""standard deviation of the normals, radians"""


def opened(points: Array, normals: Array) -> OpenDirections:
    """The open motions of surfaces that two clouds measured with normals of independent noise."""
    rng = np.random.default_rng(1)

    def by(noisy: Array) -> Array:
        noisy = noisy / np.linalg.norm(noisy, axis=1, keepdims=True)
        return np.hstack([noisy, np.cross(points, noisy)])

    a, b = (by(normals + NOISE * rng.normal(size=normals.shape)) for _ in range(2))
    return open_directions(a, b, np.ones(len(points)))


def walls(axes: str, count: int = 4000) -> tuple[Array, Array]:
    """Points in a box of 20 x 3 x 2.5 m, on its walls across some axes, and their normals."""
    rng = np.random.default_rng(0)
    across = rng.choice(["xyz".index(axis) for axis in axes], count)
    points, rows = rng.uniform(-1, 1, (count, 3)), np.arange(count)
    points[rows, across] = np.sign(points[rows, across])
    return points * [10, 1.5, 1.25], np.eye(3)[across]


def around(axes: int, count: int = 4000) -> tuple[Array, Array]:
    """Points on a tunnel along x (two axes) or a sphere (three), of 3 m radius around (0, 2, 0), and their normals."""
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(count, 3))
    normals[:, : 3 - axes] = 0
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    along = rng.uniform(-10, 10, (count, 1)) * np.eye(3)[0] * (axes == 2)
    return 3 * normals + along + [0, 2, 0], normals


@pytest.mark.parametrize(
    ("surfaces", "count", "names"),
    [
        (walls("xyz"), 0, ()),
        (walls("yz"), 1, ("translation along (1.00, 0.00, 0.00)",)),
        (walls("z"), 3, ("across (0.00, 0.00, 1.00)", "rotation")),
        (around(2), 2, ("translation along (1.00, 0.00, 0.00)", "rotation about (1.00, 0.00, 0.00)")),
        (around(3), 3, ("rotation about any axis through (0.00, 2.00, 0.00)",)),
    ],
    ids=["box", "corridor", "floor", "tunnel", "sphere"],
)
def test_motions_that_only_noise_tells_are_named(
    surfaces: tuple[Array, Array], count: int, names: tuple[str, ...]
) -> None:
    found = opened(*surfaces)
    assert len(found) == count
    assert_names(found.named(np.eye(4)), "", None, *names)
    assert bool(found.named(np.eye(4))) == bool(count)


def test_a_few_surfaces_that_face_along_a_corridor_close_it() -> None:
    points, normals = walls("yz")
    ends, facing = walls("x", 40)
    assert len(opened(np.vstack([points, ends]), np.vstack([normals, facing]))) == 0


@given(seed=st.integers(0, 1000))
@settings(max_examples=20)
def test_information_of_open_motions_is_forgotten_and_that_of_others_stays(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = opened(*walls("yz"))
    A = rng.normal(size=(6, 6))
    left = found.forgotten(A @ A.T)
    xi = found.basis[:, 0] / [1, 1, 1, 10, 10, 10]
    assert abs(xi @ left @ xi) < 1e-9
    told = found.closed @ rng.normal(size=found.closed.shape[1])
    np.testing.assert_allclose(told @ left @ told, told @ A @ A.T @ told)


@pytest.mark.thorough
def test_a_corridor_is_not_trusted_along_itself() -> None:
    folder = odd_input("register_corridor")
    a, b = (cloud_of_file(read_cloud(folder / f"corr_{name}.npy")) for name in "ab")
    found = register_clouds(a, b, CloudRegistrationOptions(initial=np.eye(4)))
    assert_names(found.reason, "", None, "(1.00, 0.00, 0.00)")
    assert found.sigma_m[0] == np.inf
    assert found.sigma_m[1:].max() < 0.01
    assert found.covariance[0, 0] > 3.0**2


@pytest.mark.thorough
def test_the_next_step_of_a_staircase_makes_a_pose_ambiguous_and_is_in_its_sigma() -> None:
    pair = shape_pair("staircase", 0)
    found = register_clouds(pair.a, pair.b, CloudRegistrationOptions(initial=pair.T_a_b))
    assert not found.trusted
    assert found.rival is not None
    assert np.linalg.norm(found.sigma_m) > 0.1


@pytest.mark.thorough
def test_clouds_in_feet_and_metres_are_named() -> None:
    pair = room_pair(1)
    feet = Cloud("feet", pair.b.points / 0.3048, pair.b.sensors, supposed=True)
    assert_names(register_clouds(pair.a, feet).reason, "", None, "feet", "0.3048")


@pytest.mark.parametrize(
    ("a", "b", "factor"),
    [(20.0, 20_000.0, 0.001), (20_000.0, 21.0, 1000), (20.0, 65.0, 0.3048), (20.0, 1900.0, 0.01), (20.0, 26.0, None)],
)
def test_a_unit_that_explains_sizes_is_guessed_and_sizes_that_agree_need_none(
    a: float, b: float, factor: float | None
) -> None:
    guesses = unit_guesses(a, b)
    assert (guesses[0][0] if guesses else None) == factor


@given(seed=st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_a_copy_is_known_whatever_its_order_and_place_and_a_second_measurement_is_none(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, _ = walls("xyz", 5000)
    T = make_transform(so3_exp(rng.normal(size=3)), rng.normal(size=3))
    near = T @ make_transform(so3_exp(1e-4 * rng.normal(size=3)), 2e-3 * rng.normal(size=3))
    copy = apply(np.linalg.inv(T), points[rng.permutation(len(points))]).astype(np.float32).astype(np.float64)
    assert copied_share(points, copy, near) > 0.99
    again = apply(np.linalg.inv(T), points + 0.01 * rng.normal(size=points.shape))
    assert copied_share(points, again, near) == 0
    half = np.vstack([copy[:3000], again[3000:]])
    assert 0.5 < copied_share(points, half, near) < 0.7


def test_a_share_just_below_its_limit_is_made_up_for_by_others_and_not_by_nothing() -> None:
    at = Evidence(0.75, 0.75, 0.01, 0.01, 0.12, 0.12, 0.01, (1.0, 0.0, 0.0), 0.01, 0.9, 0.9, 0.45, 0.45)
    scale = SceneScale(1.0, "")

    def reason(**shares: float) -> str:
        return judge(Evidence(**{**at.__dict__, **shares}), scale, "both").reason

    assert not reason()
    assert reason(detail_ref=0.447)
    assert not reason(detail_ref=0.447, overlap_ref=0.9, overlap_query=0.9)
    assert not reason(overlap_query=0.73, detail_ref=0.6, detail_query=0.6)
    assert reason(overlap_query=0.69, detail_ref=0.7, detail_query=0.7, violations_ref=0.0, violations_query=0.0)
    assert reason(detail_ref=0.447, overlap_ref=0.9, overlap_query=0.9, seen_ref=0.05)
