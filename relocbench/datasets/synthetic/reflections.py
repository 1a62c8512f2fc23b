"""What wet ground mirrors is blurred by its film, so that every other ray does."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float32]
_CLEAR = 0.5
"""sharpness from which every pixel has a ray of its own"""


@njit(cache=True, nogil=True, error_model="numpy")
def skipped(casts: NDArray[np.bool_], sharpness: Floats, width: int) -> NDArray[np.int64]:
    """Pixels of blurred mirrors that can do with their four neighbours: the light squares of a chess board.

    ``casts`` (N,) says which pixels of the image mirror.
    """
    n = len(casts)
    out = np.empty(n // 2 + 1, dtype=np.int64)
    m = 0
    for i in range(width, n - width):
        column = i % width
        if not casts[i] or (column + i // width) % 2 == 0 or column == 0 or column == width - 1:
            continue
        if sharpness[i] < _CLEAR and casts[i - 1] and casts[i + 1] and casts[i - width] and casts[i + width]:
            out[m] = i
            m += 1
    return out[:m].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def fill(reflected: Floats, pixels: NDArray[np.int64], width: int) -> None:
    """Give each of the pixels the mean of its four neighbours in ``reflected`` (N, 3)."""
    for i in pixels:
        for k in range(3):
            total = reflected[i - 1, k] + reflected[i + 1, k] + reflected[i - width, k] + reflected[i + width, k]
            reflected[i, k] = np.float32(0.25) * total


def roughen(reflected: Floats, index: NDArray[np.int64], sharpness: Floats, width: int) -> None:
    """Blur what wet ground mirrors, more along the way of the light, as a rough film does; puddles stay clear.

    ``index`` holds the pixels that mirror, of ``reflected`` (N, 3).
    """
    rough = index[sharpness[index] < 1.0]
    if len(rough) == 0:
        return
    top, bottom = int(rough.min()) // width, int(rough.max()) // width + 1
    at = rough - top * width
    image = np.zeros(((bottom - top) * width, 4), dtype=np.float32)
    image[at, :3] = reflected[rough]
    image[at, 3] = 1.0
    scale = width / 512
    kernel = (2 * round(1.5 * scale) + 1, 2 * round(6 * scale) + 1)
    mean = cv2.blur(image.reshape(-1, width, 4), kernel, borderType=cv2.BORDER_CONSTANT).reshape(-1, 4)[at]
    keep = sharpness[rough, None]
    reflected[rough] = keep * reflected[rough] + (1 - keep) * mean[:, :3] / mean[:, 3:]
