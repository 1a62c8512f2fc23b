"""Gauss-Newton on single pixels, from a start nearby to the query pixel that shows the point of a reference pixel.

For a pixel u of the reference and a position x in the query (von Stumberg et al., GN-Net, RA-L 2020, section III; the
problem that its loss is about):

    r = F_q(x) - F_r(u)      J = dF_q/dx (x)      x <- x - (J^T J + eps I)^-1 J^T r

on one level after another, coarse to fine. With D >= 2 channels one pixel is enough. With one channel J^T J of a pixel
has rank 1 (the aperture problem), so that the residuals of a pattern of pixels around u are stacked; the pattern is
shifted, never warped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from baselines.alignment.shared.pyramid import Level
from relocbench.arrays import Array, Floats, Mask
from relocbench.kernels import njit

Pattern = tuple[tuple[float, float], ...]
SINGLE_PIXEL: Pattern = ((0, 0),)
DSO_PATTERN: Pattern = ((0, -2), (-1, -1), (1, -1), (-2, 0), (0, 0), (2, 0), (-1, 1), (0, 2))
"""offsets (u, v) of the eight pixels of DSO's residual pattern (Engel et al., 2018, figure 4)"""

SMALLEST_STEP = 1e-3
"""pixels; a shorter step ends a level"""
BRIGHTNESS_MODELS = {"none": 0, "affine": 2}
"""and how many degrees of freedom each of them takes out of a channel"""


@dataclass(frozen=True)
class MatchSettings:
    """Pattern, brightness model, damping and iterations."""

    pattern: Pattern = SINGLE_PIXEL
    """offsets (u, v) of the pixels whose residuals are stacked, in pixels of the level"""
    brightness: Literal["none", "affine"] = "none"
    """changes of brightness that the residuals are invariant to: ``affine`` subtracts from both images the mean of each
    channel over the pattern, and divides by the norm of what remains"""
    damping: float = 1e-6
    """eps, relative to the mean of the diagonal of J^T J, so that it does not depend on the features' scale"""
    longest_step: float = 2.0
    """pixels of a level; longer steps are shortened to it, since J is not valid that far away"""
    iterations: int = 20
    """largest number on each level"""

    def equations(self, channels: int) -> int:
        """The number of independent residuals once the brightness is taken out."""
        return channels * (len(self.pattern) - BRIGHTNESS_MODELS[self.brightness])


def match_pixels(
    reference: Sequence[Level], query: Sequence[Level], uv_ref: Array, uv_start: Array, settings: MatchSettings
) -> Array:
    """Run Gauss-Newton for each pixel on all levels that both images have, coarsest first.

    A level on which the pattern leaves one of the maps, or whose normal equations are singular, leaves a pixel where it
    was; if that happens on the finest level, the pixel is not found. Pixels do not influence each other.

    Args:
        reference: maps of each level, finest first.
        query: likewise, with the same number of channels.
        uv_ref: (N, 2) pixels of the reference, which need not be integers.
        uv_start: (N, 2) pixels of the query to start from.

    Returns:
        (N, 2) pixels of the query; NaN where a pixel is not found.

    Raises:
        ValueError: shapes or channels disagree, or a pixel has fewer than two independent residuals.
    """
    common = min(len(reference), len(query))
    return _match_on(range(common), reference, query, uv_ref, uv_start, settings)


def match_pixels_by_level(
    reference: Sequence[Level], query: Sequence[Level], uv_ref: Array, uv_start: Array, settings: MatchSettings
) -> list[Array]:
    """Run Gauss-Newton for each pixel on each level alone, from the same starts.

    Arguments and errors are those of :func:`match_pixels`.

    Returns:
        For each level, finest first, (N, 2) pixels of the finest level; NaN where a pixel is not found.
    """
    common = min(len(reference), len(query))
    return [_match_on([level], reference, query, uv_ref, uv_start, settings) for level in range(common)]


def _match_on(
    levels: Sequence[int],
    reference: Sequence[Level],
    query: Sequence[Level],
    uv_ref: Array,
    uv_start: Array,
    settings: MatchSettings,
) -> Array:
    """Match on some levels, which are given finest first and worked on coarsest first."""
    n, channels = len(uv_ref), reference[0].channels
    if np.shape(uv_ref) != (n, 2) or np.shape(uv_start) != (n, 2) or query[0].channels != channels:
        raise ValueError(
            f"matching needs uv_ref and uv_start (N, 2) and maps with equally many channels; got {np.shape(uv_ref)}, "
            f"{np.shape(uv_start)} and {channels}, {query[0].channels} channels"
        )
    if settings.equations(channels) < 2:
        raise ValueError(
            f"{len(settings.pattern)} pixels of {channels} channels (brightness: {settings.brightness}) leave "
            f"{max(settings.equations(channels), 0)} residuals for two unknowns; take a larger pattern"
        )
    wanted = np.array(uv_ref, dtype=np.float64, order="C")
    uv = np.array(uv_start, dtype=np.float64, order="C")
    pattern = np.array(settings.pattern, dtype=np.float64)
    moved = np.zeros(n, dtype=np.bool_)
    for level in reversed(levels):
        moved = _match_level(
            reference[level].map,
            query[level].map,
            float(1 << level),
            wanted,
            uv,
            pattern,
            settings.brightness == "affine",
            settings.damping,
            settings.longest_step,
            settings.iterations,
        )
    height, width = query[0].map.shape[:2]
    inside = np.all((uv >= 0) & (uv <= [width - 1, height - 1]), axis=1)
    return np.where((moved & inside)[:, None], uv, np.nan)


