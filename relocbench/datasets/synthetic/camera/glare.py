"""Light that is scattered in the lens: bloom around what is bright, and a veil over the whole image."""

from __future__ import annotations

import cv2
import numpy as np

from relocbench.arrays import Floats

_NARROW, _WIDE = 0.006, 0.025
"""standard deviations of the bloom's two parts, as shares of the image's width"""
_VEIL = 0.25
"""standard deviation of the part of the veil that follows the light, as a share of the width"""
_BRIGHTEST = 300.0
"""times the mean; brighter light is scattered as if it was that bright"""


def scatter(light: Floats, bloom: float, veil: float) -> Floats:
    """The light (H, W, 3) of which the lens scatters some.

    The glare spread function is a point and three Gaussians and a constant, ``(1 - bloom - veil) I + bloom B + veil V``
    (Talvala et al., "Veiling glare in high dynamic range imaging", 2007, measure such functions). No light is added or
    lost, except that of lights beyond a bound.
    """
    if bloom <= 0 and veil <= 0:
        return light
    width = light.shape[1]
    bounded = np.minimum(light, np.float32(_BRIGHTEST) * light.mean(dtype=np.float64).astype(np.float32))
    near = 0.6 * _blurred(bounded, _NARROW * width) + 0.4 * _blurred(bounded, _WIDE * width)
    mean = bounded.mean(axis=(0, 1), dtype=np.float64).astype(np.float32)
    far = 0.5 * _blurred(bounded, _VEIL * width) + 0.5 * mean
    return np.asarray((1 - bloom - veil) * light + bloom * near + veil * far, dtype=np.float32)


def _blurred(light: Floats, sigma_px: float) -> Floats:
    """A Gaussian blur, of a smaller image where that shows no difference."""
    height, width = light.shape[:2]
    shrink = max(1, int(sigma_px / 3))
    size = max(1, width // shrink), max(1, height // shrink)
    small = cv2.resize(light, size, interpolation=cv2.INTER_AREA) if shrink > 1 else light
    sigma = max(sigma_px * size[0] / width, 1e-3)
    small = cv2.GaussianBlur(small, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    if shrink == 1:
        return np.asarray(small, dtype=np.float32)
    return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32)
