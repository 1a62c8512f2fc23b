"""Feature pyramids, and the points that a reference keeps of them."""

from __future__ import annotations

import numpy as np
import pytest
from alignment_scene import CAMERA
from feature_alignment_scene import features, keyframe_points, pyramid
from plain_alignment import bilinear
from refusals import refused

from baselines.alignment.features.pyramid import FeaturePyramid, level_coordinates, sample
from baselines.alignment.features.reference import FeaturePoints, ReferenceFeatures
from baselines.alignment.shared.pyramid import level_camera
from relocbench.arrays import Indices
from relocbench.errors import MethodError
from relocbench.geometry import Camera
from relocbench.tracking import KeyframePoints


def test_maps_that_cover_an_odd_last_row_are_cropped_to_the_level() -> None:
    camera = Camera("pinhole", 121, 91, 100.0, 100.0, 60.0, 45.0)
    maps = [np.random.default_rng(k).normal(size=(-(-91 // 2**k), -(-121 // 2**k), 3)) for k in range(3)]
    found = FeaturePyramid.from_maps(maps, camera)
    assert [level.map.shape for level in found.levels] == [(91, 121, 3), (45, 60, 3), (22, 30, 3)]
    for number, level in enumerate(found.levels):
        assert level.camera == level_camera(camera, number)
        assert level.map.dtype == np.float32
        assert level.map.flags.c_contiguous
        np.testing.assert_allclose(level.map, maps[number][: level.camera.height, : level.camera.width], rtol=1e-6)


def test_a_map_of_the_right_kind_is_not_copied() -> None:
    values = np.zeros((CAMERA.height, CAMERA.width, 4), np.float32)
    assert np.shares_memory(FeaturePyramid.from_maps([values], CAMERA).levels[0].map, values)


@pytest.mark.parametrize(
    ("shapes", "names"),
    [
        ([], ()),
        ([(256, 320)], ("level 0", "(256, 320)", "(256, 320, channels)")),
        ([(320, 256, 4)], ("level 0", "(320, 256, 4)")),
        ([(256, 320, 4), (256, 320, 4)], ("level 1", "(128, 160, channels)")),
    ],
)
def test_wrong_maps_are_refused_with_what_was_expected(shapes: list[tuple[int, ...]], names: tuple[str, ...]) -> None:
    with refused(MethodError, "", None, *names):
        FeaturePyramid.from_maps([np.zeros(shape, np.float32) for shape in shapes], CAMERA)


def test_a_distorted_camera_is_refused_by_name() -> None:
    distorted = Camera("radtan", 50, 40, 30, 30, 25, 20, (0.1, 0, 0, 0))
    with refused(MethodError, "", None, "pinhole", "radtan"):
        FeaturePyramid.from_maps([np.zeros((40, 50, 2), np.float32)], distorted)


def test_level_coordinates_are_those_of_the_level_cameras() -> None:
    uv = np.random.default_rng(0).uniform(0, 200, (50, 2))
    rays = CAMERA.unproject(uv)[0]
    for level in range(4):
        np.testing.assert_allclose(level_coordinates(uv, level), level_camera(CAMERA, level).project(rays)[0])


def test_sampling_is_bilinear_up_to_the_last_pixel() -> None:
    level_map = np.random.default_rng(0).normal(size=(12, 15, 3)).astype(np.float32)
    uv = np.random.default_rng(1).uniform(0, [13.99, 10.99], (40, 2))
    np.testing.assert_allclose(sample(level_map, uv), bilinear(level_map, *uv.T), atol=1e-6)
    corners = np.array([[0, 0], [14, 0], [0, 11], [14, 11]])
    np.testing.assert_array_equal(sample(level_map, corners.astype(float)), level_map[corners[:, 1], corners[:, 0]])


def inside(points: KeyframePoints, number: int) -> Indices:
    """The points that are not within two pixels of a level's border: no others are left out."""
    uv = level_coordinates(points.uv, number)
    return np.flatnonzero(np.all((uv >= 2) & (uv <= np.array(level_camera(CAMERA, number).size) - 3), axis=1))


def test_points_keep_their_place_and_depth_on_every_level() -> None:
    points = keyframe_points()
    reference = ReferenceFeatures.at_points(points, pyramid())
    assert len(reference.levels[0]) == len(points)
    for number, level in enumerate(reference.levels):
        kept = inside(points, number)
        assert np.all(level.weights == 1)
        rays = CAMERA.unproject(points.uv[kept])[0]
        np.testing.assert_allclose(level.points[:2].T, rays[:, :2], atol=1e-6)
        np.testing.assert_allclose(level.points[2], points.inverse_depth[kept], rtol=1e-6)
        exact = features(rays / points.inverse_depth[kept, None], number)
        assert np.quantile(np.abs(level.values - exact), 0.95) < 0.03


def test_coarse_levels_may_have_fewer_points() -> None:
    points = keyframe_points()
    whole, some = (ReferenceFeatures.at_points(points, pyramid(), coarse_points=most) for most in (None, 50))
    assert [len(level) for level in some.levels[:2]] == [len(level) for level in whole.levels[:2]]
    for thinned, level in zip(some.levels[2:], whole.levels[2:], strict=True):
        assert len(thinned) == 50 < len(level)
        rows = [int(np.flatnonzero((point == level.points.T).all(axis=1))[0]) for point in thinned.points.T]
        assert max(np.diff([0, *rows, len(level) - 1])) <= len(level) / 49 + 1
        np.testing.assert_array_equal(thinned.values, level.values[rows])


def test_confidences_are_the_weights_of_their_level() -> None:
    points, maps = keyframe_points(), [level.map for level in pyramid().levels]
    rng = np.random.default_rng(0)
    confidences = [rng.uniform(0.1, 1.0, (*values.shape[:2], 1)) for values in maps]
    plain = ReferenceFeatures.at_points(points, pyramid())
    weighted = ReferenceFeatures.at_points(points, FeaturePyramid.from_maps(maps, CAMERA, confidences))
    for number, (before, after) in enumerate(zip(plain.levels, weighted.levels, strict=True)):
        uv = level_coordinates(points.uv[inside(points, number)], number)
        of_points = bilinear(confidences[number].astype(np.float32), *uv.T)[:, 0]
        np.testing.assert_allclose(after.weights, of_points, rtol=1e-5)
        np.testing.assert_array_equal(after.values, before.values)


def test_as_many_confidences_as_maps_of_the_same_size() -> None:
    maps = [level.map for level in pyramid().levels]
    confidences = [np.ones((*values.shape[:2], 1), np.float32) for values in maps]
    with refused(MethodError, "", None, 3, 4):
        FeaturePyramid.from_maps(maps, CAMERA, confidences[:3])
    with refused(MethodError, "", None, "level 1"):
        FeaturePyramid.from_maps(maps, CAMERA, [confidences[0]] * 4)


def test_points_without_a_positive_depth_are_left_out() -> None:
    uv = np.full((4, 2), 50.0)
    points = KeyframePoints(uv, np.array([0.2, 0.0, -1.0, np.nan]), np.zeros(4))
    assert [len(level) for level in ReferenceFeatures.at_points(points, pyramid()).levels] == [1] * 4


def test_spread_is_the_features_robust_scale() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(4001, 16)) * 3 + rng.normal(size=16) * 100
    camera = level_camera(CAMERA, 0)

    def spread(of: np.ndarray) -> float:
        return FeaturePoints.at(np.zeros((len(of), 2)), np.ones(len(of)), of, camera).spread

    assert spread(values) == pytest.approx(3 * np.sqrt(16), rel=0.05)
    assert spread(2 * values + 7) == pytest.approx(2 * spread(values), rel=1e-4)
    spoilt = values.copy()
    spoilt[:800] = 1e6
    assert spread(spoilt) == pytest.approx(spread(values), rel=0.15)
    assert np.isnan(spread(values[:0]))


@pytest.mark.parametrize("weights", [[1.0, 0.0], [1.0, -1.0], [1.0, np.nan], [1.0, np.inf], [1.0]])
def test_weights_must_be_positive_numbers(weights: list[float]) -> None:
    with refused(MethodError, "", None, "weights"):
        FeaturePoints.at(np.full((2, 2), 50.0), np.ones(2), np.zeros((2, 4)), CAMERA, np.array(weights))


def test_vectors_must_be_as_many_as_points() -> None:
    with refused(MethodError, "", None, "(N, D)"):
        FeaturePoints.at(np.zeros((3, 2)), np.ones(3), np.zeros((2, 4)), CAMERA)


def test_stored_gradients_are_there_for_matching() -> None:
    level = pyramid().with_gradients()[1]
    assert level.channels == pyramid().levels[1].channels
    np.testing.assert_array_equal(level.map[..., : level.channels], pyramid().levels[1].map)
