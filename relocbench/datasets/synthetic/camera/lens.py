"""The lens: defocus, and light that falls off towards the corners."""

from __future__ import annotations

import cv2
import numpy as np

from relocbench.arrays import Floats

_FINER = 9
"""samples per pixel and side of a disk's kernel"""


def disk(radius_px: float) -> Floats:
    """The image (K, K) of a point by a lens out of focus: a disk (the circle of confusion) whose light sums to 1."""
    reach = int(np.ceil(radius_px))
    count = (2 * reach + 1) * _FINER
    at = (np.arange(count) + 0.5) / _FINER - reach - 0.5
    inside = at[:, None] ** 2 + at[None] ** 2 <= max(radius_px, 0.5 / _FINER) ** 2
    kernel = inside.reshape(2 * reach + 1, _FINER, 2 * reach + 1, _FINER).sum(axis=(1, 3))
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)


def defocus(light: Floats, radius_px: float) -> Floats:
    """The light (H, W, 3) with each point spread over a disk of ``radius_px``, at all depths.

    Depths do not matter beyond a few metres for the short focal lengths of cameras on cars.
    """
    if radius_px <= 0:
        return light
    return np.asarray(cv2.filter2D(light, -1, disk(radius_px), borderType=cv2.BORDER_REFLECT), dtype=np.float32)


def vignette(height: int, width: int, loss: float) -> Floats:
    """Share (H, W) of the light that arrives: 1 in the middle and ``1 - loss`` in the corners.

    By the law of cos^4: ``1 / (1 + k r^2)^2`` at distance r from the middle.
    """
    y = np.arange(height) - 0.5 * (height - 1)
    x = np.arange(width) - 0.5 * (width - 1)
    r2 = (y[:, None] ** 2 + x[None] ** 2) / max(y[-1] ** 2 + x[-1] ** 2, 1e-9)
    k = 1 / np.sqrt(1 - loss) - 1
    return np.asarray(1 / (1 + k * r2) ** 2, dtype=np.float32)
