"""What use and repairs leave on a street: wheel tracks, seams, patches, trenches, covers, cracks, drains, oil and dirt.

Everything is laid along and across the street, in the surface coordinates of its asphalt (``town/carriageway.py``), and
is averaged over a pixel's footprint there.
"""

from __future__ import annotations

import numpy as np

from relocbench.datasets.synthetic.renderer.materials import scramble
from relocbench.datasets.synthetic.renderer.vectors import smoothstep
from relocbench.datasets.synthetic.town.network import LANE_M, PARKING_M
from relocbench.kernels import njit

_TRACK_M = 0.74
"""distance of the wheels from the middle of a lane"""
_CELL_M = 6.5
"""length of the pieces of a lane, each of which has one repair, cover, crack, stain or nothing"""
_SECTION_M = 34.0
"""length of the pieces of a street that were surfaced at the same time"""
_DRAIN_M = 19.0
"""distance of drains along a kerb"""
_SEAM = 0.42
"""darkness of a sealed seam"""


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _share(low: float, high: float, x: float, half: float) -> float:
    """Share of [x - half, x + half] that lies in [low, high]."""
    return max(min(x + half, high) - max(x - half, low), 0.0) / (2 * half)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _part(dice: int, first: int) -> float:
    """Eight bits of a number, in [0, 1]."""
    return ((dice >> first) & 255) / 255.0


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _cut(x: float, y: float, a: float, b: float, half_x: float, half_y: float, tone: float) -> float:
    """Brightness of a filled cut of 2 a x 2 b about the origin, with a sealed seam around it; 1 outside."""
    if abs(x) > a + half_x + 0.03 or abs(y) > b + half_y + 0.03:
        return 1.0
    inner = _share(-a, a, x, half_x) * _share(-b, b, y, half_y)
    outer = _share(-a - 0.03, a + 0.03, x, half_x) * _share(-b - 0.03, b + 0.03, y, half_y)
    return 1.0 + (tone - 1.0) * inner - _SEAM * (outer - inner)


