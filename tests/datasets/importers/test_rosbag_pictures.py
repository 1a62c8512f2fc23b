"""Images and calibrations in the messages of ROS."""

from __future__ import annotations

import contextlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import ErrorData, refused

from relocbench.datasets.importers.rosbag import kinds
from relocbench.datasets.importers.rosbag.pictures import ENCODINGS, calibration_of, image_of
from relocbench.errors import DatasetError

RNG = np.random.default_rng(0)
RGB = RNG.integers(0, 256, (6, 8, 3), dtype=np.uint8)
GREY = RNG.integers(0, 256, (6, 8), dtype=np.uint8)
HERE = Path("drive.bag")


def plain(pixels: Any, encoding: str, **changes: Any) -> SimpleNamespace:
    height, width = pixels.shape[:2]
    data = np.frombuffer(np.ascontiguousarray(pixels).tobytes(), np.uint8)
    values = {"height": height, "width": width, "encoding": encoding, "is_bigendian": 0, "step": len(data) // height}
    return SimpleNamespace(**(values | {"data": data} | changes))


def mosaic(rgb: Any, colours: str) -> Any:
    out = np.empty(rgb.shape[:2], np.uint8)
    for k, colour in enumerate(colours):
        out[k // 2 :: 2, k % 2 :: 2] = rgb[k // 2 :: 2, k % 2 :: 2, "rgb".index(colour)]
    return out


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (plain(RGB, "rgb8"), RGB),
        (plain(RGB[..., ::-1], "bgr8"), RGB),
        (plain(np.dstack([RGB, GREY]), "rgba8"), RGB),
        (plain(np.dstack([RGB[..., ::-1], GREY]), "bgra8"), RGB),
        (plain(GREY, "mono8"), GREY),
        (plain(GREY.astype("<u2") * 256 + 7, "mono16"), GREY),
        (plain((GREY.astype("<u2") * 256 + 7).astype(">u2"), "mono16", is_bigendian=1), GREY),
        (plain(RGB.astype("<u2") * 256, "rgb16"), RGB),
    ],
)
def test_encodings_give_grey_or_rgb(message: SimpleNamespace, expected: Any) -> None:
    assert np.array_equal(image_of(kinds.IMAGE, message, HERE), expected)


def test_rows_may_be_longer_than_their_pixels() -> None:
    padded = np.hstack([RGB.reshape(6, 24), np.zeros((6, 5), np.uint8)])
    message = plain(padded, "rgb8", width=8, step=29)
    assert np.array_equal(image_of(kinds.IMAGE, message, HERE), RGB)


@pytest.mark.parametrize("colours", ["rggb", "bggr", "gbrg", "grbg"])
def test_mosaics_of_a_smooth_picture_get_its_colours_back(colours: str) -> None:
    picture = np.empty((16, 16, 3), np.uint8)
    picture[:] = (200, 90, 20)
    found = image_of(kinds.IMAGE, plain(mosaic(picture, colours), f"bayer_{colours}8"), HERE)
    assert np.abs(found[2:-2, 2:-2].astype(int) - (200, 90, 20)).max() <= 1
    data = cv2.imencode(".png", mosaic(picture, colours))[1]
    packed = SimpleNamespace(format=f"bayer_{colours}8; png compressed bayer_{colours}8", data=data.ravel())
    found = image_of(kinds.COMPRESSED, packed, HERE)
    assert np.abs(found[2:-2, 2:-2].astype(int) - (200, 90, 20)).max() <= 1


def test_compressed_images_are_rgb_whatever_they_were_before() -> None:
    for told in ("png", "bgr8; png compressed bgr8", "rgb8; png compressed bgr8"):
        message = SimpleNamespace(format=told, data=cv2.imencode(".png", RGB[..., ::-1])[1].ravel())
        assert np.array_equal(image_of(kinds.COMPRESSED, message, HERE), RGB)


@pytest.mark.parametrize(
    ("message", "complaint"),
    [
        (plain(RGB, "32FC1"), ("", None, "32FC1", "mono8")),
        (plain(RGB, "rgb8", height=7), ("", None, "8x7", "rgb8")),
        (plain(RGB, "rgb8", step=3), ("", None, "8x6")),
        (plain(RGB, "rgb8", width=0), ("", None, "0x6")),
        (plain(RGB, "rgb8", width=2**31, height=2**31), ()),
    ],
)
def test_images_that_cannot_be_read_are_told(message: SimpleNamespace, complaint: ErrorData) -> None:
    with refused(ValueError, *complaint):
        image_of(kinds.IMAGE, message, HERE)


def test_a_damaged_compressed_image_is_told() -> None:
    data = cv2.imencode(".png", RGB)[1].ravel()
    for damaged in (data[:20], data[:-30], np.zeros(0, np.uint8), np.arange(100, dtype=np.uint8)):
        with pytest.raises((DatasetError, ValueError)):
            image_of(kinds.COMPRESSED, SimpleNamespace(format="png", data=damaged), HERE)


