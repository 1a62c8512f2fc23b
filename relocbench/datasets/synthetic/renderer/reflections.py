"""Reflections on wet ground: pixels whose reflection is interpolated, and the blur of a rough film of water.

In odd rows, wet ground and puddles, whose waves hide it, take the mean of the pixels above and below. In even rows
every other pixel of a blurring film takes the mean of its left and right neighbours, alternating between rows: the film
blurs less across than along the light's direction, so rays are denser across. Glass has a ray for every pixel.
"""

from __future__ import annotations

import cv2
import numpy as np

from relocbench.arrays import Floats, Indices, Mask
from relocbench.datasets.synthetic.renderer.surfaces import Hits
from relocbench.kernels import njit

_CLEAR = 0.5
"""sharpness from which on a reflection is not interpolated in even rows"""
_ACROSS, _ALONG = 4, 30
"""half width and half height of the blur in pixels, for an image 512 pixels wide with 75 degrees field of view. A facet
tilted by b turns the reflected ray by 2 b along the light's direction and by 2 b sin(t) across it, where t is the angle
at which the road is seen (Cox and Munk 1954, on the glitter of water). The values are for facets tilted by 1.5 degrees
(root mean square) and t of about 8 degrees: grains protrude from the film on asphalt, so that facades become streaks
and only puddles reflect clearly"""
_FLAT = 0.97
"""least z of the normal of ground that can hold water"""


@njit(cache=True, nogil=True, error_model="numpy")
def interpolated_pixels(casts: Mask, hits: Hits, width: int) -> Indices:
    """Pixels whose reflection is interpolated, in the order in which they are filled: even rows first.

    ``casts`` (N,) marks the reflecting pixels of the image.
    """
    n = len(casts)
    normal = hits.normal
    out = np.empty(n, dtype=np.int64)
    m = 0
    for odd in range(2):
        step = width if odd else 1
        for row in range(2 - odd, n // width - 1, 2):
            for i in range(row * width + 1, (row + 1) * width - 1):
                if not odd and ((row // 2 + i) % 2 == 0 or hits.sharpness[i] >= _CLEAR):
                    continue
                j, k = i - step, i + step
                flat = min(normal[i, 2], normal[j, 2], normal[k, 2]) > _FLAT
                if flat and casts[i] and casts[j] and casts[k]:
                    out[m] = i
                    m += 1
    return out[:m].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def fill(reflected: Floats, pixels: Indices, width: int) -> None:
    """Set each of the pixels in ``reflected`` (N, 3), in their order, to the mean of its two neighbours."""
    for i in pixels:
        step = width if (i // width) % 2 else 1
        for k in range(3):
            reflected[i, k] = np.float32(0.5) * (reflected[i - step, k] + reflected[i + step, k])


def roughen(reflected: Floats, casts: Mask, sharpness: Floats, width: int) -> None:
    """Blur reflections on wet ground, more along the light's direction, as a rough film does; puddles stay clear.

    ``casts`` (N,) marks the reflecting pixels of ``reflected`` (N, 3).
    """
    rough = np.flatnonzero(casts & (sharpness < 1.0))
    if len(rough) == 0:
        return
    top, bottom = int(rough[0]) // width, int(rough[-1]) // width + 1
    image = np.zeros((bottom - top, width, 4), dtype=np.float32)
    _scatter(image.reshape(-1, 4), reflected, rough, top * width)
    scale = width / 512
    kernel = (2 * round(_ACROSS * scale) + 1, 2 * round(_ALONG * scale) + 1)
    mean = np.asarray(cv2.blur(image, kernel, borderType=cv2.BORDER_CONSTANT), dtype=np.float32)
    _mix(reflected, mean.reshape(-1, 4), sharpness, rough, top * width)


@njit(cache=True, nogil=True, error_model="numpy")
def _scatter(image: Floats, reflected: Floats, pixels: Indices, first: int) -> None:
    """Copy the pixels with weight 1 into an image (M, 4) that begins at pixel ``first``."""
    for i in pixels:
        for k in range(3):
            image[i - first, k] = reflected[i, k]
        image[i - first, 3] = 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def _mix(reflected: Floats, mean: Floats, sharpness: Floats, pixels: Indices, first: int) -> None:
    """Blend each pixel with the blurred image (M, 4, with weights) according to its sharpness."""
    for i in pixels:
        rest = (np.float32(1.0) - sharpness[i]) / mean[i - first, 3]
        for k in range(3):
            reflected[i, k] = sharpness[i] * reflected[i, k] + rest * mean[i - first, k]