@njit(cache=True, nogil=True, error_model="numpy")
def _in_cell(dice: int, x: float, y: float, half_x: float, half_y: float) -> float:
    """Brightness of what a piece of a lane has at (x, y) metres along and across from its middle."""
    kind = dice & 15
    more = scramble(dice, 31)
    one, two, three = _part(more, 0), _part(more, 8), _part(more, 16)
    x, y = x - 1.2 * (_part(dice, 4) - 0.5), y - 1.1 * (_part(dice, 12) - 0.5)
    if kind < 4:
        return _cut(x, y, 0.35 + 1.4 * one, 0.3 + 0.55 * two, half_x, half_y, 0.74 + 0.36 * three)
    if kind < 6:
        # A cover in a square that was cut out for it.
        around = _cut(x, y, 0.48, 0.48, half_x, half_y, 0.8 + 0.3 * three) if one < 0.5 else 1.0
        away, edge = np.sqrt(x * x + y * y), max(half_x, half_y, 0.01)
        lid = 1 - smoothstep(away, 0.31 - edge, 0.31 + edge)
        ring = min(1.0, 0.03 / edge) * (1 - smoothstep(abs(away - 0.34), 0.015, 0.015 + edge))
        return around * (1 - (0.2 + 0.25 * two) * lid) * (1 - 0.4 * ring)
    if kind < 8:
        # A crack along the lane, sealed or open.
        width = 0.03 if one < 0.5 else 0.008
        wander = 0.10 * np.sin(1.3 * x + 6 * two) + 0.04 * np.sin(5.3 * x + 6 * three)
        tapered = 1 - smoothstep(abs(x), 1.5 + one, 2.6)
        return 1 - 0.5 * tapered * _share(-width, width, y - wander, half_y + 0.3 * half_x)
    if kind < 10:
        # A crack across it.
        width = 0.03 if one < 0.5 else 0.01
        wander = 0.14 * np.sin(1.7 * y + 6 * two) + 0.05 * np.sin(6.1 * y + 6 * three)
        tapered = 1 - smoothstep(abs(y), 1.2, 1.7)
        return 1 - 0.5 * tapered * _share(-width, width, x - wander, half_x + 0.3 * half_y)
    if kind < 12:
        away = np.sqrt(x * x + 2 * y * y) / (0.25 + 0.8 * one)
        return 1 - (0.12 + 0.2 * two) * (1 - smoothstep(away, 0.2, 1.0))
    return 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def street_wear(
    u: float, v: float, variant: np.int64, half_u: float, half_v: float, slow: float, seed: int
) -> tuple[float, float, float]:
    """Brightness of the asphalt at a place, how much wheels roll there, and how much dirt lies there, both in [0, 1].

    Args:
        u, v: metres along the street from the nearer crossing and from its centre line.
        variant: of the asphalt, odd where a parking lane is beside.
        half_u, half_v: half the footprint of a pixel along and across the street, metres.
        slow: low-frequency noise in [0, 1].
    """
    kerb = LANE_M + PARKING_M * (variant & 1)
    street = scramble(variant >> 1, seed)
    half_u, half_v = max(half_u, 0.004), max(half_v, 0.004)
    aside = abs(v)
    side = 1 if v > 0 else 0

    # Pieces that were surfaced together. One side of the street may be older than the other.
    section = np.floor((u + 20 * _part(street, 0)) / _SECTION_M)
    alike = 0 if street & 256 else side
    tone = 0.86 + 0.28 * _part(scramble(street, np.int64(section) * 2 + alike), 3)
    into = u + 20 * _part(street, 0) - section * _SECTION_M
    tone *= 1 - _SEAM * _share(0.0, 0.03, into, half_u)

    # Wheels polish two tracks in each lane, and engines drip between them.
    free = smoothstep(u, 6.0, 18.0)
    lateral = abs(aside - LANE_M / 2 + 0.1 * np.sin(0.11 * u + 6 * _part(street, 4)))
    track = (1 - smoothstep(abs(lateral - _TRACK_M), 0.12, 0.42)) * free + 0.3 * (1 - free)
    dripped = (1 - smoothstep(lateral, 0.05, 0.5)) * free
    tone *= 1 + (0.05 + 0.2 * _part(street, 9)) * track * free * (0.5 + slow)
    tone *= 1 - (0.1 + 0.18 * _part(street, 17)) * dripped * (0.4 + slow)

    # The joint between the strips in which the asphalt was laid, and that to the parking lane.
    joint = v - 0.5 * (_part(street, 11) - 0.5) - 0.02 * np.sin(0.9 * u)
    tone *= 1 - 0.35 * _share(-0.018, 0.018, joint, half_v)
    if variant & 1:
        tone *= 1 - 0.3 * _share(-0.02, 0.02, aside - LANE_M - 0.05, half_v)
        if aside > LANE_M:
            tone *= 0.92 + 0.1 * slow

    # Trenches: one along a part of the street, others across it.
    trench = scramble(street, 5)
    if trench & 3:
        from_m, length = 8 + 25 * _part(trench, 2), 8 + 30 * _part(trench, 10)
        y = v - 5.0 * (_part(trench, 18) - 0.5)
        x = u - from_m - length / 2
        tone *= _cut(x, y, length / 2, 0.3 + 0.2 * _part(trench, 24), half_u, half_v, 0.78 + 0.3 * _part(trench, 6))
    column = np.floor(u / 21.0)
    trench = scramble(street + 7, np.int64(column))
    if trench & 1:
        x = u - (column + 0.2 + 0.6 * _part(trench, 2)) * 21.0
        reach = 6.0 if trench & 1024 else 3.0
        y = v - (0.0 if trench & 1024 else (3.0 if trench & 2048 else -3.0))
        tone *= _cut(x, y, 0.25 + 0.2 * _part(trench, 12), reach, half_u, half_v, 0.78 + 0.3 * _part(trench, 20))

    column, row = np.floor(u / _CELL_M), np.floor(v / LANE_M)
    dice = scramble(street + 3, np.int64(column) * 8 + np.int64(row))
    tone *= _in_cell(dice, u - (column + 0.5) * _CELL_M, v - (row + 0.5) * LANE_M, half_u, half_v)

    # Dirt collects along the kerb, where drains are.
    to_kerb = kerb - aside
    dirt = 1 - smoothstep(to_kerb, 0.05, 0.25 + 0.5 * slow)
    tone *= 1 - 0.3 * dirt
    if to_kerb < 0.6:
        x = u + 19 * _part(street, 13 + side) - _DRAIN_M * np.floor((u + 19 * _part(street, 13 + side)) / _DRAIN_M) - 9
        inside = _share(-0.26, 0.26, x, half_u) * _share(0.06, 0.42, to_kerb, half_v)
        bars = 0.5 + 0.5 * np.sin(x * 2 * np.pi / 0.065) * max(0.0, 1 - 40 * half_u)
        tone *= 1 - inside * (0.35 + 0.45 * bars)
    return tone, track, dirt
