"""The first guess from matched features: right where features are told apart, none where nothing agrees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import poselib
import pytest

from baselines.alignment.features.pyramid import FeaturePyramid
from baselines.gn_net.correspondence import Landmarks, add_window_distances, match_landmarks
from baselines.gn_net.start import StartSettings, find_landmarks
from relocbench.geometry import Camera, apply, make_transform, rotation_angle, so3_exp
from relocbench.tracking import KeyframePoints

CAMERA = Camera(model="pinhole", width=256, height=256, fx=128.0, fy=128.0, cx=127.5, cy=127.5)
T_QUERY_REF = make_transform(so3_exp([0.02, 0.15, -0.03]), [0.7, -0.1, 1.1])
SETTINGS = StartSettings(level=0, points=500, threshold=1.5)


def a_scene(seed: int, right: float) -> tuple[Landmarks, FeaturePyramid]:
    """Points with a random feature each; the query shows the share ``right`` of them where they are.

    Elsewhere, and in place of the others, it shows random features.
    """
    rng = np.random.default_rng(seed)
    uv = rng.uniform(4, 251, (400, 2))
    inverse_depth = 1 / rng.uniform(5, 25, len(uv))
    rays = np.concatenate([(uv - 127.5) / 128.0, np.ones((len(uv), 1))], axis=1)
    seen, visible = CAMERA.project(apply(T_QUERY_REF, rays / inverse_depth[:, None]))
    values = rng.normal(size=(len(uv), 8)).astype(np.float32)
    maps = [rng.normal(size=(256, 256, 8)).astype(np.float32) for _ in range(2)]
    for i in np.flatnonzero(visible & (rng.random(len(uv)) < right)):
        u, v = np.rint(seen[i]).astype(int)
        if 1 <= u < 255 and 1 <= v < 255:
            maps[1][v, u] = values[i]
    points = KeyframePoints(uv, inverse_depth, np.full(len(uv), 1e-3))
    landmarks = Landmarks.at(points, FeaturePyramid.from_maps(maps[:1], CAMERA), 400, rng)
    return replace(landmarks, values=(values,)), FeaturePyramid.from_maps(maps[1:], CAMERA)


@pytest.mark.parametrize("best_first", [False, True])
@pytest.mark.parametrize("right", [1.0, 0.4])
def test_the_pose_is_found_far_from_the_identity(right: float, best_first: bool) -> None:
    found = find_landmarks(*a_scene(0, right), SETTINGS).pose(seed=0, best_first=best_first)
    assert found is not None
    off = np.linalg.inv(found) @ T_QUERY_REF
    assert np.linalg.norm(off[:3, 3]) < 0.05
    assert np.degrees(rotation_angle(off[:3, :3])) < 0.3


def test_the_same_seed_gives_the_same_pose() -> None:
    scene = a_scene(1, 0.5)
    one, other = (find_landmarks(*scene, SETTINGS).pose(seed=3) for _ in range(2))
    assert one is not None
    assert other is not None
    assert np.array_equal(one, other)


def test_seeds_may_be_as_large_as_they_like() -> None:
    matched = find_landmarks(*a_scene(1, 0.5), SETTINGS)
    np.testing.assert_array_equal(matched.pose(2**64 + 3), matched.pose(3))


def test_poselib_takes_the_options_that_are_given() -> None:
    """It ignores options that it does not know."""
    known = poselib.RansacOptions()
    given = {"max_reproj_error", "max_iterations", "min_iterations", "success_prob", "progressive_sampling", "seed"}
    assert given <= set(known if isinstance(known, dict) else dir(known))


def test_several_poses_are_those_of_seeds_that_follow_each_other() -> None:
    matched = find_landmarks(*a_scene(1, 0.5), SETTINGS)
    expected = [matched.pose(3), matched.pose(4, best_first=True), matched.pose(5)]
    np.testing.assert_array_equal(list(matched.poses(3, seed=3)), expected)


def test_too_few_points_give_no_pose() -> None:
    landmarks, query = a_scene(2, 1.0)
    few = Landmarks(landmarks.points[:3], (landmarks.values[0][:3],))
    none = Landmarks(landmarks.points[:0], (landmarks.values[0][:0],))
    for landmarks in (few, none):
        seen = find_landmarks(landmarks, query, SETTINGS)
        assert seen.pose(seed=0) is None
        assert list(seen.poses(2, seed=0)) == []
        assert (len(seen), seen.agreement(np.eye(4))) == (0, 0.0)


@pytest.mark.parametrize("right", [1.0, 0.4])
def test_the_share_that_agrees_tells_the_right_pose(right: float) -> None:
    """All landmarks are the denominator, seen or not; a wrong pose agrees with next to none of them."""
    landmarks, query = a_scene(4, right)
    seen = find_landmarks(landmarks, query, SETTINGS)
    put, _ = CAMERA.project(apply(T_QUERY_REF, landmarks.points))
    in_view = np.count_nonzero(CAMERA.contains(put)) / len(landmarks)
    assert seen.agreement(T_QUERY_REF) == pytest.approx(right * in_view, abs=0.08)
    wrong = make_transform(so3_exp([0.0, 0.3, 0.0]), [0.0, 0.0, 2.0]) @ T_QUERY_REF
    behind = make_transform(so3_exp([0.0, np.pi, 0.0]), [0.0, 0.0, 0.0]) @ T_QUERY_REF
    assert seen.agreement(wrong) < 0.02
    assert seen.agreement(behind) == 0.0


def test_landmarks_are_points_with_depth_where_they_are() -> None:
    u = np.mgrid[:256, :256][::-1].transpose(1, 2, 0).astype(np.float32)
    pyramid = FeaturePyramid.from_maps([u, (u[::2, ::2] + u[1::2, 1::2]) / 2], CAMERA)
    uv = np.array([[20.5, 30.0], [100.0, 7.0], [0.0, 255.0], [50.0, 60.0]])
    inverse_depth = np.array([0.1, 0.5, 0.2, 0.0])
    points = KeyframePoints(uv, inverse_depth, np.full(4, 0.01))
    landmarks = Landmarks.at(points, pyramid, 10, np.random.default_rng(0))
    assert len(landmarks) == 3
    pixels, _ = CAMERA.project(landmarks.points)
    assert np.allclose(pixels, uv[:3])
    assert np.allclose(landmarks.points[:, 2], [10, 2, 5])
    assert np.allclose(landmarks.values[0], uv[:3])
    assert np.allclose(landmarks.values[1][:2], uv[:2])
    assert len(Landmarks.at(points, pyramid, 2, np.random.default_rng(0))) == 2


def smooth_maps(seed: int, shift: float) -> list[np.ndarray]:
    """Three levels of a pattern of waves, moved by ``shift`` pixels of the finest along u."""
    rng = np.random.default_rng(seed)
    maps = []
    for level, longest in ((0, 24.0), (1, 60.0), (2, 200.0)):
        size = 256 >> level
        v, u = ((np.mgrid[:size, :size] + 0.5) * (1 << level) - 0.5).astype(np.float64)
        waves = rng.uniform(-1, 1, (12, 2)) * 2 * np.pi / longest
        phases = rng.uniform(0, 2 * np.pi, 12)
        angle = waves[:, 0] * (u - shift)[..., None] + waves[:, 1] * v[..., None] + phases
        maps.append(np.cos(angle).astype(np.float32))
    return maps


def test_matches_are_exact_to_a_fraction_of_the_finest_pixel() -> None:
    uv = np.random.default_rng(0).uniform(40, 180, (60, 2))
    points = KeyframePoints(uv, np.full(60, 0.1), np.full(60, 0.01))
    landmarks = Landmarks.at(
        points, FeaturePyramid.from_maps(smooth_maps(1, 0.0), CAMERA), 60, np.random.default_rng(0)
    )
    query = FeaturePyramid.from_maps(smooth_maps(1, 21.3), CAMERA)
    rows, found = match_landmarks(landmarks, query, 2, (3, 2))
    assert len(rows) > 20  # of points that share a coarse pixel one alone is kept
    off = np.linalg.norm(found - (uv[rows] + [21.3, 0.0]), axis=1)
    assert np.median(off) < 0.1
    assert np.mean(off < 0.5) > 0.9
    _, coarse = match_landmarks(landmarks, query, 2, ())
    assert np.median(np.linalg.norm(coarse - (uv[rows] + [21.3, 0.0]), axis=1)) > 0.5


def test_distances_in_windows_are_those_of_maps_read_bilinearly() -> None:
    rng = np.random.default_rng(0)
    fine, coarse = (rng.normal(size=(size, size, 5)).astype(np.float32) for size in (16, 8))
    values = rng.normal(size=(4, 5)).astype(np.float32)
    corners = np.array([[3, 4], [-2, 0], [12, 13], [7, 2]])
    for level_map, coarser in ((fine, 1), (coarse, 2)):
        distances = np.full((4, 5, 5), 0.25, dtype=np.float32)
        add_window_distances(values, level_map, coarser, corners, distances)
        last = level_map.shape[0] - 1
        for m, i, j in np.ndindex(4, 5, 5):
            u, v = np.clip((corners[m] + [j, i] + 0.5) / coarser - 0.5, 0, last)
            iu, iv = int(u), int(v)
            ju, jv, au, av = min(iu + 1, last), min(iv + 1, last), u - iu, v - iv
            read = (1 - av) * ((1 - au) * level_map[iv, iu] + au * level_map[iv, ju]) + av * (
                (1 - au) * level_map[jv, iu] + au * level_map[jv, ju]
            )
            assert distances[m, i, j] == pytest.approx(0.25 + np.sum((read - values[m]) ** 2), rel=1e-4)
