"""Intrinsics of single images, where the images of one camera name were taken by different cameras.

Photo collections have a camera for each image. ``intrinsics/CAMERA.csv`` of a traversal then tells the pinhole camera
of each image; images without a row have the camera of ``traversal.yaml``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from relocbench.errors import DatasetError
from relocbench.files import parse_floats, read_table, values_by_time, whole_number, write_table
from relocbench.geometry import Camera

INTRINSICS_COLUMNS = ("timestamp_ns", "width", "height", "fx", "fy", "cx", "cy")


def read_intrinsics(path: Path) -> dict[int, Camera]:
    """Read ``intrinsics/CAMERA.csv``: timestamp_ns -> pinhole camera, in time order; empty without such a file.

    Raises:
        DatasetError: with file and line: a wrong header, a size that is not a positive whole number, a focal length
            that is not positive, a number that is not finite, or times that do not increase.
    """
    if not path.exists() and not path.is_symlink():
        return {}
    rows = read_table(path, INTRINSICS_COLUMNS, "intrinsics", DatasetError)
    return values_by_time(rows, path, lambda row, line: parse_intrinsics(row, path, line), DatasetError)


def parse_intrinsics(fields: list[str], path: Path, line: int) -> Camera:
    """The camera of a row's fields after the time. Raises DatasetError with file and line."""
    if len(fields) != len(INTRINSICS_COLUMNS) - 1:
        raise DatasetError(f"expected {len(INTRINSICS_COLUMNS)} columns, found {len(fields) + 1}", path, line)
    width, height = (whole_number(field) for field in fields[:2])
    if width is None or height is None or min(width, height) < 1:
        raise DatasetError(f"expected positive whole numbers width,height, not {','.join(fields[:2])}", path, line)
    fx, fy, cx, cy = parse_floats(fields[2:], path, line, " ".join(INTRINSICS_COLUMNS[3:]), DatasetError)
    if min(fx, fy) <= 0:
        raise DatasetError("fx and fy must be positive", path, line)
    return Camera("pinhole", width, height, fx, fy, cx, cy)


def write_intrinsics(path: Path, cameras: Mapping[int, Camera]) -> None:
    """Write the pinhole cameras of images, timestamp_ns -> camera, in time order.

    Raises:
        ValueError: a camera is not a pinhole camera.
    """
    other = next((camera.model for camera in cameras.values() if camera.model != "pinhole"), None)
    if other is not None:
        raise ValueError(f"images with intrinsics of their own are pinhole images, not {other}")
    rows = ((t, c.width, c.height, *map(float, (c.fx, c.fy, c.cx, c.cy))) for t, c in sorted(cameras.items()))
    write_table(path, INTRINSICS_COLUMNS, rows)
