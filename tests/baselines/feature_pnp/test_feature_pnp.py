"""ORB and SIFT with PnP on a rendered corner of two textured planes, where pose and depth are known exactly."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from answer_contract import fault_of

from baselines.feature_pnp import OrbPnp, SiftPnp
from baselines.feature_pnp.features import Features, detect, match, spread_evenly
from baselines.feature_pnp.keyframe_depth import inverse_depth_at, reach_of
from baselines.feature_pnp.pnp import SHOWN_INLIERS, SHOWN_OTHERS
from baselines.feature_pnp.solve import Matches2D3D, ransac_pose, refine_pose, rival_inliers
from relocbench.arrays import Array, Floats, Image
from relocbench.evaluation.isolation.info_text import INFO_CHARACTERS, info_text
from relocbench.geometry import Camera, apply, invert, rotation_angle, se3_exp
from relocbench.tracking import KeyframePoints, Query, Reference, TrackResult

PINHOLE = Camera("pinhole", 480, 360, 400.0, 405.0, 238.0, 181.0)
RADTAN = Camera("radtan", 480, 360, 400.0, 405.0, 238.0, 181.0, (-0.25, 0.08, 0.001, -0.0005, 0.01))
FISHEYE = Camera("equidistant", 480, 360, 250.0, 252.0, 238.0, 181.0, (-0.02, 0.004, -0.001, 0.0002))
PLANES = np.array([[0.35, 0.1, 1.0, 5.0], [-0.5, -0.15, 1.0, 4.5]])  # n . X = d in the reference frame
T_QUERY_REF = se3_exp([0.25, -0.1, -0.4, 0.03, -0.06, 0.05])
TRACKERS = pytest.mark.parametrize("tracker", [OrbPnp(), SiftPnp()], ids=["orb", "sift"])
ONE = pytest.mark.parametrize(
    "tracker", [OrbPnp(), pytest.param(SiftPnp(), marks=pytest.mark.thorough)], ids=["orb", "sift"]
)
"""for what is the same code in both"""


@cache
def texture() -> Image:
    """Blobs of many sizes, so that both detectors find something on every scale."""
    rng = np.random.default_rng(7)
    total = np.zeros((1500, 2000), dtype=np.float32)
    for sigma in (2.0, 4.0, 8.0, 16.0):
        noise = cv2.GaussianBlur(rng.standard_normal(total.shape).astype(np.float32), (0, 0), sigma)
        total += noise / noise.std()
    return np.clip(128 + 30 * total, 0, 255).astype(np.uint8)


def render(camera: Camera, T_camera_ref: Array) -> tuple[Image, Floats]:
    """Image and z-depth of the nearer of the two planes along each ray."""
    grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
    rays, valid = camera.unproject(grid)
    T_ref_camera = invert(T_camera_ref)
    directions = np.where(valid[..., None], rays, [0, 0, 1]) @ T_ref_camera[:3, :3].T
    origin = T_ref_camera[:3, 3]
    hits = (PLANES[:, 3] - PLANES[:, :3] @ origin) / (directions @ PLANES[:, :3].T)
    along = np.min(np.where(hits > 0, hits, np.inf), axis=-1)
    seen = valid & np.isfinite(along)
    points = origin + directions * np.where(seen, along, 1.0)[..., None]
    u = (1000 + 220 * (points[..., 0] + 0.3 * points[..., 2])).astype(np.float32)
    v = (750 + 220 * points[..., 1]).astype(np.float32)
    image = cv2.remap(texture(), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    depth = np.where(seen, along * np.nan_to_num(rays[..., 2]), 0.0)
    return np.where(seen, image, 0).astype(np.uint8), depth.astype(np.float32)


@cache
def reference(camera: Camera = PINHOLE) -> Reference:
    image, depth = render(camera, np.eye(4))
    return Reference("corner", 0, image, camera, depth=depth)


@cache
def prepared(tracker: OrbPnp) -> Any:
    """What the tracker made of the keyframe of the pinhole camera."""
    return tracker.prepare(reference())


@cache
def query(camera: Camera = PINHOLE) -> Query:
    return Query("query", 1, render(camera, T_QUERY_REF)[0], camera)


def errors(result: TrackResult) -> tuple[float, float]:
    """Camera-centre error in metres and rotation error in degrees."""
    assert result.T_query_ref is not None, result.message
    assert fault_of(result) is None
    centre = invert(result.T_query_ref)[:3, 3] - invert(T_QUERY_REF)[:3, 3]
    angle = rotation_angle(result.T_query_ref[:3, :3] @ T_QUERY_REF[:3, :3].T)
    return float(np.linalg.norm(centre)), float(np.rad2deg(angle))


@TRACKERS
@pytest.mark.parametrize(
    ("reference_camera", "query_camera"),
    [(PINHOLE, RADTAN), (RADTAN, FISHEYE), (FISHEYE, PINHOLE)],
    ids=lambda camera: camera.model,
)
def test_pose_is_right_for_each_camera_model_on_either_side(
    tracker: OrbPnp, reference_camera: Camera, query_camera: Camera
) -> None:
    result = tracker.track(tracker.prepare(reference(reference_camera)), query(query_camera))
    metres, degrees = errors(result)
    # A fisheye shows the pinhole's view at little more than half the scale: few matches, all from coarse ORB levels.
    metres_limit, degrees_limit = (0.02, 0.2) if isinstance(tracker, OrbPnp) else (0.003, 0.05)
    assert metres < min(metres_limit, 3 * result.info["translation_sigma_m"])
    assert degrees < min(degrees_limit, 3 * result.info["rotation_sigma_deg"])
    assert result.confidence is not None
    # Half of what the fisheye keyframe shows lies outside the view of the other cameras, and counts as different.
    narrower = reference_camera is FISHEYE
    assert (0.3 if narrower else 0.5) < result.confidence <= 1
    assert result.info["inliers"] <= result.info["matches"]
    assert result.info["reprojection_rms_px"] < 1.5


@pytest.mark.thorough
@TRACKERS
def test_sparse_map_points_are_enough(tracker: OrbPnp) -> None:
    dense = reference()
    assert dense.depth is not None
    rng = np.random.default_rng(3)
    uv = np.stack([rng.integers(0, 480, 4000), rng.integers(0, 360, 4000)], axis=-1)
    inverse = 1.0 / dense.depth[uv[:, 1], uv[:, 0]].astype(np.float64)
    points = KeyframePoints(uv.astype(np.float64), inverse, 0.01 * inverse)
    sparse = Reference("corner", 0, dense.image, dense.camera, sparse_points=points)
    metres, degrees = errors(tracker.track(tracker.prepare(sparse), query()))
    assert metres < 0.02
    assert degrees < 0.2


@ONE
def test_colour_and_grey_images_give_the_same_pose(tracker: OrbPnp) -> None:
    grey = reference()
    colour = Reference("corner", 0, np.repeat(grey.image[..., None], 3, axis=2), PINHOLE, depth=grey.depth)
    a = tracker.track(tracker.prepare(grey), query())
    b = tracker.track(tracker.prepare(colour), query())
    np.testing.assert_array_equal(a.T_query_ref, b.T_query_ref)


@pytest.mark.thorough
@TRACKERS
def test_same_inputs_give_the_same_bytes(tracker: OrbPnp) -> None:
    first = tracker.track(tracker.prepare(reference()), query())
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        again = type(tracker)().track(type(tracker)().prepare(reference()), query())
    finally:
        cv2.setNumThreads(threads)
    assert first.T_query_ref is not None
    assert again.T_query_ref is not None
    assert first.T_query_ref.tobytes() == again.T_query_ref.tobytes()
    assert first.info == again.info


@ONE
def test_prepared_reference_survives_the_way_to_another_process(tracker: OrbPnp) -> None:
    keyframe = prepared(tracker)
    there = pickle.loads(pickle.dumps(keyframe))
    np.testing.assert_array_equal(
        tracker.track(keyframe, query()).T_query_ref, tracker.track(there, query()).T_query_ref
    )


@ONE
def test_prior_is_not_used(tracker: OrbPnp) -> None:
    keyframe = prepared(tracker)
    with_prior = tracker.track(keyframe, query(), prior=se3_exp([5, 5, 5, 1, 1, 1]))
    np.testing.assert_array_equal(with_prior.T_query_ref, tracker.track(keyframe, query()).T_query_ref)


def blank() -> Query:
    return Query("blank", 1, np.full((360, 480), 90, dtype=np.uint8), PINHOLE)


def elsewhere() -> Query:
    noise = np.random.default_rng(11).integers(0, 256, (90, 120), dtype=np.uint8)
    return Query("elsewhere", 1, np.asarray(cv2.resize(noise, (480, 360)), dtype=np.uint8), PINHOLE)


@TRACKERS
@pytest.mark.parametrize("unanswerable", [blank, elsewhere])
def test_a_query_of_another_place_is_a_stated_failure(tracker: OrbPnp, unanswerable: Callable[[], Query]) -> None:
    result = tracker.track(prepared(tracker), unanswerable())
    assert not result.answered
    assert "needed" in result.message or "no pose" in result.message
    assert result.confidence is None


@ONE
def test_a_keyframe_without_depth_is_a_stated_failure(tracker: OrbPnp) -> None:
    empty = Reference("empty", 0, reference().image, PINHOLE, depth=np.zeros((360, 480), np.float32))
    nothing = Reference("nothing", 0, reference().image, PINHOLE)
    for bare in (empty, nothing):
        result = tracker.track(tracker.prepare(bare), query())
        assert not result.answered
        assert result.message.startswith("0 matches")


def test_another_pose_that_as_many_matches_hold_is_a_rival() -> None:
    """Matches of 70 points fit one pose, and those of 50 (or 5) other points a pose 0.4 m beside it.

    ``rival_inliers`` counts the matches of the second pose; where all matches fit the first, there is no rival.
    """
    rng = np.random.default_rng(4)
    points = rng.uniform([-1.5, -1.0, 4.0], [1.5, 1.0, 9.0], (120, 3))
    here, there = (
        matches_of(points, PINHOLE, pose) for pose in (T_QUERY_REF, se3_exp([0.4, 0, 0, 0, 0, 0]) @ T_QUERY_REF)
    )
    for count in (50, 5):
        pixels = np.concatenate([here.pixels[:70], there.pixels[70 : 70 + count]])
        both = Matches2D3D(points[: len(pixels)], pixels, np.ones(len(pixels)), np.zeros((len(pixels), 3)))
        assert rival_inliers(T_QUERY_REF, both, PINHOLE, 2.0, seed=0) == count
    assert rival_inliers(T_QUERY_REF, here, PINHOLE, 2.0, seed=0) == 0


def test_a_query_that_shows_two_places_is_answered_with_less_confidence() -> None:
    tracker = OrbPnp()
    other = render(PINHOLE, se3_exp([0.6, 0.0, -0.4, 0.0, 0.05, 0.0]))[0]
    torn = np.concatenate([query().image[:200], other[200:]])
    keyframe = prepared(tracker)
    whole, part = (tracker.track(keyframe, Query("q", 1, image, PINHOLE)) for image in (query().image, torn))
    assert part.answered
    assert part.info["rival_inliers"] > 10 * (whole.info["rival_inliers"] + 1) / 4
    assert whole.confidence is not None
    assert part.confidence is not None
    # Half of its image speaks for the answer, which is right: the doubt grows manyfold and remains small.
    assert 1.0 - part.confidence > 100.0 * (1.0 - whole.confidence)


def test_too_few_inliers_is_a_stated_failure() -> None:
    tracker = OrbPnp(min_inliers=300, features=320)
    result = tracker.track(prepared(tracker), query())
    assert not result.answered
    assert "300 needed" in result.message


@ONE
def test_some_matches_are_told_in_pixels_of_both_images(tracker: OrbPnp | SiftPnp) -> None:
    result = tracker.track(prepared(tracker), query())
    told = np.array(result.info["shown_matches"])
    agrees = told[:, 4] == 1
    assert SHOWN_INLIERS == np.count_nonzero(agrees) <= result.info["inliers"]
    assert np.count_nonzero(~agrees) <= SHOWN_OTHERS
    depth = reference().depth
    assert depth is not None
    u, v = np.rint(told[:, :2]).astype(int).T
    rays, _ = PINHOLE.unproject(told[:, :2])
    points = rays / rays[:, 2:] * depth[v, u][:, None]
    seen, _ = PINHOLE.project(apply(T_QUERY_REF, points))
    apart = np.linalg.norm(seen - told[:, 2:4], axis=1)
    assert np.median(apart[agrees]) < 2.0
    assert len(info_text(result.info)) < INFO_CHARACTERS


def matches_of(points: Array, camera: Camera, pose: Array, outliers: int = 0, seed: int = 0) -> Matches2D3D:
    pixels, valid = camera.project(apply(pose, points))
    assert valid.all()
    rng = np.random.default_rng(seed)
    pixels[:outliers] = rng.uniform([0, 0], [camera.width, camera.height], (outliers, 2))
    return Matches2D3D(points, pixels, np.ones(len(points)), np.zeros_like(points))


@pytest.mark.parametrize("camera", [PINHOLE, RADTAN, FISHEYE], ids=lambda c: c.model)
def test_exact_points_give_the_exact_pose_despite_outliers(camera: Camera) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform([-1.5, -1.0, 4.0], [1.5, 1.0, 9.0], (120, 3))
    matches = matches_of(points, camera, T_QUERY_REF, outliers=60)
    start = ransac_pose(matches, camera, 2.0, 5000, 0.9999, seed=0)
    assert start is not None
    refined = refine_pose(start, matches, camera, 2.0)
    np.testing.assert_allclose(refined.T_query_ref, T_QUERY_REF, atol=1e-7)
    assert set(range(60, 120)) <= set(refined.inliers.tolist())
    assert refined.rms_px < 1e-4


@pytest.mark.thorough
def test_stated_uncertainty_agrees_with_the_scatter_of_the_poses() -> None:
    """The covariance of 60 poses from points with 0.5 px of noise, per axis within a factor of 1.5."""
    rng = np.random.default_rng(2)
    points = rng.uniform([-1.5, -1.0, 4.0], [1.5, 1.0, 9.0], (150, 3))
    exact = matches_of(points, PINHOLE, np.eye(4))
    translations, sigmas = [], []
    for _ in range(60):
        noisy = exact.pixels + rng.normal(0, 0.5, exact.pixels.shape)
        refined = refine_pose(np.eye(4), Matches2D3D(points, noisy, exact.scale, exact.depth_direction), PINHOLE, 4.0)
        translations.append(refined.T_query_ref[:3, 3])
        sigmas.append(np.sqrt(np.diag(refined.covariance)[:3]))
    ratio = np.std(translations, axis=0) / np.mean(sigmas, axis=0)
    assert np.all((ratio > 1 / 1.5) & (ratio < 1.5))


def test_uncertain_depth_counts_less() -> None:
    """Half of the points have depths wrong by a tenth; saying so more than halves the mean error of the pose."""
    told: list[float] = []
    untold: list[float] = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        points = rng.uniform([-1.5, -1.0, 4.0], [1.5, 1.0, 9.0], (200, 3))
        exact = matches_of(points, PINHOLE, T_QUERY_REF)
        wrong = points * np.where(np.arange(200) < 100, 1 + rng.normal(0, 0.1, 200), 1.0)[:, None]
        says_so = np.where(np.arange(200)[:, None] < 100, 0.1 * wrong, 0.0)
        for direction, error in ((says_so, told), (np.zeros_like(wrong), untold)):
            uncertain = Matches2D3D(wrong, exact.pixels, exact.scale, direction)
            pose = refine_pose(T_QUERY_REF, uncertain, PINHOLE, 50.0).T_query_ref
            error.append(float(np.linalg.norm(invert(pose)[:3, 3] - invert(T_QUERY_REF)[:3, 3])))
    assert np.mean(told) < 0.5 * np.mean(untold)


def test_points_on_a_line_do_not_hold_the_pose() -> None:
    points = np.linspace([-1.0, 0.0, 5.0], [1.0, 0.5, 9.0], 30)
    refined = refine_pose(T_QUERY_REF, matches_of(points, PINHOLE, T_QUERY_REF), PINHOLE, 2.0)
    assert not np.isfinite(refined.sigmas[0])


@pytest.mark.parametrize("points", [np.full((20, 3), [0.0, 0.0, 5.0]), np.full((3, 3), [0.0, 0.0, 5.0])])
def test_search_without_enough_geometry_finds_nothing(points: Array) -> None:
    assert ransac_pose(matches_of(points, PINHOLE, np.eye(4)), PINHOLE, 2.0, 200, 0.99, seed=0) is None


def test_depth_is_interpolated_on_a_surface_and_not_across_an_edge() -> None:
    depth = np.full((10, 12), 4.0, dtype=np.float32)
    depth[:, 6:] = 8.0
    depth[0, 0] = 0.0
    keyframe = Reference(
        "edge",
        0,
        np.zeros((10, 12), np.uint8),
        Camera("pinhole", 12, 10, 10, 10, 6, 5),
        depth=depth,
        depth_sigma=(0.0, 0.0, 0.01),
    )
    at = np.array([[2.3, 4.6], [5.4, 3.0], [5.6, 3.2], [0.2, 0.1], [-0.6, 2.0], [11.0, 9.0], [11.4, 9.4]])
    inverse, sigma = inverse_depth_at(keyframe, at, radius_px=2.0)
    np.testing.assert_allclose(inverse, [1 / 4, 1 / 4, 1 / 8, 1 / 4, 0, 1 / 8, 1 / 8])
    np.testing.assert_allclose(sigma, np.where(inverse > 0, 0.01, 0.0))  # c z^2 / z^2


def test_depth_of_a_slanted_plane_is_exact_between_pixels() -> None:
    keyframe = reference()
    uv = np.array([[60.3, 40.7], [400.5, 300.25]])
    rays, _ = PINHOLE.unproject(uv)
    expected = np.max(rays @ PLANES[:, :3].T / PLANES[:, 3], axis=-1)
    np.testing.assert_allclose(inverse_depth_at(keyframe, uv, 1.0)[0], expected, rtol=1e-6)


def test_sparse_depth_reaches_as_far_as_the_radius() -> None:
    points = KeyframePoints(np.array([[5.0, 5.0], [9.0, 5.0]]), np.array([0.5, 0.25]), np.array([0.01, 0.02]))
    camera = Camera("pinhole", 12, 10, 10, 10, 6, 5)
    keyframe = Reference("sparse", 0, np.zeros((10, 12), np.uint8), camera, sparse_points=points)
    inverse, sigma = inverse_depth_at(keyframe, np.array([[5.0, 6.0], [7.5, 5.0], [5.0, 7.1]]), radius_px=2.0)
    np.testing.assert_allclose(inverse, [0.5, 0.25, 0.0])
    np.testing.assert_allclose(sigma, [0.01, 0.02, 0.0])


def sparse_plane(spacing_px: float, noise: float = 0.0) -> tuple[Reference, Array]:
    """A keyframe of 640x480 pixels with points of a slanted plane on rings, and the plane's (rho_0, d/du, d/dv)."""
    rng = np.random.default_rng(0)
    rings = np.arange(40.0, 440.0, spacing_px)
    uv = np.concatenate([np.stack([np.arange(30.0, 610.0, 2.0), np.full(290, v)], axis=-1) for v in rings])
    plane = np.array([0.05, 1e-4, 2e-4])
    inverse = (plane[0] + uv @ plane[1:]) * (1 + noise * rng.normal(size=len(uv)))
    points = KeyframePoints(uv, inverse, np.full(len(uv), 1e-3))
    camera = Camera("pinhole", 640, 480, 400, 400, 320, 240)
    return Reference("rings", 0, np.zeros((480, 640), np.uint8), camera, sparse_points=points), plane


