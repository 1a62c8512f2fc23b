"""PLY and PCD files with arbitrary properties.

They are parsed here rather than by a library so that the declared size can be compared with the real one before memory
is allocated, and so that a damaged file is reported by name.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.sensors.cloud_formats.pcd import parse_pcd
from relocbench.datasets.sensors.cloud_formats.ply import parse_ply
from relocbench.datasets.sensors.cloud_formats.point_table import MOST_SCAN_BYTES
from relocbench.errors import DatasetError, quoted
from relocbench.files import read_bytes


def read_point_cloud(path: Path, most_bytes: int = MOST_SCAN_BYTES) -> dict[str, NDArray[Any]]:
    """The properties of the points, among them ``x``, ``y`` and ``z``: name -> (N,), with the file's types.

    Raises:
        DatasetError: the file is missing, not a PLY or PCD, truncated, damaged, or without x, y, z.
    """
    kind = path.suffix[1:].upper()
    data = read_bytes(path, f"a {kind}", DatasetError, most_bytes)
    fields = parse_ply(data, path) if kind == "PLY" else parse_pcd(data, path)
    if fields and all(len(values) == 0 for values in fields.values()):
        return {axis: np.empty(0) for axis in "xyz"}
    return with_axes(fields, path)


def with_axes(fields: dict[str, NDArray[Any]], path: Path) -> dict[str, NDArray[Any]]:
    """The fields, whose coordinates are called ``x``, ``y`` and ``z`` even if the file writes X, Y and Z.

    Raises:
        DatasetError: there are no coordinates.
    """
    named = {
        name.lower() if name in ("X", "Y", "Z") and name.lower() not in fields else name: v
        for name, v in fields.items()
    }
    if not named.keys() >= set("xyz"):
        raise DatasetError(f"has no x, y and z; its fields are {quoted(', '.join(fields) or 'none')}", path)
    return named
