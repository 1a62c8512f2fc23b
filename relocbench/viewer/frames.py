"""Where the coordinates of a recording begin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relocbench.arrays import Array


def origin_of(poses: Sequence[Array]) -> Array:
    """A whole-metre point (3,) near poses (4, 4): rerun keeps coordinates in 32 bits, and maps count in 1000 km."""
    if not poses:
        return np.zeros(3)
    return np.asarray(np.rint(poses[0][:3, 3]), dtype=np.float64)