@njit(cache=True, error_model="numpy")
def _sample(level_map: Floats, x: float, y: float, pattern: Array, out: Array) -> bool:
    """Write values, x and y derivatives (3, P D) of the pattern around a pixel; False if it leaves the map."""
    height, width, depth = level_map.shape
    channels = depth // 3
    for p in range(len(pattern)):
        px, py = x + pattern[p, 0], y + pattern[p, 1]
        # The outermost pixels have no derivative. The comparisons are also false for NaN.
        if not (px >= 1.0 and py >= 1.0 and px <= width - 2.0 and py <= height - 2.0):
            return False
        ix, iy = int(px), int(py)
        ax, ay = px - ix, py - iy
        w11 = ax * ay
        w10, w01 = ay - w11, ax - w11
        w00 = 1.0 - ax - w10
        m00, m01 = level_map[iy, ix], level_map[iy, ix + 1]
        m10, m11 = level_map[iy + 1, ix], level_map[iy + 1, ix + 1]
        for k in range(3):
            for c in range(channels):
                j = k * channels + c
                out[k, p * channels + c] = w00 * m00[j] + w01 * m01[j] + w10 * m10[j] + w11 * m11[j]
    return True


@njit(cache=True, error_model="numpy")
def _remove_brightness(samples: Array, channels: int) -> bool:
    """Take the mean and the norm of each channel out of the values and, by the chain rule, out of the derivatives.

    With v the values minus their mean and n = v / |v|: d(v / |v|) = (dv - n (n dv)) / |v|. False if |v| is 0, since the
    gain of a pattern without contrast is undetermined.
    """
    size = samples.shape[1] // channels
    for c in range(channels):
        part = samples[:, c::channels]
        for k in range(3):
            part[k] -= np.sum(part[k]) / size
        norm = np.sqrt(np.sum(part[0] * part[0]))
        if not norm > 0.0:
            return False
        part[0] /= norm
        for k in range(1, 3):
            part[k] = (part[k] - part[0] * np.sum(part[0] * part[k])) / norm
    return True


@njit(cache=True, error_model="numpy")
def _match_level(
    reference_map: Floats,
    query_map: Floats,
    scale: float,
    uv_ref: Array,
    uv: Array,
    pattern: Array,
    affine: bool,
    damping: float,
    longest_step: float,
    iterations: int,
) -> Mask:
    """Move ``uv`` (N, 2), pixels of the finest level, on the level ``scale`` times smaller; (N,) which were found."""
    n = len(uv)
    channels = reference_map.shape[2] // 3
    wanted, samples = np.empty((3, len(pattern) * channels)), np.empty((3, len(pattern) * channels))
    moved = np.zeros(n, np.bool_)
    for i in range(n):
        # A pixel of a coarse level covers scale x scale pixels: (u + 0.5) / scale - 0.5 is its coordinate there.
        u, v = (uv_ref[i, 0] + 0.5) / scale - 0.5, (uv_ref[i, 1] + 0.5) / scale - 0.5
        if not _sample(reference_map, u, v, pattern, wanted):
            continue
        if affine and not _remove_brightness(wanted, channels):
            continue
        x, y = (uv[i, 0] + 0.5) / scale - 0.5, (uv[i, 1] + 0.5) / scale - 0.5
        found = False
        for _ in range(iterations):
            found = _sample(query_map, x, y, pattern, samples)
            if found and affine:
                found = _remove_brightness(samples, channels)
            if not found:
                break
            hxx, hxy, hyy, bx, by = 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(samples.shape[1]):
                r, gx, gy = samples[0, j] - wanted[0, j], samples[1, j], samples[2, j]
                hxx += gx * gx
                hxy += gx * gy
                hyy += gy * gy
                bx += gx * r
                by += gy * r
            eps = damping * 0.5 * (hxx + hyy)
            hxx += eps
            hyy += eps
            determinant = hxx * hyy - hxy * hxy
            found = determinant > 0.0
            if not found:
                break
            dx, dy = (hyy * bx - hxy * by) / determinant, (hxx * by - hxy * bx) / determinant
            length = np.sqrt(dx * dx + dy * dy)
            cut = min(1.0, longest_step / length) if length > 0.0 else 1.0
            x -= cut * dx
            y -= cut * dy
            if length <= SMALLEST_STEP:
                break
        if found:
            uv[i, 0], uv[i, 1] = (x + 0.5) * scale - 0.5, (y + 0.5) * scale - 0.5
            moved[i] = True
    return moved
