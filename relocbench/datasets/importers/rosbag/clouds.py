"""Points of PointCloud2 and LaserScan messages.

The layout of PointCloud2 is that of its message definition: rows of ``row_step`` bytes hold points of ``point_step``
bytes, whose fields have offsets, types and the byte order of the whole message.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Times

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""numbers of types in sensor_msgs/PointField"""
MOST_POINTS = 50_000_000


def field_names(message: Any) -> tuple[str, ...]:
    """The names of a cloud's fields, in their order."""
    return tuple(dict.fromkeys(str(field.name) for field in message.fields))


def cloud_fields(message: Any, wanted: tuple[str, ...] | None = None) -> dict[str, NDArray[Any]]:
    """The values of the fields of a cloud, each (N,), row after row.

    Args:
        message: an object with the fields of ``sensor_msgs/PointCloud2``.
        wanted: names of fields; default: all that hold one number a point.

    Raises:
        ValueError: the message contradicts itself, or has no such field.
    """
    height, width = int(message.height), int(message.width)
    step, row = int(message.point_step), int(message.row_step)
    data = np.ascontiguousarray(np.asarray(message.data, dtype=np.uint8))
    count = height * width
    if count > MOST_POINTS:
        raise ValueError(f"{width} x {height} points are more than a scan has")
    if count and step < 1:
        raise ValueError(f"point_step is {step}, expected at least one byte")
    row = row if height > 1 else max(row, width * step)
    if count and row < width * step:
        raise ValueError(f"row_step {row} is less than {width} points of {step} bytes")
    needed = (height - 1) * row + width * step if count else 0
    if len(data) < needed:
        raise ValueError(f"data holds {len(data)} bytes, but {width} x {height} points of {step} bytes need {needed}")
    order = ">" if message.is_bigendian else "<"
    out: dict[str, NDArray[Any]] = {}
    for field in message.fields:
        name, code, offset = str(field.name), int(field.datatype), int(field.offset)
        if name in out or (wanted is not None and name not in wanted):
            continue
        if code not in _TYPES:
            raise ValueError(f"field {name!r} has type {code}, expected 1 to 8")
        # Some drivers write a count of 0 where they mean 1.
        if int(field.count) > 1:
            if wanted is not None:
                raise ValueError(f"field {name!r} holds {int(field.count)} numbers a point, expected one")
            continue
        dtype = np.dtype(order + _TYPES[code])
        if count and offset + dtype.itemsize > step:
            raise ValueError(f"field {name!r} ends at byte {offset + dtype.itemsize} of points of {step} bytes")
        values = np.ndarray((height, width), dtype, data, offset, (row, step)) if count else np.empty(0, dtype)
        out[name] = values.ravel().astype(dtype.newbyteorder("="))
    missing = [name for name in wanted or () if name not in out]
    if missing:
        raise ValueError(f"has no field {', '.join(missing)}; it has {', '.join(field_names(message)) or 'none'}")
    return out


def laser_points(message: Any) -> tuple[Array, Times]:
    """Points (N, 3) of a LaserScan and the nanoseconds (N,) after its stamp at which their beams were fired.

    Beams outside ``range_min`` to ``range_max`` have no return and are left out. Without ``time_increment``, the time
    from beam to beam follows from ``scan_time``, the time of a whole turn.

    Raises:
        ValueError: an angle or a time is not finite.
    """
    ranges = np.asarray(message.ranges, dtype=np.float64)
    start, step = float(message.angle_min), float(message.angle_increment)
    between, turn = float(message.time_increment), float(message.scan_time)
    if not np.isfinite([start, step, between, turn]).all():
        raise ValueError("an angle or a time of the scan is not finite")
    if between == 0.0 and turn > 0.0:
        between = turn * abs(step) / (2 * np.pi)
    if abs(between) * len(ranges) > 10.0:
        raise ValueError(f"time_increment is {between:g} s, which makes a scan of {between * len(ranges):.0f} s")
    angles = start + step * np.arange(len(ranges))
    kept = np.isfinite(ranges) & (ranges >= float(message.range_min)) & (ranges <= float(message.range_max))
    r, a = ranges[kept], angles[kept]
    offsets = np.rint(np.flatnonzero(kept) * between * 1e9).astype(np.int64)
    return np.column_stack([r * np.cos(a), r * np.sin(a), np.zeros(len(r))]), offsets
