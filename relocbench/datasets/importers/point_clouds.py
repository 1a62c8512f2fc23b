"""PLY and PCD files of any properties; Open3D decodes them, and what it passes over in silence is found before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.errors import DatasetError

_HEADER_BYTES = 65536
_PLY_BYTES = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2, "int": 4,
    "uint": 4, "int32": 4, "uint32": 4, "float": 4, "float32": 4, "double": 8, "float64": 8,
}  # fmt: skip


def read_point_cloud(path: Path) -> dict[str, NDArray[Any]]:
    """Name -> (N,) of each property of the points, with ``x``, ``y`` and ``z``.

    Raises:
        DatasetError: missing, no PLY or PCD, cut off.
    """
    kind = path.suffix[1:].upper()
    try:
        data = path.read_bytes()
    except OSError as bad:
        raise DatasetError(f"cannot be read ({bad.strerror}); expected a {kind}", path) from None
    expected = _ply_points if kind == "PLY" else _pcd_points
    if expected(data, path) == 0:
        return {axis: np.empty(0) for axis in "xyz"}

    import open3d as o3d

    try:
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            cloud = o3d.t.io.read_point_cloud(path)
    except RuntimeError:
        raise DatasetError(f"cannot be read as {kind}", path) from None
    if "positions" not in cloud.point:
        raise DatasetError(f"cannot be read as {kind}, or has no x, y, z", path)
    positions = cloud.point["positions"].numpy()
    fields = {axis: positions[:, i] for i, axis in enumerate("xyz")}
    for name in cloud.point:
        values = cloud.point[name].numpy()
        if name != "positions" and values.size == len(positions):
            fields[name] = np.ravel(values)
    return fields


def _ply_points(data: bytes, path: Path) -> int:
    """How many points a PLY holds. Raises DatasetError where its data end before them."""
    end = data[:_HEADER_BYTES].find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise DatasetError("is no PLY: it has no header", path)
    rest = data[data.index(b"\n", end) + 1 :] if b"\n" in data[end:] else b""
    words = [line.split() for line in data[:end].decode("ascii", "replace").splitlines()]
    encoding = next((w[1] for w in words if w[:1] == ["format"] and len(w) > 1), "")
    starts = [i for i, w in enumerate(words) if w[:1] == ["element"]]
    # What comes after the points may be cut off as it likes.
    if not starts or len(words[starts[0]]) != 3 or words[starts[0]][1] != "vertex":
        raise DatasetError("its first element is not 'vertex'", path)
    count = _number(words[starts[0]][2], path)
    stop = starts[1] if len(starts) > 1 else len(words)
    kinds = [w[1] for w in words[starts[0] : stop] if w[:1] == ["property"] and len(w) > 2]
    if any(kind not in _PLY_BYTES for kind in kinds):
        raise DatasetError("its points have a property that is no number", path)
    _check_length(rest, count, sum(_PLY_BYTES[k] for k in kinds), encoding == "ascii", path)
    return count


def _pcd_points(data: bytes, path: Path) -> int:
    """How many points a PCD holds. Raises DatasetError where its data end before them."""
    start = data[:_HEADER_BYTES].find(b"\nDATA ")
    if start < 0:
        raise DatasetError("is no PCD: it has no header", path)
    line_end = data.find(b"\n", start + 1)
    rest = data[line_end + 1 :] if line_end >= 0 else b""
    header = data[: line_end if line_end >= 0 else len(data)].decode("ascii", "replace").splitlines()
    words = {line.split()[0]: line.split()[1:] for line in header if line.split()}
    encoding = words.get("DATA", [""])[0]
    sizes = [_number(text, path) for text in words.get("SIZE", [])]
    counts = [_number(text, path) for text in words.get("COUNT", ["1"] * len(sizes))]
    points = _number(words.get("POINTS", [""])[0], path)
    if encoding == "binary_compressed":
        packed = int.from_bytes(rest[:4], "little")
        _check_length(rest, 1, 8 + packed if len(rest) >= 8 else 9, False, path)
    else:
        stride = sum(size * count for size, count in zip(sizes, counts, strict=False))
        _check_length(rest, points, stride, encoding == "ascii", path)
    return points


def _number(text: str, path: Path) -> int:
    if not text.isdigit():
        raise DatasetError(f"its header has '{text}' where a number is expected", path)
    return int(text)


def _check_length(rest: bytes, count: int, stride: int, is_text: bool, path: Path) -> None:
    there = sum(1 for line in rest.splitlines() if line.strip()) if is_text else len(rest) // max(stride, 1)
    if there < count:
        raise DatasetError(f"is cut off: its header promises {count} points, {there} are there", path)
