"""Paths through positions: how far along each lies, and rows that are spaced along it."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array


def path_lengths(positions: Array) -> Array:
    """Metres (N,) along a path from the first of its positions (N, D) to each."""
    return np.cumsum(np.linalg.norm(np.diff(positions, axis=0, prepend=positions[:1]), axis=1))


def spaced(positions: Array, apart_m: float) -> list[int]:
    """Rows of positions (N, D) at least ``apart_m`` along the path from the one before, the first among them."""
    rows, last = [], -np.inf
    for row, metres in enumerate(path_lengths(positions).tolist()):
        if metres - last >= apart_m - 1e-9:
            rows.append(row)
            last = metres
    return rows
