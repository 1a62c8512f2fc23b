"""Dirt on the lens, which is so near that it is far out of focus: soft spots and a film that take light away."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from relocbench.arrays import Floats

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
