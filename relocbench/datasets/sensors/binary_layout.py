"""How the points of a ``.bin`` file are stored: the type of its numbers and how many of them make a point.

Nothing in such a file says so. A wrong type gives numbers of absurd size. With the right number of columns, numbers
that far apart in the file belong to the same axis of the next point, which is usually near, so that they differ least.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array
from relocbench.datasets.sensors.record_layout import likely_length, said_of
from relocbench.errors import DatasetError

Number = Literal["float32", "float64"]
NUMBERS: tuple[Number, ...] = ("float32", "float64")
COLUMNS = (3, 4, 5, 6)
"""numbers of columns that are considered: x y z, then intensity, ring, time and the like"""
_LOOKED_AT = 120_000
"""values that are looked at"""
_LARGEST, _SMALLEST = 1e19, 1e-30
"""sizes of values, other than 0, that points, intensities and times have, up to nanoseconds since 1970"""
_SENSIBLE = 0.98
"""share of the values that must have such a size"""
_CLEAR = 0.97
"""the best number of columns must have a lag difference below this share of that of the next smaller ones"""
_FEWEST_POINTS = 20


@dataclass(frozen=True)
class BinaryLayout:
    """The type and number of the values of each point; the first three are x, y and z."""

    number: Number
    columns: int

    @property
    def bytes_per_point(self) -> int:
        return self.columns * np.dtype(self.number).itemsize

    def __str__(self) -> str:
        return f"{self.columns} columns of {self.number}"


def decode_points(data: bytes, layout: BinaryLayout, path: Path) -> NDArray[np.floating]:
    """The values (N, columns) of a file. Raises DatasetError if it does not hold a whole number of points."""
    if not data or len(data) % layout.bytes_per_point:
        raise DatasetError(f"{len(data)} bytes are not a whole number of points ({layout})", path)
    return np.frombuffer(data, dtype=np.dtype(layout.number).newbyteorder("<")).reshape(-1, layout.columns)


def detect_layout(data: bytes, path: Path, number: Number | None = None, columns: int | None = None) -> BinaryLayout:
    """The layout that the values of a file suggest.

    Args:
        number: the type of the numbers, if it is known.
        columns: the number of columns, if it is known.

    Raises:
        DatasetError: no layout fits the file's size and gives sensible values, or two fit equally well.
    """
    allowed = [
        BinaryLayout(n, c) for n in ((number,) if number else NUMBERS) for c in ((columns,) if columns else COLUMNS)
    ]
    fitting = [layout for layout in allowed if data and len(data) % layout.bytes_per_point == 0]
    if not fitting:
        said = " or ".join(str(layout) for layout in allowed) if len(allowed) < 3 else "3 to 6 columns of either type"
        message = f"{len(data)} bytes are not a whole number of points ({said})"
        raise DatasetError(message + said_of(data, likely_length(data)), path)
    if number is not None and columns is not None:
        return fitting[0]
    if not any(data):
        raise DatasetError("holds only zeros, from which no layout follows; name its type and columns", path)
    types = [n for n in NUMBERS if any(layout.number == n for layout in fitting) and _is_sensible(data, n)]
    if not types:
        raise DatasetError(
            "its bytes are not coordinates as float32 or float64 (other types and headers are not read)", path
        )
    # Numbers of float64 read as float32 are rarely sensible; the other way round small ones can be.
    chosen = types[0]
    counts = [layout.columns for layout in fitting if layout.number == chosen]
    if len(counts) == 1:
        return BinaryLayout(chosen, counts[0])
    if len(data) < _FEWEST_POINTS * max(counts) * np.dtype(chosen).itemsize:
        raise DatasetError(f"holds too few points to tell whether it has {_listed(counts)} columns; name them", path)
    values = _first(data, chosen)
    differences = {count: _lag_difference(values, count) for count in counts}
    best = min(counts, key=lambda count: differences[count])
    # Six columns repeat what three do: a multiple is taken only if it is clearly better.
    for count in counts:
        if best % count == 0 and count < best and differences[best] > _CLEAR * differences[count]:
            best = count
    others = [differences[count] for count in counts if best % count and count % best]
    if others and differences[best] > _CLEAR * min(others):
        raise DatasetError(f"could have {_listed(counts)} columns of {chosen}; name them", path)
    return BinaryLayout(chosen, best)


def _first(data: bytes, number: Number) -> Array:
    kind = np.dtype(number).newbyteorder("<")
    count = min(len(data) // kind.itemsize, _LOOKED_AT)
    return np.frombuffer(data, dtype=kind, count=count).astype(np.float64)


def _is_sensible(data: bytes, number: Number) -> bool:
    with np.errstate(invalid="ignore", over="ignore"):
        values = _first(data, number)
        finite = values[np.isfinite(values)]
    if len(finite) < 0.5 * len(values):  # beams without a return may be nan
        return False
    size = np.abs(finite)
    zero = size == 0
    if number == "float32" and (np.all(zero[0::2]) or np.all(zero[1::2])):
        return False  # the lower halves of whole numbers in float64
    return bool(np.mean(zero | ((size >= _SMALLEST) & (size <= _LARGEST))) >= _SENSIBLE)


def _lag_difference(values: Array, lag: int) -> float:
    """Mean difference of values ``lag`` apart, on a logarithmic scale, so that no column outweighs the others."""
    scaled = np.arcsinh(np.nan_to_num(values))
    return float(np.mean(np.abs(scaled[lag:] - scaled[:-lag])))


def _listed(counts: list[int]) -> str:
    return " or ".join(str(count) for count in counts)