@pytest.mark.parametrize("spacing_px", [3.0, 6.0, 9.0])
def test_pixels_between_the_rings_of_a_lidar_lie_on_the_plane_of_its_points(spacing_px: float) -> None:
    keyframe, plane = sparse_plane(spacing_px)
    uv = np.random.default_rng(1).uniform([60, 60], [580, 400], (500, 2))
    inverse, sigma = inverse_depth_at(keyframe, uv)
    assert np.all(inverse > 0), "the default reaches all pixels between the rings"
    exact = plane[0] + uv @ plane[1:]
    error = np.abs(inverse / exact - 1)
    assert np.mean(error > 1e-6) < 0.1, "neighbours on one ring tell nothing across it"
    assert error.max() < 2e-4 * spacing_px / 0.05
    assert np.all(sigma == 1e-3)


def test_depth_is_not_interpolated_across_an_edge() -> None:
    uv = np.stack(np.meshgrid(np.arange(0.0, 40.0, 3.0), np.arange(0.0, 40.0, 3.0)), axis=-1).reshape(-1, 2)
    inverse = np.where(uv[:, 0] < 20, 0.5, 0.1)
    camera = Camera("pinhole", 640, 480, 400, 400, 320, 240)
    points = KeyframePoints(uv, inverse, np.full(len(uv), 0.01))
    keyframe = Reference("edge", 0, np.zeros((480, 640), np.uint8), camera, sparse_points=points)
    found, _ = inverse_depth_at(keyframe, np.random.default_rng(0).uniform(2, 36, (300, 2)))
    assert np.isin(np.round(found, 9), [0.5, 0.1]).all()


