"""Parser for PCD files.

Format: Point Cloud Library, "The PCD (Point Cloud Data) file format", version 0.7; ``ascii``, ``binary`` and
``binary_compressed`` (LZF, field after field).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.sensors.cloud_formats.lzf import RATIO, decompress
from relocbench.datasets.sensors.cloud_formats.point_table import (
    check_behind,
    check_count,
    decode_rows,
    header_lines,
    parse_count,
    parse_rows,
)
from relocbench.errors import DatasetError, quoted

_TYPES = {("F", 4), ("F", 8), *((kind, size) for kind in "IU" for size in (1, 2, 4, 8))}
_MOST_VALUES = 4096
"""values of one point, over all fields; descriptors have a few hundred"""


def parse_pcd(data: bytes, path: Path) -> dict[str, NDArray[Any]]:
    """The scalar fields of the points, name -> (N,), with the file's types.

    Raises:
        DatasetError: the file is not a PCD, its header is inconsistent or promises more or fewer points than there
            are, or a field is not a number.
    """
    header = header_lines(data, lambda line: line.upper().split()[:1] == ["DATA"])
    if header is None:
        raise DatasetError("is not a PCD file: it has no header", path)
    lines, body = header
    words = {line.split()[0].upper(): line.split()[1:] for line in lines if line.strip()}
    row = _row(words, path)
    count = _count(words, path)
    encoding = " ".join(words["DATA"]).lower()
    if encoding == "ascii":
        return _single(parse_rows(body, row, count, path, first_line=len(lines) + 1, alone=True))
    if encoding == "binary":
        held = len(body) // row.itemsize
        check_count(held, count, path)
        check_behind(np.frombuffer(body, row, held), count, path)
        return _single(decode_rows(body, row, count))
    if encoding == "binary_compressed":
        return _single(_compressed(body, row, count, path))
    raise DatasetError("its DATA is not ascii, binary or binary_compressed", path)


def _count(words: dict[str, list[str]], path: Path) -> int:
    """The number of points, which the header gives twice."""
    sides = [parse_count(" ".join(words[key]), path) for key in ("WIDTH", "HEIGHT") if key in words]
    if len(sides) == 2 and "POINTS" not in words:
        return sides[0] * sides[1]
    count = parse_count(" ".join(words.get("POINTS", [])), path)
    if len(sides) == 2 and sides[0] * sides[1] != count:
        raise DatasetError(f"its WIDTH x HEIGHT is {sides[0]} x {sides[1]}, but its POINTS is {count}", path)
    return count


def _row(words: dict[str, list[str]], path: Path) -> np.dtype[Any]:
    """Data type of one point; padding fields, all called ``_``, get distinct names."""
    names, kinds = words.get("FIELDS", words.get("COLUMNS", [])), [kind.upper() for kind in words.get("TYPE", [])]
    sizes = [parse_count(text, path) for text in words.get("SIZE", [])]
    counts = [parse_count(text, path) for text in words.get("COUNT", ["1"] * len(names))]
    if not names or not len(names) == len(kinds) == len(sizes) == len(counts):
        raise DatasetError("its FIELDS, SIZE, TYPE and COUNT differ in length", path)
    for name, kind, size in zip(names, kinds, sizes, strict=True):
        if (kind, size) not in _TYPES:
            message = f"its field {quoted(name, 40)} has TYPE {quoted(kind, 10)} and SIZE {size}"
            raise DatasetError(f"{message}; expected F of 4 or 8, or I or U of 1, 2, 4 or 8", path)
    if sum(counts) > _MOST_VALUES or min(counts) < 1:
        raise DatasetError(f"its COUNT is out of range; expected 1 or more, in total {_MOST_VALUES} at most", path)
    plain = [f"_ {i}" if name == "_" else name for i, name in enumerate(names)]
    if len(set(plain)) != len(plain):
        raise DatasetError("its points have two fields of the same name", path)
    return np.dtype(
        [
            (name, f"<{kind.lower()}{size}", *([(many,)] if many > 1 else []))
            for name, kind, size, many in zip(plain, kinds, sizes, counts, strict=True)
        ]
    )


def _compressed(body: bytes, row: np.dtype[Any], count: int, path: Path) -> dict[str, NDArray[Any]]:
    packed, size = (int.from_bytes(body[at : at + 4], "little") for at in (0, 4))
    if count == 0:
        return decode_rows(b"", row, 0)
    if len(body) < 8 + packed:
        raise DatasetError(
            f"is truncated: it promises {packed} compressed bytes but holds {max(len(body) - 8, 0)}", path
        )
    if size != count * row.itemsize or size > RATIO * packed:
        raise DatasetError(f"its {packed} compressed bytes cannot hold {count} points of {row.itemsize} bytes", path)
    values = decompress(np.frombuffer(body, np.uint8, packed, 8), size)
    if values is None:
        raise DatasetError("its compressed points are damaged", path)
    out, at = {}, 0
    for name in row.names or ():
        field = row[name]
        out[name] = values[at : at + count * field.itemsize].view(field.base).reshape(count, *field.shape)
        at += count * field.itemsize
    return out


def _single(fields: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return {name: values for name, values in fields.items() if values.ndim == 1 and not name.startswith("_ ")}
