"""Street lamps and the own car's headlights."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from relocbench.datasets.synthetic.vectors import smooth

Floats = NDArray[np.float32]
_LAMP_CELL_M = 8.0
_LAMP_REACH_M = 26.0
_LAMPS_A_CELL = 6
_LAMP_POWER = 10.0
_BEAM_POWER = 96.0


class Lamps(NamedTuple):
    """Street lamps by place."""

    heads: Floats
    """(L, 3)"""
    low: Floats
    """(2,) corner of the first cell"""
    near: NDArray[np.int32]
    """(rows, columns, 6) nearest lamps of a cell, -1 for none"""


class Beam(NamedTuple):
    """Headlights of the car that carries the camera."""

    origin: Floats
    forward: Floats


def make_lamps(heads: NDArray[np.floating]) -> Lamps:
    """Which lamps reach which cell of the town."""
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


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def strongest(lamps: Lamps, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> tuple[int, float, float]:
    """The lamp that gives most light at a point, its irradiance, and that of all others."""
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
        lobe = smooth(lz / distance, -0.25, 0.5)
        fade = 1 - distance / _LAMP_REACH_M
        power = _LAMP_POWER * facing * lobe * fade / (square + 4.0)
        total += power
        if power > most:
            best, most = lamp, power
    return best, most, total - most


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def beam_light(beam: Beam, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> float:
    """Irradiance by the dipped headlights of the own car."""
    dx, dy, dz = x - beam.origin[0], y - beam.origin[1], z - beam.origin[2]
    square = dx * dx + dy * dy + dz * dz
    distance = np.sqrt(square) + 1e-6
    ahead = (dx * beam.forward[0] + dy * beam.forward[1]) / distance
    if ahead <= 0.3:
        return 0.0
    rise = dz / distance
    facing = -(dx * nx + dy * ny + dz * nz) / distance
    lobe = smooth(ahead, 0.75, 0.99) * (1 - smooth(rise, -0.01, 0.06) * 0.93)
    return _BEAM_POWER * max(facing, 0.0) * lobe / (square + 30.0)