@pytest.mark.thorough
def test_the_reach_follows_the_density_of_the_map_and_the_size_of_the_image() -> None:
    rng = np.random.default_rng(0)
    dense, thin = (rng.uniform(0, 1900, (count, 2)) for count in (900_000, 20_000))
    assert reach_of(dense, (1936, 1936)) == pytest.approx(4.0, rel=0.1)
    assert 20 < reach_of(thin, (1936, 1936)) < 30
    assert reach_of(thin, (640, 480)) == 10.0
    assert reach_of(np.repeat(dense[:100], 500, axis=0), (1936, 1936)) >= 2.0


def features_at(uv: Array, response: Array, descriptors: Floats | None = None) -> Features:
    descriptors = np.zeros((len(uv), 4), np.float32) if descriptors is None else descriptors
    return Features(uv, np.ones(len(uv)), response, descriptors, (640, 480))


def test_every_cell_gives_its_strongest_before_any_gives_a_second() -> None:
    rng = np.random.default_rng(0)
    strong = rng.uniform(0, 32, (50, 2))
    weak = rng.uniform(0, 32, (3, 2)) + np.array([[32, 0], [0, 32], [64, 64]])
    uv, response = np.concatenate([strong, weak]), np.concatenate([np.linspace(9, 5, 50), [3.0, 2.0, 1.0]])
    chosen = spread_evenly(features_at(uv, response), cell_px=32, budget=6)
    np.testing.assert_array_equal(chosen, [0, 1, 2, 50, 51, 52])


