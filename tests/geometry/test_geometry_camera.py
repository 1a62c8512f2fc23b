"""Cameras: projection and its inverse, agreement with OpenCV, and what cannot be seen."""

from __future__ import annotations

import pickle

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from relocbench.arrays import Array
from relocbench.geometry import Camera, camera_from_dict

PINHOLE = Camera("pinhole", 640, 480, 517.3, 516.5, 318.6, 255.3)
# TUM RGB-D freiburg1 (Sturm et al., IROS 2012)
FREIBURG_1 = Camera("radtan", 640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633))
BARREL = Camera("radtan", 1392, 512, 984.2, 980.8, 690.0, 233.2, (-0.37, 0.2, 0.001, 0.0002))
RATIONAL = Camera("radtan", 1280, 720, 610.0, 610.0, 640.0, 365.0, (0.6, -2.6, 5e-4, -1e-4, 1.5, 0.5, -2.4, 1.4))
FISHEYE = Camera("equidistant", 848, 800, 286.0, 285.5, 420.0, 400.0, (-0.0066, 0.0436, -0.0416, 0.0075))
NARROW_FISHEYE = Camera("equidistant", 752, 480, 458.0, 457.0, 367.0, 248.0, (-0.013, 0.02, -0.013, 0.003))
MODELS = [PINHOLE, FREIBURG_1, BARREL, RATIONAL, FISHEYE, NARROW_FISHEYE]
NAMES = ["pinhole", "freiburg1", "barrel", "rational", "fisheye", "narrow-fisheye"]
EVERY_CAMERA = pytest.mark.parametrize("camera", MODELS, ids=NAMES)
UNIT = st.floats(0, 1)


def pixel_grid(camera: Camera, steps: int = 41) -> Array:
    """(steps^2, 2) pixels from edge to edge."""
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, steps), np.linspace(0, camera.height - 1, steps))
    return np.stack([u.ravel(), v.ravel()], axis=-1)


def visible_points(camera: Camera, seed: int = 0) -> Array:
    """(N, 3) points in front of the camera that fall on its image, 1 to 50 m away."""
    rays, valid = camera.unproject(pixel_grid(camera))
    rays = rays[valid & (rays[:, 2] > 0.2)]
    return rays * np.random.default_rng(seed).uniform(1, 50, (len(rays), 1))


@EVERY_CAMERA
@given(u=UNIT, v=UNIT, distance=st.floats(0.01, 1e4))
def test_projecting_a_ray_gives_back_its_pixel(camera: Camera, u: float, v: float, distance: float) -> None:
    pixel = np.array([u * (camera.width - 1), v * (camera.height - 1)])
    ray, valid = camera.unproject(pixel)
    assert valid
    back, seen = camera.project(ray * distance)
    assert seen
    np.testing.assert_allclose(back, pixel, atol=1e-8)


@EVERY_CAMERA
def test_unprojecting_a_projection_gives_back_the_direction(camera: Camera) -> None:
    points = visible_points(camera)
    pixels, seen = camera.project(points)
    rays, valid = camera.unproject(pixels)
    assert seen.all()
    assert valid.all()
    np.testing.assert_allclose(
        rays / np.linalg.norm(rays, axis=-1, keepdims=True),
        points / np.linalg.norm(points, axis=-1, keepdims=True),
        atol=1e-11,
    )


@EVERY_CAMERA
def test_rays_have_unit_depth(camera: Camera) -> None:
    rays, valid = camera.unproject(pixel_grid(camera))
    forward = valid & (rays[:, 2] > 1e-3)
    np.testing.assert_allclose(rays[forward, 2], 1.0, atol=1e-12)


@EVERY_CAMERA
def test_the_principal_point_looks_along_the_axis(camera: Camera) -> None:
    ray, valid = camera.unproject([camera.cx, camera.cy])
    assert valid
    np.testing.assert_allclose(ray, [0, 0, 1], atol=1e-15)
    pixel, seen = camera.project([0, 0, 7.0])
    assert seen
    np.testing.assert_allclose(pixel, [camera.cx, camera.cy], atol=1e-12)