@given(
    st.integers(0, 40), st.integers(0, 40), st.integers(0, 200), st.sampled_from(ENCODINGS), st.integers(0, 900),
    st.integers(0, 1),
)  # fmt: skip
def test_no_sizes_make_an_image_from_beyond_the_end_of_the_data(
    height: int, width: int, step: int, encoding: str, count: int, big: int
) -> None:
    message = plain(np.zeros((1, 1), np.uint8), encoding, height=height, width=width, step=step, is_bigendian=big)
    message.data = np.zeros(count, np.uint8)
    with contextlib.suppress(ValueError):
        assert image_of(kinds.IMAGE, message, HERE).shape[:2] == (height, width)


def info(**changes: Any) -> SimpleNamespace:
    """CameraInfo of ROS 2, for images of 64x48."""
    K = [50.0, 0, 31.0, 0, 51.0, 23.0, 0, 0, 1]
    P = [40.0, 0, 30.0, 0, 0, 41.0, 22.0, 0, 0, 0, 1, 0]
    region = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0, do_rectify=False)
    values = {"width": 64, "height": 48, "distortion_model": "plumb_bob", "d": [0.1, 0.01, 0.001, 0.002, 0.003],
              "k": K, "p": P, "r": np.eye(3).ravel(), "binning_x": 0, "binning_y": 0, "roi": region}  # fmt: skip
    return SimpleNamespace(**(values | changes))


@pytest.mark.parametrize(
    ("model", "coefficients", "expected"),
    [
        ("plumb_bob", (0.1, 0.01, 0.001, 0.002, 0.003), ("radtan", 5)),
        ("plumb_bob", (0.1, 0.01, 0.001, 0.002), ("radtan", 4)),
        ("plumb_bob", (0, 0, 0, 0, 0), ("pinhole", 0)),
        ("", (), ("pinhole", 0)),
        ("rational_polynomial", (0.1, 0.01, 0.001, 0.002, 0.003, 0.2, 0.02, 0.002), ("radtan", 8)),
        ("rational_polynomial", (0.1, 0.01, 0.001, 0.002, 0.003, 0.2, 0.02, 0.002, 0, 0, 0, 0), ("radtan", 8)),
        ("equidistant", (0.1, 0.01, 0.001, 0.002), ("equidistant", 4)),
        ("fisheye", (0.1, 0.01, 0.001, 0.002), ("equidistant", 4)),
    ],
)
def test_models_are_those_of_opencv(model: str, coefficients: tuple[float, ...], expected: tuple[str, int]) -> None:
    camera = calibration_of(info(distortion_model=model, d=coefficients), (64, 48), rectified=False).camera
    assert (camera.model, len(camera.distortion)) == expected
    point = np.array([0.3, -0.2, 1.0])
    K, D = camera.matrix, np.array(coefficients, dtype=np.float64)
    if expected[0] == "equidistant":
        there = cv2.fisheye.projectPoints(point[None, None], np.zeros(3), np.zeros(3), K, D)[0]
    else:
        there = cv2.projectPoints(point[None], np.zeros(3), np.zeros(3), K, D if len(D) else None)[0]
    assert np.allclose(camera.project(point)[0], there.ravel(), atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"distortion_model": "thin_prism"}, ("", None, "thin_prism", "5", "plumb_bob")),
        ({"distortion_model": "rational_polynomial", "d": [0.1] * 12}, ("", None, "12")),
        ({"distortion_model": "ds", "d": [0, 0]}, ("", None, "ds", "2")),
        ({"k": [0.0] * 9}, ()),
        ({"width": 640, "height": 480}, ("", None, "64x48", "640x480")),
    ],
)
def test_calibrations_that_cannot_be_used_are_told(changes: dict[str, Any], complaint: ErrorData) -> None:
    with refused(ValueError, *complaint):
        calibration_of(info(**changes), (64, 48), rectified=False)


def test_names_in_capitals_are_those_of_ros_1() -> None:
    there = info()
    old = SimpleNamespace(**{k: v for k, v in vars(there).items() if k not in "dkpr"})
    old.D, old.K, old.P, old.R = there.d, there.k, there.p, there.r
    assert calibration_of(old, (64, 48), False).camera == calibration_of(there, (64, 48), False).camera


def test_rectified_images_have_the_camera_of_p_and_are_turned_by_r() -> None:
    turn = cv2.Rodrigues(np.array([0.02, -0.01, 0.03]))[0]
    found = calibration_of(info(r=turn.ravel()), (64, 48), rectified=True)
    assert found.camera.model == "pinhole"
    assert (found.camera.fx, found.camera.cy) == (40.0, 22.0)
    # R maps points from the axes of the optical frame to those of the rectified image.
    assert np.allclose(found.R_optical_camera @ turn, np.eye(3))


def test_binned_and_cropped_images_see_what_the_full_image_saw_there() -> None:
    region = SimpleNamespace(x_offset=16, y_offset=8, width=32, height=32, do_rectify=False)
    there = info(d=[0] * 5)
    full = calibration_of(there, (64, 48), False).camera
    cropped = calibration_of(info(d=[0] * 5, roi=region, binning_x=2, binning_y=2), (16, 16), False).camera
    point = np.array([0.05, -0.03, 1.0])
    at = np.asarray(full.project(point)[0]) - (16, 8)
    assert np.allclose(cropped.project(point)[0], (at + 0.5) / 2 - 0.5)
