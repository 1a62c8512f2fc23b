"""Nights, fog, snow and low sun over a photograph, drawn by seed, with the surface that is made up behind its pixels.

No pixel moves. What is sky and which windows could be lit is guessed from the photograph; a wrong guess makes an odd
picture, but no wrong correspondence: their pairs have none on what is taken for sky.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from relocbench.arrays import Array, Floats, Mask
from relocbench.datasets.moved_views.kinds import Change
from relocbench.datasets.moved_views.tones import (
    grey_of,
    light_of,
    maybe_blurred,
    mean_of,
    noisy,
    saturated,
    sensed,
    smooth_field,
    softened,
    spread,
    stored_of,
)

_LAMPS = np.array([[1.0, 0.66, 0.34], [1.0, 0.82, 0.6], [0.85, 0.95, 1.0]], dtype=np.float32)
"""colours of sodium lamps, warm and cold white ones"""
_NIGHT_SKIES = np.array([[0.02, 0.03, 0.06], [0.05, 0.04, 0.03], [0.006, 0.007, 0.01]], dtype=np.float32)
"""light of the sky at dusk, above a town and far from one"""
_SNOW = np.array([0.96, 0.98, 1.0], dtype=np.float32)
_SUN, _SKY = np.array([1.0, 0.68, 0.4], dtype=np.float32), np.array([0.6, 0.78, 1.0], dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Sight:
    """What a view shows, in a level frame at its camera: x and z level, y down."""

    points: Array
    """(H, W, 3) metres; NaN where there is nothing"""
    focal_px: float

    @property
    def distance(self) -> Floats:
        """(H, W) metres; where there is nothing, far away."""
        return np.asarray(np.nan_to_num(np.linalg.norm(self.points, axis=2), nan=1e4), dtype=np.float32)

    @property
    def elevation(self) -> Floats:
        """(H, W) radians above the horizon."""
        upward = -self.points[..., 1] / np.linalg.norm(self.points, axis=2)
        return np.asarray(np.arcsin(np.nan_to_num(upward)), dtype=np.float32)

    @property
    def normal(self) -> Floats:
        """(H, W, 3) of the surface, towards the camera; 0 where there is none."""
        along_v, along_u = np.gradient(self.points, axis=(0, 1))
        normal = np.cross(along_u, along_v)
        normal *= -np.sign(np.sum(normal * self.points, axis=2, keepdims=True))
        length = np.linalg.norm(normal, axis=2, keepdims=True)
        return np.asarray(np.nan_to_num(normal / np.maximum(length, 1e-12)), dtype=np.float32)


def _lamplight(stored: Floats, sight: Sight, rng: np.random.Generator) -> Floats:
    """A dark sky, lamps that light what is near them, lit windows, and a sensor that amplifies little light."""
    sky = sky_of(stored, sight)[..., None]
    colour = _LAMPS[rng.integers(len(_LAMPS))] * np.exp(spread(rng, 0.1, 3)).astype(np.float32)
    pools = np.full(stored.shape[:2], rng.uniform(0.005, 0.05), dtype=np.float32)
    glow = np.zeros_like(pools)
    for _ in range(int(rng.integers(3, 9))):
        pool, lamp = _lamp(sight, sky[..., 0], rng)
        pools += np.float32(rng.uniform(0.3, 1.0)) * pool
        glow += lamp
    windows = _windows(stored, sight, sky[..., 0], rng)[..., None]
    # Eyes and sensors see little colour where there is little light.
    seen = light_of(saturated(stored, rng.uniform(0.4, 0.9)))
    light = seen / (seen + 0.3) * pools[..., None] * colour * (1 - sky)
    light *= np.float32(rng.uniform(0.04, 0.14)) / max(mean_of(light), 1e-4)
    light += sky * _NIGHT_SKIES[rng.integers(len(_NIGHT_SKIES))] * np.float32(rng.uniform(0.5, 1.5))
    light = light * (1 - windows) + windows * _LAMPS[1] * np.float32(rng.uniform(0.2, 0.8)) * (0.4 + 0.6 * seen)
    light = sensed(light + glow[..., None] * colour, rng)
    return maybe_blurred(stored_of(light), 1.2, rng)


def _fog(stored: Floats, sight: Sight, rng: np.random.Generator) -> Floats:
    """Air that scatters light: what is farther away is fainter and less sharp."""
    return noisy(_in_fog(stored, sight, rng.uniform(0.3, 1.4), rng), 0.015, rng)


def _snow(stored: Floats, sight: Sight, rng: np.random.Generator) -> Floats:
    """Snow on the ground, on ledges and leaves, in the air, and a white sky."""
    grey, shape = grey_of(stored), stored.shape[:2]
    sky, elevation = sky_of(stored, sight), sight.elevation
    upward = _step(-sight.normal[..., 1], 0.6, 0.1)
    lower = _step(-elevation, rng.uniform(0.05, 0.2), 0.05)
    ground = softened(np.maximum(upward * (elevation < 0), lower), shape[1] / 40)
    edges = grey - softened(grey, 3.0)
    # Roads are cleared and walls keep some: what lies thinly shows the ground in patches.
    uneven = smooth_field(shape, 6, rng) + 0.6 * smooth_field(shape, 40, rng) + 4 * edges
    patches = _step(uneven, -rng.uniform(0.0, 2.5), 0.5)
    ledges = _step(edges, rng.uniform(0.06, 0.15), 0.02) * np.float32(rng.uniform(0.3, 0.9))
    cover = np.maximum(ground * patches * np.float32(rng.uniform(0.75, 0.97)), ledges * (1 - sky))
    shade = softened(grey, 6.0) / max(mean_of(grey), 1e-3)
    white = np.clip(0.62 + 0.22 * shade + rng.uniform(0.4, 1.0) * edges, 0, 1)[..., None] * _SNOW
    stored = saturated(stored, rng.uniform(0.3, 0.8)) * np.float32(rng.uniform(0.6, 0.95))
    stored = stored + (white - stored) * cover[..., None]
    stored = stored + (np.float32(rng.uniform(0.72, 0.92)) - stored) * (0.9 * sky)[..., None]
    return noisy(_with_flakes(_in_fog(stored, sight, rng.uniform(0.05, 0.6), rng), rng), 0.015, rng)


def _low_sun(stored: Floats, sight: Sight, rng: np.random.Generator) -> Floats:
    """The light and long shadows of a low sun in place of those that are there."""
    sky = sky_of(stored, sight)[..., None]
    normal = sight.normal
    # Of three suns, that which lights most.
    suns = [_direction(rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(3, 18))) for _ in range(3)]
    to_sun = max(suns, key=lambda sun: mean_of(np.clip(normal @ sun.astype(np.float32), 0, 1)))
    grey = softened(grey_of(stored), 1.0)
    # Bright is taken for raised, so that the small relief of a surface is lit from another side.
    bumps = np.stack([*np.gradient(grey)[::-1], np.zeros_like(grey)], axis=-1) * np.float32(rng.uniform(1.0, 4.0))
    facing = np.clip((normal - bumps) @ to_sun.astype(np.float32), 0, 1)
    sun = facing * (1 - _long_shadows(sight, to_sun, rng))
    lit = sun[..., None] * _SUN * np.float32(rng.uniform(2.0, 6.0)) + _SKY * np.float32(rng.uniform(0.25, 0.6))
    light = light_of(stored)
    flat = light / np.maximum(softened(grey_of(light), 12.0), 0.02)[..., None] ** np.float32(rng.uniform(0.3, 0.8))
    relit = flat * lit
    relit *= np.float32(rng.uniform(0.12, 0.3)) / max(mean_of(relit), 1e-4)
    relit += (light * (0.6 + 0.4 * _SUN) - relit) * sky
    towards = np.nan_to_num(sight.points @ to_sun / np.linalg.norm(sight.points, axis=2), nan=-1.0)
    glare = np.exp((towards - 1) * rng.uniform(6, 25)) * rng.uniform(0.2, 0.9)
    return noisy(stored_of(relit + glare[..., None].astype(np.float32) * _SUN), 0.015, rng)


SCENERY: dict[Change, Callable[[Floats, Sight, np.random.Generator], Floats]] = {
    "lamplight": _lamplight,
    "fog": _fog,
    "snow": _snow,
    "low-sun": _low_sun,
}
"""changes that need to know what a view shows: of stored values (H, W, 3) in 0 to 1, to others of about that range"""


def _direction(around: float, height: float) -> Array:
    """(3,) the direction of something at a height above the horizon, radians."""
    return np.array([np.sin(around) * np.cos(height), -np.sin(height), np.cos(around) * np.cos(height)])


def _step(values: Array | Floats, at: float, width: float) -> Floats:
    """A smooth step from 0 to 1."""
    return np.asarray(1 / (1 + np.exp(-np.clip((values - at) / width, -30, 30))), dtype=np.float32)


def sky_of(stored: Floats, sight: Sight) -> Floats:
    """How much each pixel is sky (H, W): smooth and bright or blue up to the border, and what is near and alike."""
    grey = grey_of(stored)
    smooth = softened(grey, 2.0)
    rough = softened(np.abs(grey - smooth), 2.0)
    blue = softened(stored[..., 2] - stored[..., 0], 2.0)
    above = sight.elevation > -0.1
    open_sky = above & (rough < 0.03) & ((smooth > 0.6) | ((blue > 0.06) & (smooth > 0.25)))
    _, labels, facts, _ = cv2.connectedComponentsWithStats(open_sky.astype(np.uint8), connectivity=4)
    left, top, width, height, area = facts.T
    border = (left == 0) | (top == 0) | (left + width == grey.shape[1]) | (top + height == grey.shape[0])
    kept = border & (area > 0.003 * grey.size)
    kept[0] = False
    kept &= np.isin(np.arange(len(kept)), labels[sight.elevation > 0.12])
    # A smooth grey wall is darker or less blue than the largest part; a cloud is not.
    sums = [np.bincount(labels.ravel(), stored[..., channel].ravel(), len(kept)) for channel in range(3)]
    colours = np.stack(sums, axis=1) / area[:, None]
    kept &= np.all(colours > colours[np.argmax(area * kept)] - 0.1, axis=1)
    found = kept[labels].astype(np.float32)
    for _ in range(4):
        # Around its border it is where colours are its own, or brighter, as clouds are.
        weight = np.maximum(softened(found, 8.0), np.float32(1e-6))
        own = np.asarray(softened(stored * found[..., None], 8.0) / weight[..., None], dtype=np.float32)
        cloud = (grey > grey_of(own)) & (softened(found, 16.0) > 0.55)
        alike = (np.abs(stored - own).max(axis=2) < 0.09) | cloud
        near = cv2.dilate(found, np.ones((9, 9), np.uint8)) > 0
        found = np.maximum(found, (above & alike & near).astype(np.float32))
    return softened(cv2.dilate(found, np.ones((3, 3), np.uint8)).astype(np.float32), 1.0)


def _lamp(sight: Sight, sky: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """The light (H, W) that a lamp above the ground throws on the surface, and that of itself and its bloom."""
    height, width = sky.shape
    places = np.flatnonzero((sky < 0.1) & (np.abs(sight.elevation - 0.1) < 0.2))
    v, u = divmod(int(rng.choice(places)) if len(places) else 0, width)
    at = np.nan_to_num(sight.points[v, u], nan=10.0) * rng.uniform(0.75, 0.97)
    away = max(float(np.linalg.norm(at)), 1.0)
    reach = rng.uniform(0.08, 0.3) * away
    apart = np.nan_to_num(np.sum((sight.points - at) ** 2, axis=2), nan=1e8)
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    beside = (rows - v) ** 2 + (columns - u) ** 2
    size = max(rng.uniform(0.03, 0.1) * sight.focal_px / away, 1.0)
    bloom = np.exp(-beside / (2 * size**2)) + rng.uniform(0.002, 0.02) / (1 + beside / (6 * size) ** 2)
    return (1 / (1 + apart / reach**2)).astype(np.float32), bloom.astype(np.float32)


def _windows(stored: Floats, sight: Sight, sky: Floats, rng: np.random.Generator) -> Floats:
    """How much each pixel is a lit window (H, W): some of the compact dark patches between brighter walls."""
    grey = grey_of(stored)
    around = softened(grey, grey.shape[1] / 30)
    darker = (around - softened(grey, 0.7)) / np.maximum(around, 0.1)
    patches = (darker > rng.uniform(0.12, 0.25)) & (sky < 0.1) & (sight.elevation > -0.05)
    _, labels, facts, _ = cv2.connectedComponentsWithStats(patches.astype(np.uint8), connectivity=4)
    _, _, width, height, area = facts.T
    share = area / grey.size
    compact = (share > 1e-4) & (share < 0.015) & (area > 0.45 * width * height) & (height > 0.7 * width)
    lit: Mask = compact & (rng.uniform(size=len(area)) < rng.uniform(0.1, 0.7))
    lit[0] = False
    return softened(lit[labels].astype(np.float32), 0.8)


def _in_fog(stored: Floats, sight: Sight, thickness: float, rng: np.random.Generator) -> Floats:
    """An image through air that takes exp(-thickness) of the light on the way from the median distance."""
    distance = sight.distance / np.float32(np.median(sight.distance))
    distance = distance + np.float32(1e3) * sky_of(stored, sight)
    seen = np.exp(-np.float32(thickness) * distance)[..., None]
    air = np.float32(rng.uniform(0.55, 0.85)) * np.exp(spread(rng, 0.02, 3)).astype(np.float32)
    hazy = softened(stored, 2.0) if thickness > 1 else stored
    return np.asarray(air + (hazy + (stored - hazy) * seen - air) * seen, dtype=np.float32)


def _with_flakes(stored: Floats, rng: np.random.Generator) -> Floats:
    """Falling snow: many small flakes, some larger and blurred ones, all drawn out along one direction."""
    height, width = stored.shape[:2]
    slant, speed = rng.normal(0, 0.4), rng.uniform(0, 3)
    for size, count, dense in ((0.0015, 600, 0.8), (0.003, 120, 0.6), (0.008, 25, 0.4)):
        layer = np.zeros((height, width), dtype=np.float32)
        radius = max(size * width, 0.7)
        for u, v in rng.uniform(0, 1, size=(int(rng.uniform(0, count)), 2)) * (width, height):
            end = (u + speed * radius * np.sin(slant), v + speed * radius * np.cos(slant))
            start, stop = ((round(16 * float(x)), round(16 * float(y))) for x, y in ((u, v), end))
            cv2.line(layer, start, stop, 1.0, max(round(2 * radius), 1), cv2.LINE_AA, 4)
        fallen = softened(layer, 0.5 * radius)[..., None] * np.float32(dense)
        stored = stored + (np.float32(0.95) - stored) * fallen
    return stored


def _long_shadows(sight: Sight, to_sun: Array, rng: np.random.Generator) -> Floats:
    """How much of the sun is hidden (H, W), by things whose outline across the light is the same all along it."""
    right = np.cross(to_sun, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    across = np.stack([sight.points @ right, sight.points @ np.cross(right, to_sun)], axis=-1)
    outline = smooth_field((256, 256), int(rng.integers(12, 40)), rng)
    # There and back, so that it has no edge of its own.
    at = np.abs(np.nan_to_num(across * (256 / rng.uniform(20, 60))) % 510 - 255).astype(np.float32)
    hidden = cv2.remap(outline, np.ascontiguousarray(at[..., 0]), np.ascontiguousarray(at[..., 1]), cv2.INTER_LINEAR)
    return _step(np.asarray(hidden, dtype=np.float32), rng.uniform(-0.5, 0.8), 0.05)
