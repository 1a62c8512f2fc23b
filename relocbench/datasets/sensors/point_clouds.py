"""PLY and PCD files of any properties.

Both are read here rather than by a library: what they declare is held against the file's size before memory is taken,
and a damaged file is an error that names it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.sensors.pcd import parse_pcd
from relocbench.datasets.sensors.ply import parse_ply
from relocbench.datasets.sensors.point_table import MOST_SCAN_BYTES
from relocbench.errors import DatasetError
from relocbench.files import read_bytes


def read_point_cloud(path: Path) -> dict[str, NDArray[Any]]:
    """Name -> (N,) of each property of the points, of the file's type, with ``x``, ``y`` and ``z``.

    Raises:
        DatasetError: missing, no PLY or PCD, cut off, damaged, or without x, y, z.
    """
    kind = path.suffix[1:].upper()
    data = read_bytes(path, f"a {kind}", DatasetError, MOST_SCAN_BYTES)
    fields = parse_ply(data, path) if kind == "PLY" else parse_pcd(data, path)
    if fields and all(len(values) == 0 for values in fields.values()):
        return {axis: np.empty(0) for axis in "xyz"}
    if not fields.keys() >= set("xyz"):
        raise DatasetError(f"cannot be read as {kind}, or has no x, y, z", path)
    return fields
