"""Image pyramids that store gradients beside values, as direct alignment and the matching of pixels read them.

A level's map is (H, W, 3 D) float32: at each pixel the D values, then the D derivatives along x, then those along y.
Bilinear interpolation therefore reads each of the four pixels as one contiguous run. An intensity image has D = 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array, Floats, Image
from relocbench.errors import MethodError
from relocbench.geometry import Camera
from relocbench.kernels import njit

Map = Floats

SMALLEST_AREA = 5000
"""pixels; a level of this area or less is the coarsest one (DSO)"""


@dataclass(frozen=True, eq=False)
class Level:
    """The map and the pinhole camera of one pyramid level."""

    map: Map
    """(H, W, 3 D) values, x derivatives, y derivatives"""
    camera: Camera

    @property
    def channels(self) -> int:
        """D, the number of channels."""
        return int(self.map.shape[2] // 3)


def level_camera(camera: Camera, level: int) -> Camera:
    """The camera of pyramid level ``level``: f / 2^l and (c + 0.5) / 2^l - 0.5 (pixel centres at integers)."""
    width, height = camera.width >> level, camera.height >> level
    return replace(camera.scaled(1.0 / (1 << level)), width=width, height=height)


def camera_intrinsics(camera: Camera) -> Array:
    """The intrinsics fx, fy, cx, cy (4,) of a pinhole camera, pixels."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float64)


def image_pyramid(image: Image, camera: Camera, max_levels: int = 6) -> list[Level]:
    """Intensity pyramid, finest level first.

    Levels are halved while they have more than 5000 pixels. DSO also stops at odd sizes, since its images are cropped
    to a multiple of 16; here an odd last row or column is left out of the next level instead, which does not change the
    intrinsics.

    Args:
        image: (H, W) grey or (H, W, 3) RGB, uint8; colour becomes luma (ITU-R BT.601).
        camera: pinhole, of the image's size.
        max_levels: largest number of levels.

    Raises:
        MethodError: the camera is not pinhole or its size is not the image's.
    """
    require_pinhole(camera)
    if image.ndim not in (2, 3) or image.shape[:2] != (camera.height, camera.width):
        raise MethodError(f"the image is {image.shape}, its camera {camera.height}x{camera.width}: they must agree")
    grey = to_grey(image)
    levels = [Level(with_gradients(grey[..., None]), camera)]
    while len(levels) < max_levels and grey.size > SMALLEST_AREA and min(grey.shape) >= 2:
        grey = halve(grey)
        levels.append(Level(with_gradients(grey[..., None]), level_camera(camera, len(levels))))
    return levels


def require_pinhole(camera: Camera) -> None:
    """Raise MethodError unless the camera is a pinhole camera: the warp knows no distortion."""
    if camera.model != "pinhole":
        raise MethodError(
            f"direct alignment needs undistorted images (camera model 'pinhole'), got '{camera.model}': "
            "build the dataset with undistortion"
        )


def to_grey(image: Image) -> Map:
    """(H, W) float32 grey levels of a grey or RGB image."""
    image = np.ascontiguousarray(image)
    return image.astype(np.float32) if image.ndim == 2 else _luma(image)


@njit(cache=True)
def _luma(image: Image) -> Map:
    height, width, _ = image.shape
    grey = np.empty((height, width), np.float32)
    red, green, blue = np.float32(0.299), np.float32(0.587), np.float32(0.114)
    for y in range(height):
        for x in range(width):
            grey[y, x] = red * image[y, x, 0] + green * image[y, x, 1] + blue * image[y, x, 2]
    return grey


@njit(cache=True)
def halve(grey: Map) -> Map:
    """Mean of each 2x2 block, (H, W) -> (H // 2, W // 2)."""
    height, width = grey.shape[0] // 2, grey.shape[1] // 2
    half = np.empty((height, width), np.float32)
    quarter = np.float32(0.25)
    for y in range(height):
        for x in range(width):
            top = grey[2 * y, 2 * x] + grey[2 * y, 2 * x + 1]
            bottom = grey[2 * y + 1, 2 * x] + grey[2 * y + 1, 2 * x + 1]
            half[y, x] = quarter * (top + bottom)
    return half


def with_gradients(values: Map) -> Map:
    """Append central differences, (H, W, D) float32 -> (H, W, 3 D); the outermost pixels get gradient zero.

    Interpolated bilinearly at any p, they are (F(p + 1) - F(p - 1)) / 2 of the bilinear map F: exactly the central
    difference of the function in the residual.
    """
    values = np.ascontiguousarray(values, dtype=np.float32)
    # With a constant number of channels the compiled loop is twenty times faster.
    return _intensity_gradients(values[..., 0].copy()) if values.shape[2] == 1 else _feature_gradients(values)


@njit(cache=True)
def _intensity_gradients(grey: Map) -> Map:
    height, width = grey.shape
    out = np.empty((height, width, 3), np.float32)
    half, zero = np.float32(0.5), np.float32(0.0)
    for y in range(height):
        above, row, below, target = grey[max(y - 1, 0)], grey[y], grey[min(y + 1, height - 1)], out[y]
        for x in range(1, width - 1):
            target[x, 0] = row[x]
            target[x, 1] = half * (row[x + 1] - row[x - 1])
            target[x, 2] = half * (below[x] - above[x])
        for x in (0, width - 1):
            target[x, 0], target[x, 1], target[x, 2] = row[x], zero, zero
        if y in (0, height - 1):
            target[:, 1:] = zero
    return out


@njit(cache=True)
def _feature_gradients(values: Map) -> Map:
    height, width, channels = values.shape
    out = np.zeros((height, width, 3 * channels), np.float32)
    half = np.float32(0.5)
    for y in range(height):
        for x in range(width):
            target = out[y, x]
            target[:channels] = values[y, x]
            if 0 < y < height - 1 and 0 < x < width - 1:
                left, right, above, below = values[y, x - 1], values[y, x + 1], values[y - 1, x], values[y + 1, x]
                for c in range(channels):
                    target[channels + c] = half * (right[c] - left[c])
                    target[2 * channels + c] = half * (below[c] - above[c])
    return out
