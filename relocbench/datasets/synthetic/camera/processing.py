"""The processing in the camera: white balance, response curve, denoising, sharpening and saturation."""

from __future__ import annotations

import cv2
import numpy as np

from relocbench.arrays import Floats

_LUMA = np.array([0.2126, 0.7152, 0.0722])
"""of red, green and blue (Rec. 709)"""
_WINDOW_PX = 5
_SMOOTH_PX = 1.5


def white_balance(temperature_ev: float, tint_ev: float) -> Floats:
    """Gains (3,) of red, green and blue: 2^temperature_ev of red over blue, 2^tint_ev of green over these two's mean.

    The luminance of grey stays.
    """
    stops = np.array([temperature_ev / 2 - tint_ev / 3, 2 * tint_ev / 3, -temperature_ev / 2 - tint_ev / 3])
    gains = 2.0**stops
    return np.asarray(gains / (_LUMA @ gains), dtype=np.float32)


def response(light: Floats, white: float, gamma: float, contrast: float) -> Floats:
    """Grey levels in [0, 1] of linear light: a shoulder, an exponent and an S, each with one parameter.

    The shoulder is ``L (1 + L / w^2) / (1 + L)`` (Reinhard et al., "Photographic tone reproduction", 2002, equation 4),
    which is the identity for w = 1 and always takes w to 1; light beyond w is white. The S scales the log-odds of a
    level y by the contrast c, ``y^c / (y^c + (1 - y)^c)``: it keeps 0, 1/2 and 1 and has slope c at 1/2. Real cameras'
    curves differ at least as much (Grossberg and Nayar, "What is the space of camera response functions?", 2003).
    """
    x = np.clip(light, 0, np.float32(white))
    level = np.clip(x * (1 + x / np.float32(white**2)) / (1 + x), 0, 1) ** np.float32(1 / gamma)
    if contrast != 1:
        above = level ** np.float32(contrast)
        level = above / (above + (1 - level) ** np.float32(contrast))
    return np.asarray(level, dtype=np.float32)


def to_luma_chroma(rgb: Floats) -> tuple[Floats, Floats]:
    """Luma (H, W) and colour differences (H, W, 2), red and blue minus luma, of levels (H, W, 3)."""
    luma = (rgb @ _LUMA.astype(np.float32)).astype(np.float32)
    return luma, np.ascontiguousarray(rgb[..., ::2] - luma[..., None])


def to_rgb(luma: Floats, chroma: Floats) -> Floats:
    """The inverse of :func:`to_luma_chroma`."""
    red, blue = luma + chroma[..., 0], luma + chroma[..., 1]
    green = luma - (_LUMA[0] * chroma[..., 0] + _LUMA[2] * chroma[..., 1]) / _LUMA[1]
    return np.stack([red, green, blue], axis=-1).astype(np.float32)


def denoise(luma: Floats, strength: float) -> Floats:
    """Luma (H, W) after a bilateral filter (Tomasi and Manduchi, 1998), which keeps steps above ``strength``."""
    if strength <= 0:
        return luma
    return np.asarray(cv2.bilateralFilter(luma, _WINDOW_PX, strength, _SMOOTH_PX), dtype=np.float32)


def smooth_colour(chroma: Floats, sigma_px: float) -> Floats:
    """Colour differences (H, W, 2) after a Gaussian filter."""
    if sigma_px <= 0:
        return chroma
    return np.asarray(cv2.GaussianBlur(chroma, (0, 0), sigma_px), dtype=np.float32)


def sharpen(luma: Floats, weight: float, sigma_px: float) -> Floats:
    """Luma (H, W) after an unsharp mask, ``y + weight (y - G y)`` with a Gaussian G: edges overshoot on both sides."""
    if weight <= 0:
        return luma
    return np.asarray(luma + np.float32(weight) * (luma - cv2.GaussianBlur(luma, (0, 0), sigma_px)), dtype=np.float32)
