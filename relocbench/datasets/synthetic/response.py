"""From light to grey levels: bloom, exposure, vignetting, tone curve and noise."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from relocbench.datasets.synthetic.condition import Factors

Floats = NDArray[np.float32]
_KEY = 0.17
_LEAST_GAIN, _MOST_GAIN = 0.05, 5.0
"""an automatic exposure does not turn night into day"""
_FIXED_GAIN = 0.45
_WHITE = 6.0
_BLOOM = 0.06
_LUMA = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
_TABLE = 4096


def exposure_gain(image: Floats, factors: Factors) -> float:
    """Factor on linear light: the log-mean luminance of the image (H, W, 3) becomes middle grey, within limits."""
    gain = _FIXED_GAIN
    if factors.auto_exposure:
        luminance = image[::2, ::2] @ _LUMA
        gain = _KEY / float(np.exp(np.log(luminance + 1e-4).mean(dtype=np.float64)))
        gain = min(max(gain, _LEAST_GAIN), _MOST_GAIN)
    return gain * 2.0**factors.exposure_ev


def respond(image: Floats, factors: Factors, rng: np.random.Generator) -> NDArray[np.uint8]:
    """8-bit RGB of linear light (H, W, 3)."""
    gain = exposure_gain(image, factors)
    grain = rng.standard_normal(image.shape, dtype=np.float32)
    return _develop(
        image, _bloom(image, gain), grain, gain, factors.vignetting, tone_curve(factors.gamma), *_noise(factors)
    )


def tone_curve(gamma: float) -> Floats:
    """Grey levels of light sqrt-spaced from 0 to :data:`_WHITE`: Narkowicz's filmic curve (2015), then the gamma."""
    x = np.linspace(0, 1, _TABLE) ** 2 * _WHITE
    level = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)
    return (255 * (level / level[-1]) ** (1 / gamma)).astype(np.float32)


def _noise(factors: Factors) -> tuple[float, float]:
    """Variance in the dark, and its growth per grey level: photons arrive independently."""
    return factors.read_noise**2, (255 * factors.shot_noise) ** 2 / 255


def _bloom(image: Floats, gain: float) -> Floats:
    """Light that the lens scatters around what is brighter than white, at a quarter of the size."""
    height, width = image.shape[:2]
    small = cv2.resize(image, (max(1, width // 4), max(1, height // 4)), interpolation=cv2.INTER_AREA)
    bright = np.minimum(np.maximum(small * gain - 1.5, 0), 12).astype(np.float32)
    if not bright.any():
        return np.zeros_like(bright)
    scale = width / 512
    glow = cv2.GaussianBlur(bright, (0, 0), 1.5 * scale) + 0.5 * cv2.GaussianBlur(bright, (0, 0), 6.0 * scale)
    return np.asarray(glow * np.float32(_BLOOM), dtype=np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _develop(
    image: Floats,
    glow: Floats,
    grain: Floats,
    gain: float,
    vignetting: float,
    curve: Floats,
    dark: float,
    growth: float,
) -> NDArray[np.uint8]:
    height, width, _ = image.shape
    rows, columns, _ = glow.shape
    out = np.empty((height, width, 3), dtype=np.uint8)
    corner = 0.25 * ((width - 1) ** 2 + (height - 1) ** 2) + 1e-9
    for y in range(height):
        gy = min(max((y + 0.5) * rows / height - 0.5, 0.0), rows - 1.0)
        j = int(gy)
        b = gy - j
        j1 = min(j + 1, rows - 1)
        for x in range(width):
            gx = min(max((x + 0.5) * columns / width - 0.5, 0.0), columns - 1.0)
            i = int(gx)
            a = gx - i
            i1 = min(i + 1, columns - 1)
            fall = 1 - vignetting * ((x - 0.5 * (width - 1)) ** 2 + (y - 0.5 * (height - 1)) ** 2) / corner
            for c in range(3):
                upper = glow[j, i, c] * (1 - a) + glow[j, i1, c] * a
                lower = glow[j1, i, c] * (1 - a) + glow[j1, i1, c] * a
                light = (image[y, x, c] * gain + upper * (1 - b) + lower * b) * fall
                at = min(np.sqrt(light / _WHITE), 1.0) * (_TABLE - 1)
                k = min(int(at), _TABLE - 2)
                level = curve[k] + (at - k) * (curve[k + 1] - curve[k])
                level += grain[y, x, c] * np.sqrt(dark + growth * level)
                out[y, x, c] = np.uint8(min(max(level + 0.5, 0.0), 255.0))
    return out
