"""Drops on the lens: those of the weather, which are others in every image, and those that stay or slide down."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from relocbench.arrays import Array, Floats
from relocbench.kernels import njit

_MOST_DROPS = 60
_DROP_SHARE = 0.06
"""share of the lens that drops cover in the worst case"""
_STAY_S = (5.0, 30.0)
"""how long a drop stays before it is gone and another one falls elsewhere"""
_SLIDING_SHARE = 0.3
_SLIDING_PER_S = (0.01, 0.12)
"""speed of sliding drops, as a share of the image's height"""


@dataclass(frozen=True, eq=False)
class Drops:
    """Drops on a lens."""

    centre: Floats
    """(N, 2) pixels"""
    radius: Floats
    """(N,) pixels, across"""
    stretch: Floats
    """(N,) height over width"""


def add_lens_drops(image: Floats, amount: float, rng: np.random.Generator) -> Floats:
    """The image (H, W, 3) through a lens with newly drawn drops, ``amount`` as a share of the worst case."""
    height, width = image.shape[:2]
    count = int(rng.binomial(_MOST_DROPS, amount))
    if count == 0:
        return image
    radius = _radius(width, height, rng.lognormal(-0.1, 0.5, count))
    centre = np.stack([rng.uniform(0, width, count), rng.uniform(0, height, count)], 1).astype(np.float32)
    stretch = rng.uniform(0.85, 1.3, count).astype(np.float32)
    return through_drops(image, Drops(centre, radius, stretch))


def sliding_drops(height: int, width: int, amount: float, seed: int, lens: int, time_s: float) -> Drops:
    """The drops on a lens at a time; each stays for a drawn while, some slide down, and then another takes its place.

    More drops add some and leave the others as they are.
    """
    count = round(_MOST_DROPS * amount)
    centre, radius, stretch = np.zeros((count, 2)), np.zeros(count), np.zeros(count)
    for k in range(count):
        first = np.random.default_rng([seed, 43, lens, k])
        stays = first.uniform(*_STAY_S)
        generation, age = divmod(time_s + first.uniform(0, stays), stays)
        rng = np.random.default_rng([seed, 44, lens, k, int(generation)])
        speed = rng.uniform(*_SLIDING_PER_S) if rng.uniform() < _SLIDING_SHARE else 0.0
        centre[k] = rng.uniform(0, width), rng.uniform(0, height) + speed * age * height
        radius[k], stretch[k] = rng.lognormal(-0.1, 0.5), rng.uniform(0.85, 1.3)
    return Drops(centre.astype(np.float32), _radius(width, height, radius), stretch.astype(np.float32))


def _radius(width: int, height: int, relative: Array) -> Floats:
    """Radii in pixels of drops whose radii relative to the typical one are given."""
    typical = np.sqrt(_DROP_SHARE * width * height / (_MOST_DROPS * np.pi * 1.3))
    return np.asarray((typical * relative).clip(1.5, 0.09 * width).astype(np.float32))


def through_drops(image: Floats, drops: Drops) -> Floats:
    """The image (H, W, 3) through drops, each of which shows the scene upside down, small and defocused."""
    height, width = image.shape[:2]
    quarter = cv2.resize(image, (max(1, width // 4), max(1, height // 4)), interpolation=cv2.INTER_AREA)
    blurred = cv2.resize(cv2.GaussianBlur(quarter, (0, 0), 1.5), (width, height), interpolation=cv2.INTER_LINEAR)
    out = image.copy()
    _refract(out, np.ascontiguousarray(blurred), drops.centre, drops.radius, drops.stretch)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _refract(out: Floats, blurred: Floats, centre: Floats, radius: Floats, stretch: Floats) -> None:
    height, width, _ = out.shape
    for k in range(len(centre)):
        r, s = radius[k], stretch[k]
        top, bottom = int(centre[k, 1] - 1.3 * r * s - 2), int(centre[k, 1] + 1.3 * r * s + 3)
        for y in range(max(0, top), min(height, bottom)):
            for x in range(max(0, int(centre[k, 0] - 1.3 * r - 2)), min(width, int(centre[k, 0] + 1.3 * r + 3))):
                p, q = (x - centre[k, 0]) / r, (y - centre[k, 1]) / (r * s)
                e = np.sqrt(p * p + q * q)
                # The camera is focused at a distance, so the rim of a drop is blurred.
                a = min(max((1.15 - e) / 0.4, 0.0), 1.0)
                if a <= 0.0:
                    continue
                a = 0.85 * a * a * (3 - 2 * a)
                sx = min(max(int(centre[k, 0] - 4.0 * r * p), 0), width - 1)
                sy = min(max(int(centre[k, 1] - 4.0 * r * q), 0), height - 1)
                dim = 1.1 - 0.45 * min(e, 1.0) ** 3
                for c in range(3):
                    out[y, x, c] += a * (dim * blurred[sy, sx, c] - out[y, x, c])
