"""Dense depth as stereo matching finds it, without the errors that left-right and uniqueness checks remove.

Two cameras with the baseline b see a point at the depth z with the disparity ``d = f b / z``. If the disparity has an
error of e pixels, that of depth is ``sigma = z^2 e / (f b)``. Errors of neighbouring pixels are alike, since what is
compared are blocks of pixels. There is no depth where nothing can be matched: on surfaces without texture, on what the
right camera does not see, and beside nearer surfaces, whose depth blocks of pixels would carry over their edge.
"""

from __future__ import annotations

import cv2
import numpy as np

from relocbench.arrays import Array, Floats, Image, Mask
from relocbench.datasets.core.images import DEPTH_STEP_M, as_grey
from relocbench.geometry import Camera

STEREO_BASELINE_M = 0.54
"""that of KITTI's car"""
_FARTHEST = 0.2
"""greatest sigma of depth relative to it"""
_BLOCK = 5
"""pixels; side of the blocks that are compared"""
_ALIKE_PX = 2.0
"""standard deviation of the Gaussian by which errors are correlated"""
_LEAST_TEXTURE = 1.2
"""root mean square of the horizontal gradient around a pixel, grey levels per pixel, that is matched"""
_TEXTURE_BLOCK = 9
_STEP_PX = 1.0
"""difference of disparities from which there is an edge between two surfaces"""


def stored_sigma(camera: Camera, error_px: float) -> tuple[float, float, float]:
    """(a, b, c) of the sigma a + b z + c z^2 of a depth image, metres; without an error, that of its rounding."""
    return DEPTH_STEP_M / np.sqrt(12), 0.0, error_px / (camera.fx * STEREO_BASELINE_M)


def matched_up_to(camera: Camera, error_px: float) -> float:
    """The depth in metres at which it ends."""
    return _FARTHEST * camera.fx * STEREO_BASELINE_M / error_px


def matched_depth(image: Image, depth: Floats, camera: Camera, error_px: float, rng: np.random.Generator) -> Floats:
    """Depth (H, W) in metres, 0 where there is none.

    Args:
        image: (H, W) or (H, W, 3).
        depth: exact depth (H, W) in metres, 0 for none.
        error_px: standard deviation of the disparity in pixels.
    """
    focal_baseline = camera.fx * STEREO_BASELINE_M
    known = depth > 0
    disparity = np.where(known, focal_baseline / np.where(known, depth, 1.0), 0.0).astype(np.float64)
    measured = disparity + error_px * correlated_errors(depth.shape, rng)
    # Where depth ends is told by the exact one: by the drawn one, those pixels would be left that are drawn too near.
    found = known & (depth <= matched_up_to(camera, error_px)) & (measured > 0)
    found &= textured(image) & seen_by_both(disparity) & ~beside_nearer(disparity)
    return np.where(found, focal_baseline / np.where(found, measured, 1.0), 0.0).astype(np.float32)


def correlated_errors(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """A smooth field (H, W) of standard deviation 1 whose values are alike over a few pixels."""
    reach = int(np.ceil(3 * _ALIKE_PX))
    white = rng.normal(size=(shape[0] + 2 * reach, shape[1] + 2 * reach))
    kernel = cv2.getGaussianKernel(2 * reach + 1, _ALIKE_PX, cv2.CV_64F)
    smooth = cv2.sepFilter2D(white, cv2.CV_64F, kernel, kernel) / np.sum(kernel**2)
    return np.asarray(smooth[reach:-reach, reach:-reach])


def textured(image: Image) -> Mask:
    """Where (H, W) an image changes enough from left to right to be matched."""
    gradient = cv2.Sobel(as_grey(image), cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    square = cv2.blur(gradient * gradient, (_TEXTURE_BLOCK, _TEXTURE_BLOCK))
    return np.asarray(square >= _LEAST_TEXTURE**2)


def seen_by_both(disparity: Array) -> Mask:
    """Which pixels (H, W) a camera to the right sees as well, by their disparity (H, W) in pixels, 0 for the sky.

    It sees a pixel of column u in column ``u - d``, unless a pixel further right is seen there or left of it, which is
    then in front of it.
    """
    column = np.arange(disparity.shape[1]) - disparity
    hiding = np.minimum.accumulate(column[:, ::-1], axis=1)[:, ::-1]
    visible = column >= 0
    visible[:, :-1] &= column[:, :-1] < hiding[:, 1:]
    return np.asarray(visible)


def beside_nearer(disparity: Array) -> Mask:
    """Which pixels (H, W) share a block of pixels with a clearly nearer surface, by their disparity (H, W)."""
    nearest = cv2.dilate(disparity, np.ones((_BLOCK, _BLOCK), dtype=np.uint8))
    return np.asarray(nearest > disparity + _STEP_PX)