def test_matching_is_distinctive_mutual_and_one_to_one() -> None:
    first = np.array([[0, 0, 0, 0], [9, 0, 0, 0], [5, 5, 0, 0], [0, 0, 8, 0]], dtype=np.float32)
    second = np.array([[0, 0, 8, 1], [0, 1, 0, 0], [5, 4, 0, 0], [5, 6, 0, 0]], dtype=np.float32)
    a, b = (features_at(np.zeros((4, 2)), np.zeros(4), d) for d in (first, second))
    # 2 has two equally near neighbours; 1's nearest prefers 2.
    assert {tuple(p) for p in match(a, b, ratio=0.8, mutual=True).tolist()} == {(0, 1), (3, 0)}
    every = match(a, b, ratio=1.0, mutual=False)
    assert len(np.unique(every[:, 1])) == len(every)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["orb", "sift"])
def test_keypoints_have_no_bias_towards_a_corner(kind: str) -> None:
    """Rotating an image by half a turn maps (u, v) to (W-1-u, H-1-v): so it must the keypoints of every scale."""
    image = np.ascontiguousarray(texture()[:480, :640])
    turned = np.ascontiguousarray(image[::-1, ::-1])
    a, b = detect(image, kind, 1000), detect(turned, kind, 1000)  # type: ignore[arg-type]
    pairs = match(a, b, ratio=0.8, mutual=True)
    assert len(pairs) > 300
    difference = [639, 479] - b.uv[pairs[:, 1]] - a.uv[pairs[:, 0]]
    for low, high in ((1.0, 1.5), (1.5, 2.5), (2.5, 4.0)):
        level = (a.scale[pairs[:, 0]] >= low) & (a.scale[pairs[:, 0]] < high)
        assert level.sum() > 20
        assert np.abs(np.median(difference[level], axis=0)).max() < 0.25
