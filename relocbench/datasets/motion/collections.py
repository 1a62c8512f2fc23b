"""Poses of photographs in no order: they have no motion, but a place among the others."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array

_FAR = 20.0
"""times that the nearest of the others is farther away than most are from the middle. Models of buildings have views
from afar, and those of roads are long, but neither has a gap of ten times its own extent; images that are registered
wrongly, and poses with a wrong digit, have"""
_MOST = 0.9
_FEWEST = 5


def far_from_all(positions: Array) -> list[tuple[int, float]]:
    """Rows of positions (N, 3) far from most others, and metres to the nearest of these; none of fewer than five."""
    if len(positions) < _FEWEST:
        return []
    from_middle = np.linalg.norm(positions - np.median(positions, axis=0), axis=1)
    limit = _FAR * float(np.quantile(from_middle, _MOST, method="lower"))
    near = positions[from_middle <= limit]
    rows = np.flatnonzero(from_middle > limit)
    nearest = [float(np.linalg.norm(near - positions[row], axis=1).min()) for row in rows]
    return [(int(row), metres) for row, metres in zip(rows, nearest, strict=True) if metres > limit > 0]
