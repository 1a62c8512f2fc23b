"""Changes of light and camera of a single image, drawn by seed. No pixel moves.

Light is scaled and shaded in linear intensities; the rest is done to stored values, as a camera's processing does.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from relocbench.arrays import Floats, Image
from relocbench.datasets.core.images import through_jpeg
from relocbench.datasets.moved_views.kinds import Change
from relocbench.datasets.moved_views.tones import (
    light_of,
    maybe_blurred,
    mean_of,
    noisy,
    saturated,
    sensed,
    smooth_field,
    spread,
    stored_of,
)
from relocbench.datasets.moved_views.weather import SCENERY, Sight

_SODIUM, _MOON = np.array([1.0, 0.72, 0.42]), np.array([0.75, 0.85, 1.1])
"""colours of light at night"""
_JPEG_SHARE, _JPEG_QUALITY = 0.7, (30, 95)


def changed(image: Image, change: Change, rng: np.random.Generator, sight: Callable[[], Sight]) -> Image:
    """A changed copy of an image (H, W, 3) RGB; ``sight`` gives what it shows, which some changes ask for."""
    if change == "none":
        return image
    stored = image.astype(np.float32) / np.float32(255)
    stored = SCENERY[change](stored, sight(), rng) if change in SCENERY else _CHANGES[change](stored, rng)
    out = np.rint(np.clip(stored, 0, 1) * 255).astype(np.uint8)
    return _compressed(out, rng)


def _exposure(stored: Floats, rng: np.random.Generator, strength: float = 1.0) -> Floats:
    """Another exposure, white balance, contrast, saturation and sharpness."""
    gain = np.exp(spread(rng, 0.6 * strength) + spread(rng, 0.12 * strength, 3))
    x = stored_of(light_of(stored) * gain.astype(np.float32))
    x = x ** np.exp(spread(rng, 0.25 * strength) + spread(rng, 0.05 * strength, 3)).astype(np.float32)
    mean = np.float32(x.mean(dtype=np.float64))
    x = (x - mean) * np.float32(np.exp(spread(rng, 0.35 * strength)[0])) + mean
    x = x + (spread(rng, 0.05 * strength) + spread(rng, 0.015 * strength, 3)).astype(np.float32)
    x = saturated(x, rng.uniform(1 - 0.8 * strength, 1 + 0.3 * strength))
    return noisy(maybe_blurred(x, 1.2, rng), 0.015, rng)


def _shading(stored: Floats, rng: np.random.Generator) -> Floats:
    """Light that differs from place to place: a smooth field, and often a shadow with an edge."""
    height, width = stored.shape[:2]
    field = np.exp(smooth_field((height, width), int(rng.integers(3, 7)), rng) * np.float32(rng.uniform(0.4, 1.0)))
    light = light_of(stored) * field[..., None]
    if rng.uniform() < 0.7:
        shadow = _shadow((height, width), rng)[..., None]
        # What the sun does not reach is lit by the sky alone, which is blue.
        dark = np.float32(rng.uniform(0.15, 0.5)) * np.array([0.9, 1.0, 1.15], dtype=np.float32)
        light = light * (1 - shadow * (1 - dark))
    exposed = light * np.float32(mean_of(light_of(stored)) / max(mean_of(light), 1e-4))
    return _exposure(stored_of(exposed), rng, 0.6)


def _night(stored: Floats, rng: np.random.Generator) -> Floats:
    """Little light of another colour, some of it in pools, and a sensor that amplifies it with its noise."""
    height, width = stored.shape[:2]
    colour = _SODIUM if rng.uniform() < 0.6 else _MOON
    colour = colour * np.exp(spread(rng, 0.1, 3))
    field = np.full((height, width), rng.uniform(0.05, 0.3))
    v, u = np.mgrid[:height, :width].astype(np.float64)
    for _ in range(int(rng.integers(1, 4))):
        at, reach = rng.uniform(0, 1, size=2) * (width, height), rng.uniform(0.15, 0.5) * width
        field += rng.uniform(0.3, 1.0) / (1 + ((u - at[0]) ** 2 + (v - at[1]) ** 2) / reach**2) ** 1.5
    light = light_of(stored) * (field[..., None] * colour).astype(np.float32)
    light = light * np.float32(rng.uniform(0.06, 0.2) / max(mean_of(light), 1e-4) * mean_of(light_of(stored)) ** 0.5)
    light = sensed(light, rng)
    return maybe_blurred(stored_of(light), 1.2, rng)


_CHANGES: dict[Change, Callable[[Floats, np.random.Generator], Floats]] = {
    "exposure": _exposure,
    "shading": _shading,
    "night": _night,
}


def _shadow(shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    """How much of the sun is hidden (H, W), 0 to 1: what lies on one side of a wavy line, with a penumbra."""
    height, width = shape
    v, u = np.mgrid[:height, :width].astype(np.float32)
    towards = rng.uniform(0, 2 * np.pi)
    across = (u - width * rng.uniform(0.25, 0.75)) * np.cos(towards) + (v - height * rng.uniform(0.25, 0.75)) * np.sin(
        towards
    )
    waves = 0.08 * width * smooth_field(shape, int(rng.integers(3, 9)), rng)
    return np.asarray(1 / (1 + np.exp(-np.clip((across + waves) / rng.uniform(1.0, 8.0), -30, 30))), dtype=np.float32)


def _compressed(image: Image, rng: np.random.Generator) -> Image:
    """Most images, after compression as JPEG."""
    quality = int(rng.integers(*_JPEG_QUALITY))
    if rng.uniform() >= _JPEG_SHARE:
        return image
    return through_jpeg(image, quality)