@pytest.mark.parametrize("camera", [PINHOLE, FREIBURG_1, BARREL, RATIONAL], ids=NAMES[:4])
def test_projection_agrees_with_opencv(camera: Camera) -> None:
    points = visible_points(camera)
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion))
    pixels, seen = camera.project(points)
    assert seen.all()
    np.testing.assert_allclose(pixels, expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("camera", [FISHEYE, NARROW_FISHEYE], ids=NAMES[4:])
def test_fisheye_projection_agrees_with_opencv(camera: Camera) -> None:
    points = visible_points(camera)
    expected, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion)
    )
    pixels, seen = camera.project(points)
    assert seen.all()
    np.testing.assert_allclose(pixels, expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("camera", [FREIBURG_1, BARREL, RATIONAL], ids=NAMES[1:4])
def test_undistortion_agrees_with_opencv(camera: Camera) -> None:
    pixels = pixel_grid(camera)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 1000, 1e-14)
    # OpenCV iterates a fixed point, which does not always arrive near the corners: compare where it did.
    expected = cv2.undistortPoints(
        pixels[:, None], camera.matrix, np.array(camera.distortion), None, None, camera.matrix, criteria
    )[:, 0]
    ahead = np.concatenate([(expected - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones((len(pixels), 1))], 1)
    there, _ = cv2.projectPoints(ahead, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion))
    arrived = np.linalg.norm(there[:, 0] - pixels, axis=-1) < 1e-9
    assert arrived.mean() > 0.8
    found, valid = camera.undistort(pixels)
    assert valid[arrived].all()
    np.testing.assert_allclose(found[arrived], expected[arrived], atol=1e-6)


@pytest.mark.parametrize("camera", [FREIBURG_1, BARREL, RATIONAL], ids=NAMES[1:4])
def test_undistortion_map_agrees_with_opencv(camera: Camera) -> None:
    target = camera.pinhole()
    u, v = camera.undistortion_map()
    expected_u, expected_v = cv2.initUndistortRectifyMap(
        camera.matrix, np.array(camera.distortion), np.eye(3), target.matrix, target.size, cv2.CV_32FC1
    )
    assert u.shape == (camera.height, camera.width)
    assert u.dtype == v.dtype == np.float32
    seen = u > -1e4
    assert seen.mean() > 0.95  # OpenCV folds where nothing is seen
    np.testing.assert_allclose(u[seen], expected_u[seen], atol=1e-3)
    np.testing.assert_allclose(v[seen], expected_v[seen], atol=1e-3)


def test_fisheye_undistortion_map_agrees_with_opencv() -> None:
    target = Camera("pinhole", 320, 240, 150.0, 150.0, 160.0, 120.0)
    u, v = FISHEYE.undistortion_map(target)
    expected_u, expected_v = cv2.fisheye.initUndistortRectifyMap(
        FISHEYE.matrix, np.array(FISHEYE.distortion), np.eye(3), target.matrix, target.size, cv2.CV_32FC1
    )
    np.testing.assert_allclose(u, expected_u, atol=1e-3)
    np.testing.assert_allclose(v, expected_v, atol=1e-3)


@pytest.mark.parametrize("camera", [PINHOLE, FREIBURG_1, BARREL, RATIONAL], ids=NAMES[:4])
@given(x=st.floats(-10, 10), y=st.floats(-10, 10), z=st.floats(-1e3, 0))
def test_nothing_behind_the_camera_is_seen(camera: Camera, x: float, y: float, z: float) -> None:
    pixels, valid = camera.project([x, y, z])
    assert not valid
    assert np.isnan(pixels).all()


