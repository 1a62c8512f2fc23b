"""Parser for the points of PLY files: the element ``vertex``, which must come first and have numeric properties.

Format: G. Turk, The PLY Polygon File Format, 1994; ASCII and binary of either byte order. Elements after the points,
such as faces, are not read.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.sensors.cloud_formats.point_table import (
    check_behind,
    check_count,
    decode_rows,
    header_lines,
    parse_count,
    parse_rows,
)
from relocbench.errors import DatasetError

_TYPES = {
    "char": "i1", "uchar": "u1", "int8": "i1", "uint8": "u1", "short": "i2", "ushort": "u2", "int16": "i2",
    "uint16": "u2", "int": "i4", "uint": "u4", "int32": "i4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDER = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}


def parse_ply(data: bytes, path: Path) -> dict[str, NDArray[Any]]:
    """The properties of the points, name -> (N,), with the file's types.

    Raises:
        DatasetError: the file is not a PLY, has another layout, promises more or fewer points than there are, or a
            property is not a number.
    """
    header = header_lines(data, "end_header".__eq__) if data[:16].split(b"\n")[0].strip() == b"ply" else None
    if header is None:
        raise DatasetError("is not a PLY file: it has no header", path)
    lines, body = header
    words = [line.split() for line in lines]
    encoding = next((w[1] for w in words if w[:1] == ["format"] and len(w) > 1), "")
    if encoding not in _ORDER:
        raise DatasetError("its format is not ascii, binary_little_endian or binary_big_endian", path)
    starts = [i for i, w in enumerate(words) if w[:1] == ["element"]]
    if not starts or len(words[starts[0]]) != 3 or words[starts[0]][1] != "vertex":
        raise DatasetError("its first element is not 'vertex'", path)
    count = parse_count(words[starts[0]][2], path)
    stop = starts[1] if len(starts) > 1 else len(words)
    properties = [w[1:] for w in words[starts[0] : stop] if w[:1] == ["property"]]
    if any(len(p) != 2 or p[0] not in _TYPES for p in properties):
        raise DatasetError("its points have a property that is not a number", path)
    names = [name for _, name in properties]
    if len(set(names)) != len(names):
        raise DatasetError("its points have two properties of the same name", path)
    row = np.dtype([(name, _ORDER[encoding] + _TYPES[kind]) for kind, name in properties])
    alone = len(starts) == 1
    if encoding == "ascii":
        return parse_rows(body, row, count, path, first_line=len(lines) + 1, alone=alone)
    held = len(body) // max(row.itemsize, 1)
    check_count(held, count, path)
    if alone and held > count:
        check_behind(np.frombuffer(body, row, held), count, path)
    return decode_rows(body, row, count)
