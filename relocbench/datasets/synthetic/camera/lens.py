"""The lens: dirt on it, scattered light, defocus, and light that falls off towards the corners."""

from __future__ import annotations

from functools import lru_cache

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


_NARROW, _WIDE = 0.006, 0.025
"""standard deviations of the bloom's two parts, as shares of the image's width"""
_VEIL = 0.25
"""standard deviation of the part of the veil that follows the light, as a share of the width"""
_BRIGHTEST = 300.0
"""times the mean; brighter light is scattered as if it was that bright"""


def scatter(light: Floats, bloom: float, veil: float) -> Floats:
    """The light (H, W, 3) of which the lens scatters some.

    The glare spread function is a point and three Gaussians and a constant, ``(1 - bloom - veil) I + bloom B + veil V``
    (Talvala et al., "Veiling glare in high dynamic range imaging", 2007, measure such functions). No light is added or
    lost, except that of lights beyond a bound.
    """
    if bloom <= 0 and veil <= 0:
        return light
    width = light.shape[1]
    bounded = np.minimum(light, np.float32(_BRIGHTEST) * light.mean(dtype=np.float64).astype(np.float32))
    near = 0.6 * _blurred(bounded, _NARROW * width) + 0.4 * _blurred(bounded, _WIDE * width)
    mean = bounded.mean(axis=(0, 1), dtype=np.float64).astype(np.float32)
    far = 0.5 * _blurred(bounded, _VEIL * width) + 0.5 * mean
    return np.asarray((1 - bloom - veil) * light + bloom * near + veil * far, dtype=np.float32)


def _blurred(light: Floats, sigma_px: float) -> Floats:
    """A Gaussian blur, of a smaller image where that shows no difference."""
    height, width = light.shape[:2]
    shrink = max(1, int(sigma_px / 3))
    size = max(1, width // shrink), max(1, height // shrink)
    small = cv2.resize(light, size, interpolation=cv2.INTER_AREA) if shrink > 1 else light
    sigma = max(sigma_px * size[0] / width, 1e-3)
    small = cv2.GaussianBlur(small, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    if shrink == 1:
        return np.asarray(small, dtype=np.float32)
    return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32)


_MOST_SPOTS = 70
_SPOT_WIDTHS = (0.006, 0.05)
"""radius of spots, as shares of the image's width"""
_DARKEST = 0.65
"""share of light that a spot takes away in its middle"""
_FILM = 0.25
"""share of light that the film takes away where it is thickest"""
_SCATTERED = 0.55
"""share of the light taken away that arrives elsewhere; the rest is absorbed"""


@lru_cache(maxsize=8)
def clearness(height: int, width: int, amount: float, seed: int, lens: int) -> Floats:
    """Share (H, W) of light that passes the dirt of a lens, at most 1.

    Spots lie anywhere. More dirt adds spots and leaves the others where they are.
    """
    rng = np.random.default_rng([seed, 41, lens])
    film = cv2.resize(rng.uniform(0, 1, (5, 7)).astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
    passing = 1 - np.float32(_FILM * amount) * np.clip(2 * film - 0.8, 0, 1)
    u, v = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)
    low, high = _SPOT_WIDTHS
    for at_x, at_y, size, strength in rng.uniform(size=(_MOST_SPOTS, 4))[: round(_MOST_SPOTS * amount)]:
        radius = width * low * (high / low) ** (size**2)
        x, y = (u - at_x * width) / radius, (v - at_y * height) / radius
        soft = np.clip(1.5 - np.sqrt(x[None] ** 2 + y[:, None] ** 2), 0, 1)
        passing *= 1 - np.float32(_DARKEST * strength) * soft**2 * (3 - 2 * soft)
    passing.setflags(write=False)
    return np.asarray(passing, dtype=np.float32)


def behind_dirt(light: Floats, clear: Floats) -> Floats:
    """The light (H, W, 3) behind dirt of a clearness (H, W): what it takes away is scattered in part, as mean light."""
    passing = clear[..., None]
    mean = light.mean(axis=(0, 1), dtype=np.float64).astype(np.float32)
    return np.asarray(passing * light + (1 - passing) * np.float32(_SCATTERED) * mean, dtype=np.float32)