def test_a_wide_fisheye_sees_behind_the_plane_of_its_lens_but_not_straight_back() -> None:
    wide = Camera("equidistant", 800, 800, 200.0, 200.0, 400.0, 400.0, (0.0, 0.0, 0.0, 0.0))
    pixel, valid = wide.project([1.0, 0.0, -0.2])
    assert valid
    np.testing.assert_allclose(pixel, [400 + 200 * np.arctan2(1.0, -0.2), 400])
    ray, valid = wide.unproject(pixel)
    assert valid
    np.testing.assert_allclose(ray, np.array([1.0, 0.0, -0.2]) / np.hypot(1.0, 0.2), atol=1e-12)
    assert not wide.project([0.0, 0.0, -1.0])[1]


@pytest.mark.parametrize(
    "distortion",
    [
        (-0.4, 0.0, 0.0, 0.0),  # folds at r^2 = 1/1.2
        (-0.5, 0.1, 0.0, 0.0),  # folds at r^2 = 1 and turns outwards again at r^2 = 2
        (-0.5, 0.1, 0.001, -0.001),
        (-0.1, -0.05, 0.0, 0.0, 0.015),
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.4, 0.0, 0.0),  # rational: r / (1 + 0.4 r^2) folds at r^2 = 2.5
        (0.0, 0.0, 0.0, 0.0, 0.0, -0.4, 0.0, 0.0),  # rational: a pole at r^2 = 2.5
    ],
)
def test_points_beyond_the_fold_of_the_distortion_are_not_seen(distortion: tuple[float, ...]) -> None:
    """Every point that is seen is the one that its pixel looks at."""
    camera = Camera("radtan", 640, 480, 300.0, 300.0, 320.0, 240.0, distortion)
    angles = np.linspace(0, 2 * np.pi, 25)[:-1]
    radii = np.linspace(0, 4, 401)[1:]
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    points = np.concatenate([radii[:, None, None] * circle, np.ones((400, 24, 1))], axis=-1)
    pixels, seen = camera.project(points)
    assert seen[radii < 0.8].all()
    assert np.isnan(pixels[~seen]).all()
    # Once a direction has left the image it does not come back.
    assert np.all(np.diff(seen.astype(int), axis=0) <= 0)
    rays, valid = camera.unproject(pixels[seen])
    clear = np.linalg.norm(points[seen][:, :2], axis=-1) < 0.95 * radii[seen.sum(axis=0).min() - 1]
    assert valid[clear].all()
    np.testing.assert_allclose(rays[clear], points[seen][clear], atol=1e-6)


def test_fisheye_angles_beyond_the_fold_are_not_seen() -> None:
    """theta (1 - 0.2 theta^2 + 0.015 theta^4) turns back at theta = 1.54 and outwards again at 2.38."""
    camera = Camera("equidistant", 640, 480, 200.0, 200.0, 320.0, 240.0, (-0.2, 0.015, 0.0, 0.0))
    theta = np.linspace(0.01, 3.1, 400)
    points = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)
    _, seen = camera.project(points)
    fold = np.sqrt(min(np.roots([5 * 0.015, -3 * 0.2, 1.0])))
    np.testing.assert_array_equal(seen, theta < fold)


@pytest.mark.parametrize("camera", [BARREL, FISHEYE], ids=["barrel", "fisheye"])
def test_pixels_that_no_ray_reaches_are_nan(camera: Camera) -> None:
    folded = Camera(camera.model, 640, 480, 300.0, 300.0, 320.0, 240.0, (-0.4, 0.0, 0.0, 0.0))
    rays, valid = folded.unproject([[320.0 + 300 * 5, 240.0], [330.0, 240.0]])
    np.testing.assert_array_equal(valid, [False, True])
    assert np.isnan(rays[0]).all()


@EVERY_CAMERA
def test_not_a_number_in_is_not_valid_and_not_a_number_out(camera: Camera) -> None:
    for bad in (np.nan, np.inf, -np.inf):
        rays, valid = camera.unproject([[bad, 100.0], [camera.cx + 10, camera.cy]])
        np.testing.assert_array_equal(valid, [False, True])
        assert not np.isfinite(rays[0]).all()
        pixels, seen = camera.project([[bad, 0.0, 1.0], [0.0, bad, 1.0], [0.1, 0.1, 1.0]])
        np.testing.assert_array_equal(seen, [False, False, True])
        assert np.isnan(pixels[:2]).all()
    assert not camera.project([np.nan, np.nan, np.nan])[1]
    assert not camera.project([0.0, 0.0, np.nan])[1]


