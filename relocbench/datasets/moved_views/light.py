"""Changes of light and camera of a single image, drawn by seed. No pixel moves.

Light is scaled and shaded in linear intensities, which are taken to be the 2.2-th power of stored values; the rest is
done to stored values, as a camera's processing does.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from relocbench.arrays import Array, Floats, Image
from relocbench.datasets.core.images import through_jpeg
from relocbench.datasets.moved_views.kinds import Change

_GAMMA = 2.2
_GREY = np.array([0.299, 0.587, 0.114], dtype=np.float32)
"""luma of ITU-R BT.601"""
_SODIUM, _MOON = np.array([1.0, 0.72, 0.42]), np.array([0.75, 0.85, 1.1])
"""colours of light at night"""
_JPEG_SHARE, _JPEG_QUALITY = 0.7, (30, 95)


def changed(image: Image, change: Change, rng: np.random.Generator) -> Image:
    """A changed copy of an image (H, W, 3) RGB."""
    if change == "none":
        return image
    stored = _CHANGES[change](image.astype(np.float32) / np.float32(255), rng)
    out = np.rint(np.clip(stored, 0, 1) * 255).astype(np.uint8)
    return _compressed(out, rng)


def _exposure(stored: Floats, rng: np.random.Generator, strength: float = 1.0) -> Floats:
    """Another exposure, white balance, contrast, saturation and sharpness."""
    gain = np.exp(_spread(rng, 0.6 * strength) + _spread(rng, 0.12 * strength, 3))
    x = _stored(_light(stored) * gain.astype(np.float32))
    x = x ** np.exp(_spread(rng, 0.25 * strength) + _spread(rng, 0.05 * strength, 3)).astype(np.float32)
    mean = np.float32(x.mean(dtype=np.float64))
    x = (x - mean) * np.float32(np.exp(_spread(rng, 0.35 * strength)[0])) + mean
    x = x + (_spread(rng, 0.05 * strength) + _spread(rng, 0.015 * strength, 3)).astype(np.float32)
    grey = (x @ _GREY)[..., None]
    saturation = np.float32(rng.uniform(1 - 0.8 * strength, 1 + 0.3 * strength))
    x = np.asarray(grey + (x - grey) * saturation, dtype=np.float32)
    return _noisy(_blurred(x, 1.2, rng), 0.015, rng)


def _shading(stored: Floats, rng: np.random.Generator) -> Floats:
    """Light that differs from place to place: a smooth field, and often a shadow with an edge."""
    height, width = stored.shape[:2]
    field = np.exp(_smooth((height, width), int(rng.integers(3, 7)), rng) * np.float32(rng.uniform(0.4, 1.0)))
    light = _light(stored) * field[..., None]
    if rng.uniform() < 0.7:
        shadow = _shadow((height, width), rng)[..., None]
        # What the sun does not reach is lit by the sky alone, which is blue.
        dark = np.float32(rng.uniform(0.15, 0.5)) * np.array([0.9, 1.0, 1.15], dtype=np.float32)
        light = light * (1 - shadow * (1 - dark))
    exposed = light * np.float32(_mean(_light(stored)) / max(_mean(light), 1e-4))
    return _exposure(_stored(exposed), rng, 0.6)


def _night(stored: Floats, rng: np.random.Generator) -> Floats:
    """Little light of another colour, some of it in pools, and a sensor that amplifies it with its noise."""
    height, width = stored.shape[:2]
    colour = _SODIUM if rng.uniform() < 0.6 else _MOON
    colour = colour * np.exp(_spread(rng, 0.1, 3))
    field = np.full((height, width), rng.uniform(0.05, 0.3))
    v, u = np.mgrid[:height, :width].astype(np.float64)
    for _ in range(int(rng.integers(1, 4))):
        at, reach = rng.uniform(0, 1, size=2) * (width, height), rng.uniform(0.15, 0.5) * width
        field += rng.uniform(0.3, 1.0) / (1 + ((u - at[0]) ** 2 + (v - at[1]) ** 2) / reach**2) ** 1.5
    light = _light(stored) * (field[..., None] * colour).astype(np.float32)
    light = light * np.float32(rng.uniform(0.06, 0.2) / max(_mean(light), 1e-4) * _mean(_light(stored)) ** 0.5)
    # Photon noise grows with the square root of the light; the rest is that of reading the sensor.
    photon, reading = rng.uniform(0.005, 0.03), rng.uniform(0.001, 0.006)
    light = light + rng.standard_normal(light.shape, dtype=np.float32) * np.sqrt(
        photon**2 * np.clip(light, 0, 1) + reading**2
    ).astype(np.float32)
    return _blurred(_stored(light), 1.2, rng)


_CHANGES: dict[Change, Callable[[Floats, np.random.Generator], Floats]] = {
    "exposure": _exposure,
    "shading": _shading,
    "night": _night,
}


def _light(stored: Floats) -> Floats:
    return np.asarray(np.clip(stored, 0, 1) ** np.float32(_GAMMA), dtype=np.float32)


def _stored(light: Floats) -> Floats:
    return np.asarray(np.clip(light, 0, 1) ** np.float32(1 / _GAMMA), dtype=np.float32)


def _mean(values: Floats) -> float:
    return float(values.mean(dtype=np.float64))


def _spread(rng: np.random.Generator, strength: float, count: int = 1) -> Array:
    """(count,) numbers, uniform in +- strength."""
    return rng.uniform(-strength, strength, count)


def _smooth(shape: tuple[int, int], cells: int, rng: np.random.Generator) -> Floats:
    """A smooth random field (H, W) of mean 0 and standard deviation 1, with so many cells along the longer side."""
    side = max(shape) / cells
    coarse = rng.standard_normal([int(np.ceil(2 * length / side)) for length in shape]).astype(np.float32)
    # The middle half, since the outermost cells are flat to their border.
    larger = cv2.resize(coarse, (shape[1] * 2, shape[0] * 2), interpolation=cv2.INTER_CUBIC)
    field = np.asarray(larger, dtype=np.float32)
    field = field[shape[0] // 2 : shape[0] // 2 + shape[0], shape[1] // 2 : shape[1] // 2 + shape[1]]
    return np.asarray((field - _mean(field)) / max(float(field.std(dtype=np.float64)), 1e-6), dtype=np.float32)


def _shadow(shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    """How much of the sun is hidden (H, W), 0 to 1: what lies on one side of a wavy line, with a penumbra."""
    height, width = shape
    v, u = np.mgrid[:height, :width].astype(np.float32)
    towards = rng.uniform(0, 2 * np.pi)
    across = (u - width * rng.uniform(0.25, 0.75)) * np.cos(towards) + (v - height * rng.uniform(0.25, 0.75)) * np.sin(
        towards
    )
    waves = 0.08 * width * _smooth(shape, int(rng.integers(3, 9)), rng)
    return np.asarray(1 / (1 + np.exp(-np.clip((across + waves) / rng.uniform(1.0, 8.0), -30, 30))), dtype=np.float32)


def _blurred(stored: Floats, most: float, rng: np.random.Generator) -> Floats:
    """Half of the images, with a Gaussian blur of up to ``most`` pixels."""
    if rng.uniform() < 0.5:
        return stored
    return np.asarray(cv2.GaussianBlur(stored, (0, 0), max(rng.uniform(0, most), 1e-3)), dtype=np.float32)


def _noisy(stored: Floats, most: float, rng: np.random.Generator) -> Floats:
    noise = rng.standard_normal(stored.shape, dtype=np.float32)
    return np.asarray(stored + np.float32(rng.uniform(0, most)) * noise)


def _compressed(image: Image, rng: np.random.Generator) -> Image:
    """Most images, after compression as JPEG."""
    quality = int(rng.integers(*_JPEG_QUALITY))
    if rng.uniform() >= _JPEG_SHARE:
        return image
    return through_jpeg(image, quality)
