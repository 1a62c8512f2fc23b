"""Photometric augmentation of single images: illumination, camera response, colour, blur and noise."""

from __future__ import annotations

import cv2
import numpy as np

from baselines.gn_net.training.options import AugmentationOptions
from relocbench.arrays import Floats

Values = Floats

GREY = np.array([0.299, 0.587, 0.114], dtype=np.float32)
"""luma of ITU-R BT.601"""


def augment(image: Values, options: AugmentationOptions, rng: np.random.Generator) -> Values:
    """A changed copy of an (H, W, 3) image in [0, 1]: illumination, then lens, sensor and camera. No pixel moves."""
    if rng.random() >= options.probability:
        return image
    x = image * np.exp(_spread(rng, options.gain)) * np.exp(_spread(rng, options.colour, 3))
    x = _saturated(x, rng, options)
    if options.vignetting > 0:
        x = x * _vignette(x.shape[:2], rng.uniform(0, options.vignetting), rng)[..., None]
    if options.blur > 0 and rng.random() < 0.5:
        x = np.asarray(cv2.GaussianBlur(x, (0, 0), max(rng.uniform(0, options.blur), 1e-3)), dtype=np.float32)
    if options.noise > 0:
        x = x + np.float32(rng.uniform(0, options.noise)) * rng.standard_normal(x.shape, dtype=np.float32)
    x = np.clip(x, 0, 1) ** np.exp(_spread(rng, options.gamma))
    mean = x.mean(dtype=np.float64).astype(np.float32)
    x = (x - mean) * np.exp(_spread(rng, options.contrast)) + mean + _spread(rng, options.offset)
    out: Values = np.clip(x, 0, 1).astype(np.float32, copy=False)
    return out


def _spread(rng: np.random.Generator, strength: float, count: int = 1) -> Values:
    """(count,) numbers, uniform in +- strength."""
    return rng.uniform(-strength, strength, count).astype(np.float32)


def _saturated(x: Values, rng: np.random.Generator, options: AugmentationOptions) -> Values:
    grey = (x @ GREY)[..., None]
    if rng.random() < options.grey:
        return np.repeat(grey, 3, axis=-1)
    return grey + (x - grey) * np.exp(_spread(rng, 3 * options.colour)) if options.colour > 0 else x


def _vignette(shape: tuple[int, ...], loss: float, rng: np.random.Generator) -> Values:
    """A factor (H, W) that falls with the squared distance, from 1 near the centre to 1 - loss at one corner."""
    height, width = shape
    centre = rng.uniform(0.4, 0.6, 2).astype(np.float32)
    v = ((np.arange(height, dtype=np.float32) + 0.5) / height - centre[1]) ** 2
    u = ((np.arange(width, dtype=np.float32) + 0.5) / width - centre[0]) ** 2
    r2 = v[:, None] + u[None, :]
    return np.asarray(1 - np.float32(loss) * r2 / r2.max(), dtype=np.float32)