@EVERY_CAMERA
def test_leading_dimensions_are_kept(camera: Camera) -> None:
    points = visible_points(camera)[:60].reshape(3, 4, 5, 3)
    pixels, valid = camera.project(points)
    assert pixels.shape == (3, 4, 5, 2)
    assert valid.shape == (3, 4, 5)
    single, _ = camera.project(points[1, 2, 3])
    np.testing.assert_allclose(single, pixels[1, 2, 3], atol=1e-12)
    rays, valid = camera.unproject(pixels)
    assert rays.shape == (3, 4, 5, 3)
    assert camera.unproject(np.zeros((0, 2)))[0].shape == (0, 3)
    assert camera.project(np.zeros((0, 3)))[0].shape == (0, 2)


@EVERY_CAMERA
@given(factor=st.sampled_from([0.125, 0.25, 0.5, 2.0]))
def test_scaled_camera_sees_the_resized_image(camera: Camera, factor: float) -> None:
    points = visible_points(camera)
    small = camera.scaled(factor)
    assert small.size == (round(camera.width * factor), round(camera.height * factor))
    pixels, resized = camera.project(points)[0], small.project(points)[0]
    np.testing.assert_allclose((resized + 0.5) / factor - 0.5, pixels, atol=1e-9)


def test_scaled_camera_agrees_with_area_averaging() -> None:
    """The mean of a 2x2 block of a ramp is the ramp at the block's centre, which halving calls pixel (u, v)."""
    u, v = np.meshgrid(np.arange(64.0), np.arange(48.0))
    camera = Camera("pinhole", 64, 48, 50.0, 50.0, 31.5, 23.5)
    halved = cv2.resize(np.stack([u, v], axis=-1), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    direction = camera.unproject(halved[10, 20])[0]
    np.testing.assert_allclose(camera.scaled(0.5).project(direction)[0], [20, 10], atol=1e-12)


def test_image_border_is_the_outermost_pixel_centre() -> None:
    corners = np.array([[0, 0], [639, 479], [639.01, 479], [0, -0.01], [np.nan, 5]], dtype=np.float64)
    np.testing.assert_array_equal(PINHOLE.contains(corners), [True, True, False, False, False])
    np.testing.assert_array_equal(PINHOLE.contains(np.array([[3, 3], [2.9, 3]]), border=3), [True, False])


@EVERY_CAMERA
def test_dictionary_and_pickle_hold_the_camera(camera: Camera) -> None:
    camera.project([0.1, 0.1, 1.0])
    assert camera_from_dict(camera.to_dict()) == camera
    assert pickle.loads(pickle.dumps(camera)) == camera
    assert hash(camera) == hash(camera_from_dict(camera.to_dict()))


@pytest.mark.parametrize(
    ("model", "change", "data"),
    [
        ("thin-prism", {}, "pinhole.*radtan.*equidistant"),
        ("pinhole", {"width": 0}, "positive"),
        ("pinhole", {"fx": -1.0}, "positive"),
        ("pinhole", {"cy": float("nan")}, "finite"),
        ("pinhole", {"distortion": [0.1]}, r"\b0\b"),
        ("radtan", {"distortion": [0.1, 0.2, 0.3]}, r"\b4\b.*\b5\b.*\b8\b"),
        ("equidistant", {}, r"\b4\b"),
    ],
)
def test_impossible_cameras_are_refused(model: str, change: dict[str, object], data: str) -> None:
    values: dict[str, object] = {"model": model, "width": 64, "height": 48, "fx": 50, "fy": 50, "cx": 32, "cy": 24}
    with pytest.raises(ValueError, match=data):
        camera_from_dict(values | change)
