"""A street corner made of boxes, and the textures they wear. Axes: x right, y down, z along the street; metres."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from relocbench.geometry import so3_exp

Array = NDArray[np.float64]
Texture = NDArray[np.float32]

MATERIALS = ("asphalt", "paving", "brick", "plaster", "planks", "paint")
TILE = 8.0
"""metres that a texture covers before it repeats"""
TEXELS = 1024
"""along a side of a texture"""


@dataclass(frozen=True, eq=False)
class Box:
    """A box that stands on the ground or hangs on a wall."""

    centre: Array
    """(3,) metres"""
    size: Array
    """(3,) metres"""
    yaw: float
    """rad, about the vertical"""
    material: int
    """index into MATERIALS"""
    tint: Array
    """(3,) factor on the texture's red, green, blue"""
    offset: Array
    """(2,) metres by which the texture is shifted, so that two boxes do not look the same"""

    @property
    def rotation(self) -> Array:
        """(3, 3) world from box."""
        return so3_exp([0.0, self.yaw, 0.0])


@dataclass(frozen=True, eq=False)
class World:
    """The boxes and, for each material, its texture at halved resolutions."""

    boxes: tuple[Box, ...]
    textures: tuple[tuple[Texture, ...], ...]


@lru_cache(maxsize=2)
def build_world(seed: int) -> World:
    """The street of a seed."""
    rng = np.random.default_rng([seed, 0])
    textures = tuple(_pyramid(_TEXTURES[name](np.random.default_rng([seed, 1, i]))) for i, name in enumerate(MATERIALS))
    return World(tuple(_boxes(rng)), textures)


def _boxes(rng: np.random.Generator) -> list[Box]:
    boxes: list[Box] = []

    def add(low: tuple[float, float, float], high: tuple[float, float, float], material: str, yaw: float = 0.0) -> None:
        a, b = np.array(low), np.array(high)
        tint = rng.uniform(0.65, 1.0) * rng.uniform(0.85, 1.0, size=3)
        offset = rng.uniform(0, TILE, size=2)
        boxes.append(Box((a + b) / 2, b - a, yaw, MATERIALS.index(material), tint, offset))

    add((-40, 0, -20), (40, 1, 70), "asphalt")
    add((-6.5, -0.14, -20), (-3.4, 0.5, 36), "paving")
    add((3.4, -0.14, -20), (6.5, 0.5, 18), "paving")
    for z in np.arange(-18.0, 34.0, 4.0):
        add((-0.08, -0.005, z), (0.08, 0.2, z + 2.0), "plaster")
    for side in (-1, 1):
        z = -16.0
        while z < (34 if side < 0 else 16):
            length, setback, height = rng.uniform(5, 8), rng.uniform(0, 0.9), rng.uniform(5, 10)
            near, far = 6.2 + setback, 16.0
            x0, x1 = (-far, -near) if side < 0 else (near, far)
            add((x0, -height, z), (x1, 0, z + length), ("brick", "plaster")[int(rng.integers(2))])
            add((x0, -height - 0.3, z), (x1, -height, z + length), "planks")
            # A door or shop window stands out a little.
            door = z + rng.uniform(0.5, length - 2.0)
            front = (-near - 0.05, -near + 0.12) if side < 0 else (near - 0.12, near + 0.05)
            add((front[0], -2.2, door), (front[1], -0.1, door + 1.3), "planks")
            add((front[0], -3.6, z + 0.4), (front[1], -2.6, z + rng.uniform(2.0, 3.5)), "paint")
            z += length
    for x in np.arange(-18.0, 24.0, 7.0):
        add(
            (x, -rng.uniform(6, 11), 36 + rng.uniform(0, 1)), (x + 7, 0, 44), ("brick", "plaster")[int(rng.integers(2))]
        )
    _street_furniture(rng, add)
    return boxes


def _street_furniture(rng: np.random.Generator, add: Callable[..., None]) -> None:
    """Parked cars as boxes, crates and posts."""
    for side in (-1, 1):
        z = rng.uniform(1, 3)
        while z < (30 if side < 0 else 15):
            x, width, length, height = side * rng.uniform(2.5, 2.9), 1.6, rng.uniform(2.8, 4.0), rng.uniform(0.7, 0.9)
            yaw = rng.uniform(-0.06, 0.06)
            add((x - width / 2, -height, z), (x + width / 2, -0.15, z + length), "paint", yaw)
            add((x - width / 2.4, -height - 0.55, z + 0.7), (x + width / 2.4, -height, z + length - 0.7), "paint", yaw)
            z += length + rng.uniform(2.5, 5.0)
        for _ in range(5):
            x, z = side * rng.uniform(4.4, 5.6), rng.uniform(3, 26 if side < 0 else 15)
            edge = rng.uniform(0.5, 1.0)
            add((x, -0.14 - edge, z), (x + edge, -0.14, z + edge), "planks", rng.uniform(-0.7, 0.7))
        for z in np.arange(2.0, 30.0 if side < 0 else 17.0, 6.5):
            x = side * 3.7
            add((x - 0.06, -4.2, z), (x + 0.06, 0, z + 0.12), "paint")
            add((x - 0.35, -2.9, z - 0.03), (x + 0.35, -2.2, z), "paint")


def _pyramid(texture: Texture) -> tuple[Texture, ...]:
    """The texture and its means over 2x2, 4x4, ... texels; every level tiles as the first one does."""
    levels = [texture]
    while levels[-1].shape[0] > 1:
        t = levels[-1]
        levels.append(np.ascontiguousarray((t[::2, ::2] + t[1::2, ::2] + t[::2, 1::2] + t[1::2, 1::2]) / np.float32(4)))
    return tuple(levels)


