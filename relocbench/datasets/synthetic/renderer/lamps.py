"""Street lamps and the headlights of the recording car.

At night a unit of irradiance stands for :data:`NIGHT_LUX`. Lamps are road luminaires: their intensity increases towards
the sides, so that the road between two of them is not dark, and ends below the horizon (EN 13201-2:2015: 10 to 30 lx on
the road in classes C4 to C1, the minimum at least 0.4 of the mean). Headlights are dipped beams after UN Regulation
112, class B: brightest just below a sharp cut-off at 1 % below the horizon, with hardly any light above it. Thus only a
part of the road's light moves with the car.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Floats
from relocbench.datasets.synthetic.renderer.vectors import smoothstep
from relocbench.kernels import njit

NIGHT_LUX = 80.0
"""lux per unit of irradiance; by day, when lamps hardly matter, a unit stands for several hundred times as much"""
_LAMP_CELL_M = 8.0
_LAMP_REACH_M = 26.0
_LAMPS_A_CELL = 6
_LAMP_POWER = 7.0
"""intensity straight down, 560 cd; with lamps of 5.6 m every 23 m on both sides this gives 28 lx on average"""
_WIDEST = 0.42
"""cosine of the angle from straight down, 65 degrees, at which a luminaire is brightest"""
_UPWARDS = 0.02
"""light upwards by housing and lit road, relative to the intensity straight down"""
_BEAM_POWER = 250.0
"""greatest intensity of the two headlights, 20 000 cd"""
_CUT_OFF = -0.01
"""sine of the angle above the horizon"""
_ABOVE = 0.03
"""intensity above the cut-off relative to the greatest: at most 350 cd for an oncoming eye (B50L) and 625 cd elsewhere
(zone III), of about 10 000 cd per headlight"""
_FOREGROUND = 0.075
"""angle below the cut-off (as sine) at which the intensity is halved, because the road nearby needs less light"""
_SPREAD = 0.25
"""tangent of the angle to either side at which the intensity has fallen to 1/e"""


class Lamps(NamedTuple):
    """Street lamps with a grid for looking them up."""

    heads: Floats
    """(L, 3)"""
    low: Floats
    """(2,) corner of the first cell"""
    near: NDArray[np.int32]
    """(rows, columns, 6) nearest lamps of each cell, -1 for none"""


class Beam(NamedTuple):
    """Headlights of the car that carries the camera."""

    origin: Floats
    forward: Floats


def make_lamps(heads: NDArray[np.floating]) -> Lamps:
    """Build the grid of the lamps that reach each cell of the town."""
    heads = np.ascontiguousarray(heads, dtype=np.float32).reshape(-1, 3)
    if len(heads) == 0:
        return Lamps(heads, np.zeros(2, np.float32), np.full((1, 1, _LAMPS_A_CELL), -1, np.int32))
    low = heads[:, :2].min(0) - _LAMP_REACH_M
    columns, rows = (np.ceil((heads[:, :2].max(0) + _LAMP_REACH_M - low) / _LAMP_CELL_M).astype(int) + 1).tolist()
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    centre = np.stack([x, y], axis=-1) * _LAMP_CELL_M + low
    distance = np.linalg.norm(centre[:, :, None] - heads[:, :2], axis=-1)
    order = np.argsort(distance, axis=-1, kind="stable")[..., :_LAMPS_A_CELL]
    near = np.full((rows, columns, _LAMPS_A_CELL), -1, np.int32)
    reached = np.take_along_axis(distance, order, -1) < _LAMP_REACH_M + _LAMP_CELL_M
    near[..., : order.shape[-1]] = np.where(reached, order, -1)
    return Lamps(heads, low.astype(np.float32), near)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _luminaire(down: float) -> float:
    """Intensity relative to that straight down, by the cosine of the angle from straight down.

    It grows as 1 / cosine^2 up to the brightest direction, so that the road is lit evenly, and falls to nearly zero at
    the horizon.
    """
    return (1 - _UPWARDS) / max(down, _WIDEST) ** 2 * smoothstep(down, 0.0, _WIDEST) + _UPWARDS


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def strongest_lamp(
    lamps: Lamps, x: float, y: float, z: float, nx: float, ny: float, nz: float
) -> tuple[int, float, float]:
    """The lamp that gives the most light at a point with a normal, its irradiance, and that of all other lamps."""
    column, row = int((x - lamps.low[0]) / _LAMP_CELL_M), int((y - lamps.low[1]) / _LAMP_CELL_M)
    rows, columns, _ = lamps.near.shape
    best, most, total = -1, 0.0, 0.0
    if x < lamps.low[0] or y < lamps.low[1] or column >= columns or row >= rows:
        return best, most, total
    for k in range(_LAMPS_A_CELL):
        lamp = lamps.near[row, column, k]
        if lamp < 0:
            break
        lx, ly, lz = lamps.heads[lamp, 0] - x, lamps.heads[lamp, 1] - y, lamps.heads[lamp, 2] - z
        square = lx * lx + ly * ly + lz * lz
        distance = np.sqrt(square) + 1e-6
        facing = (lx * nx + ly * ny + lz * nz) / distance
        if facing <= 0.0 or distance > _LAMP_REACH_M:
            continue
        down = lz / distance
        fade = 1 - smoothstep(distance, 0.75 * _LAMP_REACH_M, _LAMP_REACH_M)
        power = _LAMP_POWER * _luminaire(down) * facing * fade / (square + 1.0)
        total += power
        if power > most:
            best, most = lamp, power
    return best, most, total - most


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def headlight_irradiance(beam: Beam, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> float:
    """Irradiance at a point with a normal by the dipped headlights of the recording car, modelled as one lamp."""
    dx, dy, dz = x - beam.origin[0], y - beam.origin[1], z - beam.origin[2]
    square = dx * dx + dy * dy + dz * dz
    distance = np.sqrt(square) + 1e-6
    ahead = (dx * beam.forward[0] + dy * beam.forward[1]) / distance
    if ahead <= 0.3:
        return 0.0
    side = dx * beam.forward[1] - dy * beam.forward[0]
    rise = dz / distance
    facing = -(dx * nx + dy * ny + dz * nz) / distance
    below = (rise - _CUT_OFF) / _FOREGROUND
    lobe = _ABOVE + (1 - _ABOVE) * (1 - smoothstep(rise, _CUT_OFF - 0.005, _CUT_OFF + 0.005)) / (1 + below * below)
    lobe *= np.exp(-((side / (ahead * distance * _SPREAD)) ** 2))
    out: float = _BEAM_POWER * max(facing, 0.0) * lobe / (square + 0.5)
    return out
