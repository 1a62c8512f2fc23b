"""Weather between the scene and the camera: falling rain and snow.

Images are in linear light; all randomness comes from the generators that are passed.
"""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Floats
from relocbench.kernels import njit

_NEAR_M, _FAR_M = 0.8, 14.0
_RAIN_EXPOSURE_S, _SNOW_EXPOSURE_S = 0.012, 0.004
_RAIN_SPEED, _SNOW_SPEED = 7.5, 1.2
_DROPS_PER_MM_H = 0.16
"""visible streaks per cubic metre and mm/h"""
_STREAK_M = 0.0032
"""width of a streak: that of a large drop and of its defocus at this distance"""
_RAIN_OPACITY, _SNOW_OPACITY = 0.15, 0.35
"""opacity of a streak: a drop brightens a pixel for a tenth of the exposure (Garg and Nayar, CVPR 2004)"""
_FLAKES_PER_MM_H = 2.2


def falling_extinction(rain_mm_h: float, snow_mm_h: float) -> float:
    """Extinction of light by rain and snow, 1/m (Atlas 1953 for rain; that of snow is about ten times as large)."""
    out: float = 2.0e-4 * rain_mm_h**0.63 + 2.5e-3 * snow_mm_h**0.8
    return out


def _in_view(rng: np.random.Generator, per_m3: float, focal: tuple[float, float], size: tuple[int, int]) -> Floats:
    """Random particles, uniform over the visible volume: (N, 3) u, v and depth."""
    width, height = size
    volume = width * height / (focal[0] * focal[1]) * (_FAR_M**3 - _NEAR_M**3) / 3
    count = rng.poisson(per_m3 * volume)
    depth = np.cbrt(rng.uniform(_NEAR_M**3, _FAR_M**3, count))
    return np.stack([rng.uniform(-20, width + 20, count), rng.uniform(-20, height + 20, count), depth], 1).astype(
        np.float32
    )


def draw_precipitation(
    image: Floats,
    depth: Floats,
    focal: tuple[float, float],
    down: tuple[float, float],
    rain_mm_h: float,
    snow_mm_h: float,
    light: Floats,
    rng: np.random.Generator,
) -> None:
    """Draw streaks of rain and flakes of snow into a linear image (H, W, 3), in front of farther objects.

    Args:
        depth: (H, W) metres, 0 for the sky.
        down: unit vector in the image in which things fall.
        light: (3,) radiance of the particles.
    """
    height, width = depth.shape
    slant = rng.normal(0, 0.06)
    fall = np.array([down[0] + slant, down[1]], dtype=np.float32)
    if rain_mm_h > 0:
        drops = _in_view(rng, _DROPS_PER_MM_H * rain_mm_h, focal, (width, height))
        factor = rng.uniform(0.7, 1.3, len(drops)).astype(np.float32)
        length = factor * (_RAIN_SPEED * _RAIN_EXPOSURE_S * focal[1]) / drops[:, 2]
        radius = 0.5 * _STREAK_M * focal[0] / drops[:, 2]
        _streaks(image, depth, drops, length, radius, fall, light * np.float32(1.25), _RAIN_OPACITY)
    if snow_mm_h > 0:
        flakes = _in_view(rng, _FLAKES_PER_MM_H * snow_mm_h, focal, (width, height))
        length = _SNOW_SPEED * _SNOW_EXPOSURE_S * focal[1] / flakes[:, 2]
        radius = rng.uniform(0.0025, 0.006, len(flakes)).astype(np.float32) * focal[0] / flakes[:, 2]
        _streaks(image, depth, flakes, length, radius, fall, light * np.float32(1.3), _SNOW_OPACITY)


@njit(cache=True, nogil=True, error_model="numpy")
def _streaks(
    image: Floats,
    depth: Floats,
    at: Floats,
    length: Floats,
    radius: Floats,
    fall: Floats,
    light: Floats,
    opacity: float,
) -> None:
    """Draw particles as soft capsules; those thinner than a pixel cover less of it, so that their light is the same."""
    height, width = depth.shape
    for k in range(len(at)):
        u, v, z = at[k, 0], at[k, 1], at[k, 2]
        du, dv = fall[0] * length[k], fall[1] * length[k]
        r = max(radius[k], 0.6)
        cover = opacity * min(1.0, radius[k] / r) * min(1.0, 1.5 * z / (z + 1))
        reach = r + 1
        for y in range(max(0, int(min(v, v + dv) - reach)), min(height, int(max(v, v + dv) + reach) + 2)):
            for x in range(max(0, int(min(u, u + du) - reach)), min(width, int(max(u, u + du) + reach) + 2)):
                if 0.0 < depth[y, x] < z:
                    continue
                t = ((x - u) * du + (y - v) * dv) / max(du * du + dv * dv, 1e-9)
                t = min(max(t, 0.0), 1.0)
                gap = np.sqrt((x - u - t * du) ** 2 + (y - v - t * dv) ** 2)
                a = cover * min(max(r + 0.5 - gap, 0.0), 1.0)
                if a > 0.0:
                    for c in range(3):
                        image[y, x, c] += a * (light[c] - image[y, x, c])
