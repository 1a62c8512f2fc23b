"""Linear light and stored values of an image, and what several changes of an image do to them.

Linear intensities are taken to be the 2.2-th power of stored values.
"""

from __future__ import annotations

import cv2
import numpy as np

from relocbench.arrays import Array, Floats

_GAMMA = 2.2
_GREY = np.array([0.299, 0.587, 0.114], dtype=np.float32)
"""luma of ITU-R BT.601"""


def light_of(stored: Floats) -> Floats:
    return np.asarray(np.clip(stored, 0, 1) ** np.float32(_GAMMA), dtype=np.float32)


def stored_of(light: Floats) -> Floats:
    return np.asarray(np.clip(light, 0, 1) ** np.float32(1 / _GAMMA), dtype=np.float32)


def mean_of(values: Floats) -> float:
    return float(values.mean(dtype=np.float64))


def spread(rng: np.random.Generator, strength: float, count: int = 1) -> Array:
    """(count,) numbers, uniform in +- strength."""
    return rng.uniform(-strength, strength, count)


def smooth_field(shape: tuple[int, int], cells: int, rng: np.random.Generator) -> Floats:
    """A smooth random field (H, W) of mean 0 and standard deviation 1, with so many cells along the longer side."""
    side = max(shape) / cells
    coarse = rng.standard_normal([int(np.ceil(2 * length / side)) for length in shape]).astype(np.float32)
    # The middle half, since the outermost cells are flat to their border.
    larger = cv2.resize(coarse, (shape[1] * 2, shape[0] * 2), interpolation=cv2.INTER_CUBIC)
    field = np.asarray(larger, dtype=np.float32)
    field = field[shape[0] // 2 : shape[0] // 2 + shape[0], shape[1] // 2 : shape[1] // 2 + shape[1]]
    return np.asarray((field - mean_of(field)) / max(float(field.std(dtype=np.float64)), 1e-6), dtype=np.float32)


def grey_of(stored: Floats) -> Floats:
    """Luma (H, W) of an image (H, W, 3)."""
    return np.asarray(stored @ _GREY, dtype=np.float32)


def saturated(stored: Floats, factor: float) -> Floats:
    """An image (H, W, 3) with its colours' distance from grey times a factor."""
    grey = grey_of(stored)[..., None]
    return np.asarray(grey + (stored - grey) * np.float32(factor), dtype=np.float32)


def softened(values: Floats, sigma_px: float) -> Floats:
    """A Gaussian blur of (H, W) or (H, W, 3)."""
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma_px), dtype=np.float32)


def maybe_blurred(stored: Floats, most: float, rng: np.random.Generator) -> Floats:
    """Half of the images, with a Gaussian blur of up to ``most`` pixels."""
    if rng.uniform() < 0.5:
        return stored
    return softened(stored, max(rng.uniform(0, most), 1e-3))


def noisy(stored: Floats, most: float, rng: np.random.Generator) -> Floats:
    noise = rng.standard_normal(stored.shape, dtype=np.float32)
    return np.asarray(stored + np.float32(rng.uniform(0, most)) * noise)


def sensed(light: Floats, rng: np.random.Generator) -> Floats:
    """Little light as a sensor amplifies it. Photon noise grows with its square root; the rest is that of reading."""
    photon, reading = rng.uniform(0.005, 0.03), rng.uniform(0.001, 0.006)
    noise = rng.standard_normal(light.shape, dtype=np.float32)
    return np.asarray(light + noise * np.sqrt(photon**2 * np.clip(light, 0, 1) + reading**2).astype(np.float32))
