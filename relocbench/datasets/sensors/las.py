"""LAS and LAZ files, by laspy (LAZ with lazrs).

Format: ASPRS, "LAS Specification", version 1.4. Coordinates are integers with a scale and an offset, often of a map's
grid with values in the millions; they are read as float64, which holds them to a nanometre.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.errors import ConfigError, DatasetError

EXTRA = "pip install 'relocbench[clouds]'"


def read_las(path: Path, most_points: int) -> Array:
    """Coordinates (N, 3) of the points, metres in the file's own coordinate system.

    Raises:
        ConfigError: laspy or lazrs is not installed.
        DatasetError: the file is damaged, or holds more than ``most_points``.
    """
    try:
        import laspy
    except ImportError:
        raise ConfigError(f"{path.suffix} files need the package laspy: {EXTRA}") from None
    try:
        with laspy.open(path) as stream:
            count = int(stream.header.point_count)
            if count > most_points:
                raise DatasetError(f"holds {count} points, more than {most_points}; thin it first", path)
            if stream.header.are_points_compressed and not laspy.LazBackend.detect_available():
                raise ConfigError(f"compressed LAS files need the package lazrs: {EXTRA}")
            points = stream.read()
            return np.column_stack([np.asarray(points.x), np.asarray(points.y), np.asarray(points.z)]).astype(
                np.float64
            )
    except (DatasetError, ConfigError):
        raise
    # laspy and lazrs raise errors of many kinds, also of Rust, for damaged files.
    except Exception as bad:
        raise DatasetError(f"cannot be read as LAS or LAZ ({type(bad).__name__})", path) from bad
