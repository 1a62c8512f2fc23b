"""The camera's response, from light to grey levels: bloom, exposure, vignetting, tone curve and noise."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from relocbench.arrays import Floats, Image
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.kernels import njit

_KEY = 0.17
_LEAST_GAIN, _MOST_GAIN = 0.05, 5.0
"""limits of the automatic exposure, so that it does not turn night into day"""
_FIXED_GAIN = 0.45
_WHITE = 6.0
_BLOOM = 0.06
_LUMA = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
_TABLE = 4096
_DEVIATES = 4096
_DRAWN = np.uint16(_DEVIATES - 1)


def exposure_gain(image: Floats, factors: Factors) -> float:
    """Exposure factor for linear light, which within limits makes the log-mean luminance of (H, W, 3) middle grey."""
    gain = _FIXED_GAIN
    if factors.auto_exposure:
        luminance = image[::2, ::2] @ _LUMA
        gain = _KEY / float(np.exp(np.log(luminance + 1e-4).mean(dtype=np.float64)))
        gain = min(max(gain, _LEAST_GAIN), _MOST_GAIN)
    out: float = gain * 2.0**factors.exposure_ev
    return out


def apply_response(image: Floats, factors: Factors, rng: np.random.Generator) -> Image:
    """8-bit RGB image (H, W, 3) of linear light (H, W, 3)."""
    gain = exposure_gain(image, factors)
    curve = tone_curve(factors.gamma)
    dark, growth = _noise(factors)
    deviation = np.sqrt(dark + growth * curve).astype(np.float32)
    dice = np.frombuffer(rng.bytes(2 * image.size), dtype="<u2").reshape(image.shape)
    return _develop(image, _bloom(image, gain), dice, gain, factors.vignetting, curve, deviation, _normal_deviates())


@lru_cache(maxsize=1)
def _normal_deviates() -> Floats:
    """(4096,) equally likely values of a normal distribution with deviation 1, to be chosen by twelve random bits."""
    values = ndtri((np.arange(_DEVIATES) + 0.5) / _DEVIATES)
    return np.asarray(values / values.std(), dtype=np.float32)


def tone_curve(gamma: float) -> Floats:
    """Grey levels of light, sqrt-spaced from 0 to :data:`_WHITE`, by Narkowicz's filmic curve (2015) and the gamma."""
    x = np.linspace(0, 1, _TABLE) ** 2 * _WHITE
    level = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)
    out: Floats = (255 * (level / level[-1]) ** (1 / gamma)).astype(np.float32)
    return out


def _noise(factors: Factors) -> tuple[float, float]:
    """Noise variance in the dark, and its increase per grey level by shot noise."""
    return factors.read_noise**2, (255 * factors.shot_noise) ** 2 / 255


def _bloom(image: Floats, gain: float) -> Floats:
    """Light that the lens scatters around very bright pixels, at a quarter of the size."""
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
    dice: NDArray[np.uint16],
    gain: float,
    vignetting: float,
    curve: Floats,
    deviation: Floats,
    deviates: Floats,
) -> Image:
    height, width, _ = image.shape
    rows, columns, _ = glow.shape
    out = np.empty((height, width, 3), dtype=np.uint8)
    corner = 0.25 * ((width - 1) ** 2 + (height - 1) ** 2) + 1e-9
    row = np.empty((columns, 3), dtype=np.float32)
    to_table = np.float32((_TABLE - 1) / np.sqrt(_WHITE))
    last = np.float32(_TABLE - 1.001)
    for y in range(height):
        gy = min(max((y + 0.5) * rows / height - 0.5, 0.0), rows - 1.0)
        j = int(gy)
        j1 = min(j + 1, rows - 1)
        for i in range(columns):
            for c in range(3):
                row[i, c] = glow[j, i, c] + np.float32(gy - j) * (glow[j1, i, c] - glow[j, i, c])
        down2 = (y - 0.5 * (height - 1)) ** 2
        for x in range(width):
            gx = min(max((x + 0.5) * columns / width - 0.5, 0.0), columns - 1.0)
            i = int(gx)
            a = np.float32(gx - i)
            i1 = min(i + 1, columns - 1)
            fall = np.float32(1 - vignetting * ((x - 0.5 * (width - 1)) ** 2 + down2) / corner)
            for c in range(3):
                light = (image[y, x, c] * np.float32(gain) + row[i, c] + a * (row[i1, c] - row[i, c])) * fall
                at = min(np.sqrt(light) * to_table, last)
                k = np.uint64(at)
                level = curve[k] + (at - np.float32(k)) * (curve[k + np.uint64(1)] - curve[k])
                level += deviates[np.uint64(dice[y, x, c] & _DRAWN)] * deviation[k] + np.float32(0.5)
                out[y, x, c] = np.uint8(min(max(level, np.float32(0.0)), np.float32(255.0)))
    return out