def _noise(rng: np.random.Generator, slope: float, finest: float = 2.0) -> Texture:
    """(TEXELS, TEXELS) tileable noise of mean 0 and deviation 1: amplitude falls as frequency^-slope."""
    frequency = np.hypot(np.fft.fftfreq(TEXELS)[:, None], np.fft.rfftfreq(TEXELS)[None]) * TEXELS
    amplitude = np.where(frequency >= 1, np.maximum(frequency, 1) ** -slope, 0.0)
    amplitude *= np.exp(-((frequency * finest / TEXELS) ** 2))
    spectrum = np.fft.rfft2(rng.standard_normal((TEXELS, TEXELS))) * amplitude
    field = np.fft.irfft2(spectrum, (TEXELS, TEXELS))
    return np.asarray((field - field.mean()) / field.std(), dtype=np.float32)


def _coloured(value: Texture, colour: tuple[float, float, float]) -> Texture:
    """(TEXELS, TEXELS, 3) albedo in [0.02, 0.95]."""
    return np.clip(value[..., None] * np.array(colour, dtype=np.float32), 0.02, 0.95).astype(np.float32)


def _asphalt(rng: np.random.Generator) -> Texture:
    grain, patches, cracks = _noise(rng, 0.4), _noise(rng, 1.6), _noise(rng, 1.3)
    value = 0.30 + 0.035 * grain + 0.05 * patches
    value -= 0.14 * np.exp(-((cracks / 0.03) ** 2))
    return _coloured(value, (1.0, 1.0, 1.02))


def _paving(rng: np.random.Generator) -> Texture:
    return _coloured(_courses(rng, 0.5, 0.5, 0.02, 0.10) + 0.03 * _noise(rng, 0.8), (1.0, 0.97, 0.92))


def _brick(rng: np.random.Generator) -> Texture:
    return _coloured(_courses(rng, 0.25, 0.5, 0.025, 0.22) + 0.05 * _noise(rng, 1.0), (1.0, 0.62, 0.50))


def _planks(rng: np.random.Generator) -> Texture:
    grain = cv2.resize(_noise(rng, 1.0)[:, ::8], (TEXELS, TEXELS), interpolation=cv2.INTER_LINEAR)
    return _coloured(_courses(rng, 0.2, 2.0, 0.015, 0.20) + 0.05 * grain, (0.95, 0.76, 0.55))


def _plaster(rng: np.random.Generator) -> Texture:
    """A wall with windows of uneven brightness."""
    value = 0.62 + 0.05 * _noise(rng, 1.4) + 0.02 * _noise(rng, 0.5)
    glass = _noise(rng, 1.5)
    texels = TEXELS / TILE
    for row in range(3):
        for column in range(4):
            if rng.random() < 0.15:
                continue
            top, left = row * 2.7 + rng.uniform(0.5, 0.8), column * 2.0 + rng.uniform(0.3, 0.6)
            height, width = rng.uniform(1.1, 1.5), rng.uniform(0.8, 1.2)
            outer = _rectangle(top - 0.08, left - 0.08, height + 0.16, width + 0.16, texels)
            value[outer] = rng.uniform(0.75, 0.9)
            pane = _rectangle(top, left, height, width, texels)
            value[pane] = rng.uniform(0.05, 0.35) + 0.06 * glass[pane]
            value[_rectangle(top, left + width / 2 - 0.03, height, 0.06, texels)] = 0.8
    return _coloured(value, (1.0, 0.95, 0.84))


def _paint(rng: np.random.Generator) -> Texture:
    """Panels of different brightness with dirt, as on cars, signs and posters."""
    value = np.full((TEXELS, TEXELS), 0.4, dtype=np.float32)
    for _ in range(140):
        top, left = rng.uniform(0, TILE, size=2)
        height, width = rng.uniform(0.1, 0.9, size=2)
        value[_rectangle(top, left, height, width, TEXELS / TILE)] = rng.uniform(0.08, 0.9)
    value += 0.03 * _noise(rng, 1.2)
    tint = np.stack([1.0 + 0.12 * _noise(rng, 1.8), np.ones_like(value), 1.0 + 0.12 * _noise(rng, 1.8)], axis=-1)
    return np.clip(value[..., None] * tint, 0.02, 0.95).astype(np.float32)


def _rectangle(top: float, left: float, height: float, width: float, texels: float) -> tuple[NDArray[np.int64], ...]:
    """Index of a rectangle in metres, wrapped round the tile."""
    rows = np.arange(round(top * texels), round((top + height) * texels)) % TEXELS
    columns = np.arange(round(left * texels), round((left + width) * texels)) % TEXELS
    return np.ix_(rows, columns)


def _courses(rng: np.random.Generator, high: float, wide: float, joint: float, contrast: float) -> Texture:
    """Rows of stones, bricks or boards with dark joints, every second row shifted by half a piece; metres."""
    rows, columns = round(TILE / high), round(TILE / wide)
    shade = 0.5 + contrast * rng.uniform(-1, 1, size=(rows, columns))
    y = np.arange(TEXELS)[:, None] * (TILE / TEXELS) + np.zeros((1, TEXELS))
    row = np.floor(y / high).astype(int)
    x = np.arange(TEXELS)[None] * (TILE / TEXELS) + (row % 2) * wide / 2
    column = np.floor(x / wide).astype(int) % columns
    value = shade[row % rows, column]
    in_joint = (y % high < joint) | (x % wide < joint)
    return np.where(in_joint, 0.22, value).astype(np.float32)


_TEXTURES = {
    "asphalt": _asphalt,
    "paving": _paving,
    "brick": _brick,
    "plaster": _plaster,
    "planks": _planks,
    "paint": _paint,
}
