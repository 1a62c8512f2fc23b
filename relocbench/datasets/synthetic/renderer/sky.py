"""Sun and sky: a gradient with the sun's glow, clouds, dusk and night.

In the units of radiance used here, white paper in the sun of a clear noon has about 3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Floats
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.renderer.patterns import SIZE
from relocbench.datasets.synthetic.renderer.textures import MACRO, bake

MAP = 768
"""texels along a side of the sky's map"""
_SCATTERED = 0.35
"""share of the light in shade that has lost the sky's colour"""
_NIGHT = np.array([0.0009, 0.0012, 0.0021])


class Sky(NamedTuple):
    """The light of sun and sky."""

    radiance: Floats
    """(MAP, MAP, 3) in stereographic projection: direction d is at (d.x, d.y) / (1 + d.z) in [-1, 1]"""
    ambient: Floats
    """(3,) mean radiance of the upper hemisphere"""
    horizon: Floats
    """(3,) mean radiance just above the horizon, the colour of fog"""
    to_sun: Floats
    """(3,) unit vector"""
    sun: Floats
    """(3,) radiance of white paper that faces the sun; 0 if the sun is hidden or below the horizon"""


def _smoothstep(x: NDArray[np.floating] | float, low: float, high: float) -> Array:
    t = np.clip((np.asarray(x, dtype=np.float64) - low) / (high - low), 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def sun_direction(factors: Factors) -> Floats:
    """Unit vector (3,) towards the sun; azimuth is clockwise from north (y), elevation above the horizon."""
    elevation, azimuth = np.radians(factors.sun_elevation_deg), np.radians(factors.sun_azimuth_deg)
    flat = np.cos(elevation)
    return np.array([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], dtype=np.float32)


def make_sky(factors: Factors, seed: int) -> Sky:
    """The sky of a condition; the seed chooses the clouds."""
    to_sun = sun_direction(factors)
    y, x = np.mgrid[:MAP, :MAP]
    p, q = (x + 0.5) / MAP * 2 - 1, (y + 0.5) / MAP * 2 - 1
    r2 = np.minimum(p * p + q * q, 1.0)
    scale = 2 / (1 + r2)
    d = np.stack([p * scale, q * scale, (1 - r2) / (1 + r2)], axis=-1)
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    high = d[..., 2]

    day = float(_smoothstep(factors.sun_elevation_deg, -9, 12))
    low_sun = float(1 - _smoothstep(factors.sun_elevation_deg, 1, 22)) * day
    overcast = float(_smoothstep(factors.cloud_cover, 0.45, 1.0))
    towards = np.clip(d @ to_sun.astype(np.float64), -1, 1)

    up = high[..., None] ** 0.45
    clear = np.array([0.50, 0.62, 0.76]) * (1 - up) + np.array([0.10, 0.22, 0.50]) * up
    warm = np.array([1.15, 0.55, 0.22]) * (1 - high[..., None]) ** 4
    facing = _smoothstep(towards, -0.6, 1.0)[..., None]
    clear = clear * (1 - 0.55 * low_sun) + low_sun * warm * (0.15 + 0.95 * facing)
    glow = 0.9 * np.exp((towards - 1) * 14) + 3.0 * np.exp((towards - 1) * 220)
    sun_colour = np.array([1.0, 0.94, 0.84]) * (1 - low_sun) + np.array([1.0, 0.55, 0.24]) * low_sun
    clear = clear + (glow[..., None] * sun_colour) * (1 - overcast)

    thickness = _clouds(d, seed)
    cover = factors.cloud_cover
    share = _smoothstep(thickness, 1.02 - 1.12 * cover, 1.22 - 1.12 * cover)[..., None] * (cover > 0)
    # Near the horizon, distant clouds are seen edge-on and merge into a veil of the mean cover.
    veil = np.exp(-high[..., None] * 12)
    share = share * (1 - veil) + veil * 0.8 * cover
    shade = 0.75 + 0.5 * (thickness[..., None] - 0.5)
    lit = np.array([0.86, 0.87, 0.90]) * (1 - low_sun) + np.array([0.95, 0.62, 0.44]) * low_sun * (0.35 + 0.65 * facing)
    grey = np.array([0.60, 0.63, 0.67]) * (0.75 + 0.35 * high[..., None])
    cloud = lit * (1.15 - 0.55 * share) * (1 - overcast) + grey * shade * overcast
    cloud = cloud + 0.8 * (np.exp((towards - 1) * 30))[..., None] * sun_colour * (1 - overcast)

    strength = day * (0.25 + 0.75 * float(_smoothstep(factors.sun_elevation_deg, -2, 45)))
    radiance = (clear * (1 - share) + cloud * share) * strength
    radiance = radiance + _NIGHT * (1 + 5 * np.exp(-high[..., None] * 6) * np.array([1.5, 1.0, 0.6]))
    radiance = np.minimum(radiance, 8.0).astype(np.float32)

    inside = (p * p + q * q < 1)[..., None] * (scale**2)[..., None]
    ambient = (radiance * inside).sum((0, 1)) / inside.sum()
    # Walls in the sun scatter their light into shade, which is less blue than the sky.
    ambient += _SCATTERED * (ambient.mean() - ambient)
    rim = ((high > 0.01) & (high < 0.12))[..., None] * inside
    horizon = (radiance * rim).sum((0, 1)) / rim.sum()

    elevation = max(float(to_sun[2]), 0.0)
    air = 1 / max(elevation + 0.05, 0.05)
    through = np.exp(-np.array([0.055, 0.105, 0.21]) * air) * float(_smoothstep(factors.sun_elevation_deg, -1, 5))
    hidden = 1 - _smoothstep(cover, 0.35, 0.88)
    sun = 3.3 * through * float(hidden)
    return Sky(radiance, ambient.astype(np.float32), horizon.astype(np.float32), to_sun, sun.astype(np.float32))


def _clouds(d: Array, seed: int) -> Array:
    """Low-frequency noise in [0, 1] on a layer above the town, seen in directions (..., 3)."""
    layer = bake(seed).second(MACRO)
    total = np.zeros(d.shape[:-1])
    for weight, scale in ((0.7, 0.16), (0.3, 0.55)):
        u, v = d[..., 0] / (d[..., 2] + 0.15) * scale, d[..., 1] / (d[..., 2] + 0.15) * scale
        total += weight * _periodic(layer, u, v)
    return total


def _periodic(layer: Floats, u: Array, v: Array) -> Array:
    """Bilinear lookup in a tile that repeats with period 1."""
    x, y = u * SIZE, v * SIZE
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - x0, y - y0
    a, b, c, e = x0 % SIZE, (x0 + 1) % SIZE, y0 % SIZE, (y0 + 1) % SIZE
    return np.asarray(
        (layer[c, a] * (1 - fx) + layer[c, b] * fx) * (1 - fy) + (layer[e, a] * (1 - fx) + layer[e, b] * fx) * fy
    )
