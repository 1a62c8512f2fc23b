"""Images and calibrations of cameras: sensor_msgs Image, CompressedImage and CameraInfo.

The models of CameraInfo are those of OpenCV: ``plumb_bob`` and ``rational_polynomial`` are the radial-tangential model
with 5 and 8 coefficients in the same order, ``equidistant`` is the fisheye model of Kannala and Brandt.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Image
from relocbench.datasets.core import images
from relocbench.datasets.core.image_header import MOST_PIXELS
from relocbench.datasets.importers.rosbag import kinds
from relocbench.errors import quoted
from relocbench.geometry import Camera, is_rotation

_BAYER = {
    "bayer_rggb": cv2.COLOR_BayerRGGB2RGB,
    "bayer_bggr": cv2.COLOR_BayerBGGR2RGB,
    "bayer_gbrg": cv2.COLOR_BayerGBRG2RGB,
    "bayer_grbg": cv2.COLOR_BayerGRBG2RGB,
}
"""names give the colours of the first two rows, as OpenCV's names of these constants do"""
_PLAIN: dict[str, tuple[int, int, int | None]] = {
    "mono8": (1, 1, None),
    "8UC1": (1, 1, None),
    "mono16": (1, 2, None),
    "rgb8": (3, 1, None),
    "bgr8": (3, 1, cv2.COLOR_BGR2RGB),
    "8UC3": (3, 1, cv2.COLOR_BGR2RGB),
    "rgba8": (4, 1, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, 1, cv2.COLOR_BGRA2RGB),
    "8UC4": (4, 1, cv2.COLOR_BGRA2RGB),
    "rgb16": (3, 2, None),
    "bgr16": (3, 2, cv2.COLOR_BGR2RGB),
    "yuv422": (2, 1, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (2, 1, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (2, 1, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": (2, 1, cv2.COLOR_YUV2RGB_YUY2),
    **{f"{name}8": (1, 1, code) for name, code in _BAYER.items()},
    **{f"{name}16": (1, 2, code) for name, code in _BAYER.items()},
}
"""encoding -> channels, bytes a channel, conversion to RGB (sensor_msgs/image_encodings.hpp)"""
ENCODINGS = tuple(_PLAIN)
_FISHEYE = ("equidistant", "fisheye", "kannala_brandt", "kannala_brandt4", "kb4", "opencv_fisheye")
"""names of the model of Kannala and Brandt with four coefficients"""
_MOST_DISTORTION = 1e6


def image_of(kind: str, message: Any, path: Path) -> Image:
    """The picture in an Image or CompressedImage, (H, W) grey or (H, W, 3) RGB.

    Raises:
        ValueError, DatasetError: the encoding is not read, or the message is damaged.
    """
    return _compressed(message, path) if kind == kinds.COMPRESSED else _plain(message)


def _plain(message: Any) -> Image:
    encoding, height, width = str(message.encoding), int(message.height), int(message.width)
    if encoding not in _PLAIN:
        raise ValueError(f"encoding {quoted(encoding, 30)} is not read; available: {', '.join(ENCODINGS)}")
    if not 0 < height * width <= MOST_PIXELS:
        raise ValueError(f"an image of {width}x{height} pixels cannot be read")
    channels, size, code = _PLAIN[encoding]
    data = np.ascontiguousarray(np.asarray(message.data, dtype=np.uint8))
    row, step = width * channels * size, int(message.step) or width * channels * size
    if step < row or len(data) < (height - 1) * step + row:
        raise ValueError(f"{len(data)} bytes in rows of {step} are not an image of {width}x{height} in {encoding}")
    pixels: NDArray[Any] = np.ndarray((height, row), np.uint8, data, 0, (step, 1))
    if size == 2:
        # The upper byte, as for PNG files of 16 bits.
        pixels = pixels[:, 0 if message.is_bigendian else 1 :: 2]
    pixels = np.ascontiguousarray(pixels)
    if channels > 1:
        pixels = pixels.reshape(height, width, channels)
    return _converted(pixels, code)


def _converted(pixels: NDArray[Any], code: int | None) -> Image:
    try:
        return np.asarray(pixels if code is None else cv2.cvtColor(pixels, code), dtype=np.uint8)
    except cv2.error:  # mosaics and YUV 4:2:2 of odd or tiny sizes
        raise ValueError(f"an image of {pixels.shape[1]}x{pixels.shape[0]} pixels has no colours") from None


def _compressed(message: Any, path: Path) -> Image:
    # Drivers compress what cv::imencode takes, which is BGR, whatever the encoding before it was.
    image = images.as_8_bit(images.decode_image(np.asarray(message.data, dtype=np.uint8).tobytes(), path), path)
    bayer = next((code for name, code in _BAYER.items() if str(message.format).startswith(name)), None)
    return image if image.ndim == 3 else _converted(image, bayer)


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera by its CameraInfo, for images of one topic."""

    camera: Camera
    R_optical_camera: Array
    """(3, 3) from the axes of the images to those of the optical frame, other than the identity if they are
    rectified"""


def calibration_of(info: Any, size: tuple[int, int], rectified: bool) -> Calibration:
    """The camera that took images of a size.

    Args:
        info: an object with the fields of ``sensor_msgs/CameraInfo`` of ROS 1 or 2.
        rectified: images are rectified, so that P applies instead of K and the distortion.

    Raises:
        ValueError: the camera is not calibrated, its camera model is unsupported, or the images have another size.
    """
    K, P = _numbers(info, "k").reshape(3, 3), _numbers(info, "p").reshape(3, 4)
    matrix = P[:, :3] if rectified else K
    if not np.isfinite(matrix).all() or matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise ValueError(f"CameraInfo is not calibrated ({'P' if rectified else 'K'} has no focal length)")
    fx, fy, cx, cy = (float(v) for v in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))
    full = int(info.width), int(info.height)
    bins = max(int(info.binning_x), 1), max(int(info.binning_y), 1)
    roi = info.roi
    cut = int(roi.width) or full[0], int(roi.height) or full[1]
    if size == (cut[0] // bins[0], cut[1] // bins[1]):
        # As in image_geometry: first the region of interest, then the binning, which takes corners to corners here.
        cx, cy = cx - int(roi.x_offset), cy - int(roi.y_offset)
        fx, fy = fx / bins[0], fy / bins[1]
        cx, cy = (cx + 0.5) / bins[0] - 0.5, (cy + 0.5) / bins[1] - 0.5
    elif size != full:
        raise ValueError(f"images are {size[0]}x{size[1]}, but CameraInfo is of {full[0]}x{full[1]}")
    model, distortion = ("pinhole", ()) if rectified else _distortion(info)
    camera = Camera(model, *size, fx, fy, cx, cy, distortion)  # type: ignore[arg-type]
    R = _numbers(info, "r").reshape(3, 3) if rectified else np.eye(3)
    if not R.any():
        R = np.eye(3)
    if not is_rotation(R, 1e-3):
        raise ValueError("R of CameraInfo is not a rotation")
    return Calibration(camera, R.T)


def _numbers(info: Any, name: str) -> Array:
    """An array of CameraInfo, whose names ROS 1 writes in capitals."""
    values = getattr(info, name, None)
    return np.asarray(getattr(info, name.upper()) if values is None else values, dtype=np.float64)


def _distortion(info: Any) -> tuple[str, tuple[float, ...]]:
    told, values = str(info.distortion_model), tuple(_numbers(info, "d").tolist())
    name = told.lower()
    if any(not abs(value) < _MOST_DISTORTION for value in values):
        raise ValueError(f"distortion coefficients {values} are beyond those of any lens")
    if not any(values) and name in ("", "none", "pinhole", "plumb_bob", "rational_polynomial"):
        return "pinhole", ()
    if name in ("plumb_bob", "radtan") and len(values) in (4, 5):
        return "radtan", values
    if name == "rational_polynomial" and len(values) >= 8 and not any(values[8:]):
        return "radtan", values[:8]
    if name in _FISHEYE and len(values) >= 4 and not any(values[4:]):
        return "equidistant", values[:4]
    raise ValueError(
        f"distortion model {quoted(told, 30)} with {len(values)} coefficients is not read; expected plumb_bob (4 or "
        "5), rational_polynomial (8) or equidistant (4)"
    )
