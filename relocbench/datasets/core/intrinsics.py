"""Intrinsics of single images, where the images of one camera name were taken by different cameras.

Photo collections have a camera for each image. ``intrinsics/CAMERA.csv`` of a traversal then tells the pinhole camera
of each image; images without a row have the camera of ``traversal.yaml``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from relocbench.errors import DatasetError
from relocbench.files import parse_floats, parse_timestamp, read_table, whole_number, write_table
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
    cameras: dict[int, Camera] = {}
    last: int | None = None
    for number, row in read_table(path, INTRINSICS_COLUMNS, "intrinsics", DatasetError):
        time, camera = intrinsics_row(row, path, number)
        if last is not None and time <= last:
            raise DatasetError(f"timestamp {time} does not come after {last}", path, number)
        last = time
        cameras[time] = camera
    return cameras


def intrinsics_row(row: list[str], path: Path, line: int) -> tuple[int, Camera]:
    """Time and camera of a row's fields. Raises DatasetError with file and line."""
    if len(row) != len(INTRINSICS_COLUMNS):
        raise DatasetError(f"expected {len(INTRINSICS_COLUMNS)} columns, found {len(row)}", path, line)
    time = parse_timestamp(row[0], path, line, DatasetError)
    width, height = (whole_number(field) for field in row[1:3])
    if width is None or height is None or min(width, height) < 1:
        raise DatasetError(f"expected positive whole numbers width,height, not {','.join(row[1:3])}", path, line)
    fx, fy, cx, cy = parse_floats(row[3:], path, line, " ".join(INTRINSICS_COLUMNS[3:]), DatasetError)
    if min(fx, fy) <= 0:
        raise DatasetError("fx and fy must be positive", path, line)
    return time, Camera("pinhole", width, height, fx, fy, cx, cy)


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
