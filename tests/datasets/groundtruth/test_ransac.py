"""The rigid motion that most matches of two clouds agree with."""

from __future__ import annotations

import numpy as np
import pytest

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.registration.ransac import most_agreed
from relocbench.geometry import apply, invert, make_transform, rotation_angle, so3_exp

NEAR_M = 0.5
MOTION = make_transform(so3_exp([0.1, -0.2, 2.0]), [30.0, -4.0, 1.0])


def matches(right: int, wrong: int, noise_m: float = 0.1) -> tuple[Array, Array, Array, Array]:
    """Points and normals, and what they are matched to: the right ones first."""
    rng = np.random.default_rng(3)
    points = rng.uniform([-30, -10, -2], [30, 10, 8], (right + wrong, 3))
    normals = rng.normal(size=points.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    others, other_normals = apply(MOTION, points), normals @ MOTION[:3, :3].T
    others[right:] = rng.permutation(others[right:])
    return points, normals, others + noise_m * rng.normal(size=others.shape), other_normals


def draws(count: int, iterations: int = 20_000) -> Indices:
    return np.random.default_rng(0).integers(0, count, (iterations, 3))


def off(T: Array) -> tuple[float, float]:
    apart = invert(MOTION) @ T
    return float(np.linalg.norm(apart[:3, 3])), float(np.degrees(rotation_angle(apart[:3, :3])))


@pytest.mark.parametrize(("right", "wrong"), [(50, 0), (50, 50), (40, 360)])
def test_the_motion_is_found_among_wrong_matches(right: int, wrong: int) -> None:
    T, count = most_agreed(*matches(right, wrong), NEAR_M, draws(right + wrong), 10**6)
    assert 0.9 * right <= count <= right + 5
    metres, degrees = off(T)
    assert metres < 0.1
    assert degrees < 0.5


def test_normals_that_disagree_refute_a_motion() -> None:
    points, normals, others, other_normals = matches(60, 0)
    assert most_agreed(points, normals, others, -other_normals, NEAR_M, draws(60), 10**6)[1] == 0


def test_a_draw_of_fewer_than_three_matches_counts_for_nothing() -> None:
    repeated = np.repeat(draws(60)[:, :1], 3, axis=1)
    T, count = most_agreed(*matches(60, 0), NEAR_M, repeated, 10**6)
    assert count == 0
    np.testing.assert_array_equal(T, np.eye(4))


def test_it_ends_when_enough_agree() -> None:
    """The first draw that a few agree with is not the best one; without an end, the best is found."""
    given = matches(100, 100)
    early, count = most_agreed(*given, NEAR_M, draws(200), 20)
    best, most = most_agreed(*given, NEAR_M, draws(200), 10**6)
    assert 20 <= count < most
    assert off(best)[0] < off(early)[0]


def test_a_mirror_image_is_no_motion() -> None:
    """Triangles of a mirrored cloud keep their sides, but no rotation brings all of it onto the other."""
    points, normals, others, other_normals = matches(60, 0, 0.0)
    mirrored = others * [-1.0, 1.0, 1.0]
    T, count = most_agreed(points, normals, mirrored, other_normals, NEAR_M, draws(60), 10**6)
    assert np.linalg.det(T[:3, :3]) > 0
    assert count < 30
