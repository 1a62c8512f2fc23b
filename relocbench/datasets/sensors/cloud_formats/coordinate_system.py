"""The units of a map's coordinates, as LAS files state them: by GeoTIFF keys, or by well-known text (WKT).

Format of the keys: OGC GeoTIFF 1.1 (19-008r4). Codes of EPSG and texts are looked up by PROJ, which pyproj brings.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from relocbench.errors import DatasetError, one_line, quoted

_KEYS, _DOUBLES, _WKT = 34735, 34736, 2112
_MODEL, _GEOGRAPHIC, _PROJECTED, _LINEAR_UNIT, _LINEAR_SIZE, _VERTICAL, _VERTICAL_UNIT = (
    1024, 2048, 3072, 3076, 3077, 4096, 4099,
)  # fmt: skip
_MODEL_OF_DEGREES = 2
_USER_DEFINED = 32767
_FEET = re.compile(r"\b(?:foot|feet|ft)", re.IGNORECASE)
_UNITS = {1.0: "metres", 0.3048: "feet", 1200 / 3937: "US survey feet"}
_SAME = 1e-5
"""relative difference of units that are one: texts give some with six digits"""


@dataclass(frozen=True)
class CoordinateSystem:
    """What a file says of its coordinates."""

    name: str
    degrees: bool
    """x and y are longitude and latitude"""
    metres: float | None
    """of a unit of x and y; None: not stated"""
    vertical: float | None
    """metres of a unit of z; None: not stated"""


def coordinate_system(
    records: Mapping[int, bytes], prefers_wkt: bool, path: Path, notes: list[str]
) -> CoordinateSystem | None:
    """The coordinate system of records of variable length of LAS, record number -> content; None if there is none.

    Args:
        prefers_wkt: whether the text is what counts, if there are keys too.
        notes: what cannot be understood is added.

    Raises:
        ImportError: pyproj is not installed.
        DatasetError: the unit is not known.
    """
    by_keys, by_text = _of_keys(records, path, notes), _of_wkt(records.get(_WKT, b""), notes)
    found = [system for system in ((by_text, by_keys) if prefers_wkt else (by_keys, by_text)) if system is not None]
    return next((system for system in found if system.degrees or system.metres is not None), next(iter(found), None))


def convertible(system: CoordinateSystem, path: Path) -> tuple[float, float, str]:
    """Metres of a unit of x and y, and of one of z, and a note on them.

    Raises:
        DatasetError: x and y are degrees.
    """
    if system.degrees:
        named = quoted(system.name, 60)
        raise DatasetError(
            f"its x and y are degrees ({named}); expected metres: project it first, such as to UTM", path
        )
    if system.metres is None:
        note = f"coordinates of {system.name}, whose unit is not stated, are taken as metres"
        return 1.0, system.vertical or 1.0, note
    vertical = system.metres if system.vertical is None else system.vertical
    if abs(system.metres - 1) < _SAME and abs(vertical - 1) < _SAME:
        return 1.0, 1.0, ""
    names = unit_name(system.metres), unit_name(vertical)
    if system.vertical is None:
        what = f"coordinates are {names[0]}, and heights, whose unit is not stated, taken as such"
    else:
        what = f"coordinates are {names[0]}" if names[0] == names[1] else f"x and y are {names[0]}, z {names[1]}"
    return system.metres, vertical, f"{what} ({system.name}): converted to metres"


def unit_name(metres: float) -> str:
    """A unit of length in words."""
    return next((name for size, name in _UNITS.items() if abs(metres / size - 1) < 1e-7), f"units of {metres:g} m")


def _of_wkt(data: bytes, notes: list[str]) -> CoordinateSystem | None:
    text = data.decode("utf-8", "replace").rstrip("\0 \n")
    return _known(text, notes) if text else None


def _of_keys(records: Mapping[int, bytes], path: Path, notes: list[str]) -> CoordinateSystem | None:
    data = records.get(_KEYS, b"")
    values = struct.unpack(f"<{len(data) // 2}H", data[: len(data) // 2 * 2])
    if len(values) < 4:
        return None
    keys = {values[at]: values[at + 1 : at + 4] for at in range(4, min(len(values) - 3, 4 + 4 * values[3]), 4)}
    plain = {key: value for key, (place, _, value) in keys.items() if place == 0}
    degrees = plain.get(_MODEL) == _MODEL_OF_DEGREES or (_MODEL not in plain and _PROJECTED not in plain)
    code = plain.get(_GEOGRAPHIC if degrees else _PROJECTED)
    if code is None and _MODEL not in plain:
        return None
    known = None if code in (None, _USER_DEFINED) else _known(f"EPSG:{code}", notes)
    heights = plain.get(_VERTICAL, 0)
    vertical = None if heights in (0, _USER_DEFINED) else _known(f"EPSG:{heights}", notes)
    size = _double(records, keys.get(_LINEAR_SIZE))
    metres = _unit(plain.get(_LINEAR_UNIT), size, path)
    upright = _unit(plain.get(_VERTICAL_UNIT), None, path)
    return CoordinateSystem(
        known.name if known else "a system without a name",
        known.degrees if known else degrees,
        metres if metres or not known else known.metres,
        upright if upright or not vertical else vertical.vertical,
    )


def _known(text: str, notes: list[str]) -> CoordinateSystem | None:
    """What PROJ knows of a text or code; None, and a note, if it understands nothing."""
    import pyproj

    try:
        system = pyproj.CRS.from_user_input(text)
        axes = system.axis_info or (system.source_crs.axis_info if system.source_crs else [])
    except pyproj.exceptions.CRSError:
        notes.append(f"its coordinate system cannot be understood: {quoted(one_line(text), 60)}")
        return None
    level = [axis for axis in axes if axis.direction not in ("up", "down")]
    upright = [axis for axis in axes if axis.direction in ("up", "down")]
    return CoordinateSystem(
        one_line(system.name, 60),
        any("degree" in axis.unit_name for axis in level),
        _metres(level[0]) if level else None,
        _metres(upright[0]) if upright else None,
    )


def _metres(axis: Any) -> float:
    factor = float(axis.unit_conversion_factor)
    if factor == 1.0 and _FEET.search(axis.unit_name):  # some writers give the size of every unit as 1
        return 1200 / 3937 if "us" in axis.unit_name.lower() else 0.3048
    return factor


def _unit(code: int | None, size: float | None, path: Path) -> float | None:
    """Metres of the unit with a code of EPSG, or of ``size`` where a file defines its own."""
    import pyproj

    if not code:
        return None
    by_code = {unit.code: unit.conv_factor for unit in pyproj.database.get_units_map("EPSG", "linear").values()}
    metres = size if code == _USER_DEFINED else by_code.get(str(code))
    if metres is None or not 1e-6 < metres < 1e6:
        raise DatasetError(f"its coordinates have the unit EPSG:{code}, expected metres or feet", path)
    return metres


def _double(records: Mapping[int, bytes], key: tuple[int, ...] | None) -> float | None:
    data = records.get(_DOUBLES, b"")
    if key is None or key[0] != _DOUBLES or len(data) < 8 * key[2] + 8:
        return None
    return float(struct.unpack_from("<d", data, 8 * key[2])[0])
