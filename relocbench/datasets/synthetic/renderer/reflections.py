"""Which mirroring pixels do without a ray of their own, and how the film on wet ground blurs what it mirrors.

In odd rows, wet ground takes the mean of the pixels above and below, puddles too, whose waves hide it. In even rows,
where the film blurs, every other pixel takes the mean of those on its left and right, in turn from row to row: it blurs
less across than along, so that its rays are denser across. Glass has a ray for every pixel.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.synthetic.renderer.surfaces import Hits
from relocbench.kernels import njit

Floats = NDArray[np.float32]
_CLEAR = 0.5
"""sharpness of a mirror that is not blurred"""
_ACROSS, _ALONG = 4, 30
"""half the width and height of the blur in pixels of an image 512 wide, 75 degrees across. A facet that leans by b
turns the mirrored ray by 2 b along the way of the light and by 2 b sin(t) across it, t being the angle at which the
road is seen (Cox and Munk 1954, of the glitter of water). Facets lean by 1.5 degrees, root mean square, at a t of about
8 degrees: grains stick out of the film on asphalt, so that facades become streaks, and only puddles mirror clearly"""
_FLAT = 0.97
"""z of the normal of ground that water can lie on"""


@njit(cache=True, nogil=True, error_model="numpy")
def skipped(casts: NDArray[np.bool_], hits: Hits, width: int) -> NDArray[np.int64]:
    """Pixels that can do with their neighbours, in the order in which they are filled in: even rows first.

    ``casts`` (N,) says which pixels of the image mirror.
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
def fill(reflected: Floats, pixels: NDArray[np.int64], width: int) -> None:
    """Give each of the pixels, in their order, the mean of its two neighbours in ``reflected`` (N, 3)."""
    for i in pixels:
        step = width if (i // width) % 2 else 1
        for k in range(3):
            reflected[i, k] = np.float32(0.5) * (reflected[i - step, k] + reflected[i + step, k])


def roughen(reflected: Floats, casts: NDArray[np.bool_], sharpness: Floats, width: int) -> None:
    """Blur what wet ground mirrors, more along the way of the light, as a rough film does; puddles stay clear.

    ``casts`` (N,) tells the pixels that mirror, of ``reflected`` (N, 3).
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
def _scatter(image: Floats, reflected: Floats, pixels: NDArray[np.int64], first: int) -> None:
    """Copy the pixels into an image (M, 4) that begins at pixel ``first``, with a weight of 1."""
    for i in pixels:
        for k in range(3):
            image[i - first, k] = reflected[i, k]
        image[i - first, 3] = 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def _mix(reflected: Floats, mean: Floats, sharpness: Floats, pixels: NDArray[np.int64], first: int) -> None:
    """Leave of each pixel what its sharpness says; the rest becomes the weighted mean (M, 4)."""
    for i in pixels:
        rest = (np.float32(1.0) - sharpness[i]) / mean[i - first, 3]
        for k in range(3):
            reflected[i, k] = sharpness[i] * reflected[i, k] + rest * mean[i - first, k]
