"""The units of a map's coordinates, as LAS files state them: by GeoTIFF keys, or by well-known text (WKT).

Formats: OGC GeoTIFF 1.1 (19-008r4) for the keys; OGC 01-009 and 18-010r7 for WKT 1 and 2; unit codes are those of EPSG.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from relocbench.errors import DatasetError, quoted

_KEYS, _DOUBLES, _TEXTS, _WKT = 34735, 34736, 34737, 2112
_METRES = {
    9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937, 9005: 0.3047972654, 9036: 1000.0, 9041: 0.3047994715386762,
    9080: 0.3047995142, 9081: 0.3047995102, 9094: 0.3047997101815088,
}  # fmt: skip
_UNITS = {1.0: "metres", 0.3048: "feet", 1200 / 3937: "US survey feet"}
_USER_DEFINED = 32767
_MODEL, _CITATION, _PROJECTED, _PROJECTED_CITATION = 1024, 1026, 3072, 3073
_LINEAR_UNIT, _LINEAR_SIZE, _VERTICAL_UNIT, _GEOGRAPHIC = 3076, 3077, 4099, 2048
_FEET = re.compile(r"ftus|us ?ft|survey f(?:oo|ee)t|\bf(?:oo|ee)t\b|\bft\b|\(ft", re.IGNORECASE)
_TOKEN = re.compile(r'"((?:[^"]|"")*)"|([\[\](),])|([^\s\[\](),"]+)')
_MOST_TOKENS, _MOST_DEPTH = 20_000, 50
_SAME = 1e-5
"""relative difference of units that are one: texts give some with six digits"""

Kind = Literal["projected", "geographic", "geocentric"]


@dataclass(frozen=True)
class CoordinateSystem:
    """What a file says of its coordinates."""

    name: str
    kind: Kind
    metres: float | None
    """of a unit of x and y; None: not stated"""
    vertical: float | None
    """metres of a unit of z; None: not stated"""


def coordinate_system(records: Mapping[int, bytes], prefers_wkt: bool, path: Path) -> CoordinateSystem | None:
    """The coordinate system of records of variable length of LAS, record number -> content; None if there is none.

    Args:
        prefers_wkt: whether the text is what counts, if there are keys too.

    Raises:
        DatasetError: the unit is not known.
    """
    by_keys, by_text = _of_keys(records, path), _of_wkt(records.get(_WKT, b""))
    found = [system for system in ((by_text, by_keys) if prefers_wkt else (by_keys, by_text)) if system is not None]
    return next((s for s in found if s.kind != "projected" or s.metres is not None), found[0] if found else None)


def unit_name(metres: float) -> str:
    """A unit of length in words."""
    return next((name for size, name in _UNITS.items() if abs(metres / size - 1) < 1e-7), f"units of {metres:g} m")


def _of_keys(records: Mapping[int, bytes], path: Path) -> CoordinateSystem | None:
    data = records.get(_KEYS, b"")
    values = struct.unpack(f"<{len(data) // 2}H", data[: len(data) // 2 * 2])
    if len(values) < 4:
        return None
    keys = {values[at]: values[at + 1 : at + 4] for at in range(4, min(len(values) - 3, 4 + 4 * values[3]), 4)}
    plain = {key: value for key, (place, _, value) in keys.items() if place == 0}
    model = plain.get(_MODEL)
    if model is None and not {_PROJECTED, _GEOGRAPHIC} & keys.keys():
        return None
    kind: Kind = {2: "geographic", 3: "geocentric"}.get(model or 0, "projected")  # type: ignore[assignment]
    if model is None and _PROJECTED not in keys:
        kind = "geographic"
    texts = [_text(records, keys[key]) for key in (_PROJECTED_CITATION, _CITATION) if key in keys]
    code = plain.get(_PROJECTED if kind == "projected" else _GEOGRAPHIC, _USER_DEFINED)
    name = next(filter(None, texts), "") or (f"EPSG:{code}" if code != _USER_DEFINED else "no name")
    metres = _unit(plain.get(_LINEAR_UNIT), _double(records, keys.get(_LINEAR_SIZE)), path)
    if metres is None and kind == "projected":
        metres = next((_foot(text) for text in texts if _FEET.search(text)), None)
    return CoordinateSystem(name, kind, metres, _unit(plain.get(_VERTICAL_UNIT), None, path))


def _unit(code: int | None, size: float | None, path: Path) -> float | None:
    if code is None or code == 0:
        return None
    metres = size if code == _USER_DEFINED else _METRES.get(code)
    if metres is None or not 1e-6 < metres < 1e6:
        raise DatasetError(f"its coordinates have the unit EPSG:{code}, expected metres or feet", path)
    return metres


def _foot(text: str) -> float:
    return 1200 / 3937 if re.search("us|survey", text, re.IGNORECASE) else 0.3048


def _text(records: Mapping[int, bytes], key: tuple[int, ...]) -> str:
    place, count, at = key
    whole = records.get(_TEXTS, b"") if place == _TEXTS else b""
    return whole[at : at + count].decode("ascii", "replace").strip("|\0 ")


def _double(records: Mapping[int, bytes], key: tuple[int, ...] | None) -> float | None:
    data = records.get(_DOUBLES, b"")
    if key is None or key[0] != _DOUBLES or len(data) < 8 * key[2] + 8:
        return None
    return float(struct.unpack_from("<d", data, 8 * key[2])[0])


@dataclass
class _Node:
    """``WORD["name", 1, WORD[...]]``"""

    word: str
    values: list[str] = field(default_factory=list)
    nodes: list[_Node] = field(default_factory=list)

    def all(self, *words: str) -> Iterator[_Node]:
        """Nodes right below it, of these words."""
        return (node for node in self.nodes if node.word in words)


_SYSTEMS: dict[str, Kind] = {
    **dict.fromkeys(("PROJCS", "PROJCRS", "PROJECTEDCRS"), "projected"),
    **dict.fromkeys(("GEOGCS", "GEOGCRS", "GEOGRAPHICCRS"), "geographic"),
    **dict.fromkeys(("GEOCCS", "GEODCRS", "GEODETICCRS"), "geocentric"),
}


def _of_wkt(data: bytes) -> CoordinateSystem | None:
    root = _parsed(data.decode("utf-8", "replace"))
    for _ in range(_MOST_DEPTH):  # a text may wrap a system, or put one of heights beside it
        if root is None or root.word in _SYSTEMS:
            break
        inner = [n for n in root.nodes if n.word in _SYSTEMS or n.word in ("SOURCECRS", "COMPD_CS", "COMPOUNDCRS")]
        heights = [n for n in root.nodes if n.word.startswith("VERT")]
        if heights and inner:
            inner[0].nodes += heights
        root = inner[0] if inner else None
    if root is None:
        return None
    kind = _SYSTEMS[root.word]
    if kind == "geocentric" and any(node.values[:1] == ["ellipsoidal"] for node in root.all("CS")):
        kind = "geographic"
    vertical = [_length(node) for node in root.nodes if node.word.startswith("VERT")]
    return CoordinateSystem(
        root.values[0][:60] if root.values else "no name",
        kind,
        _length(root) if kind != "geographic" else None,
        vertical[0] if vertical else None,
    )


def _length(system: _Node) -> float | None:
    """Metres of the unit of a system's axes."""
    units = [*system.all("UNIT", "LENGTHUNIT")]
    units += [unit for axis in system.all("AXIS") for unit in axis.all("UNIT", "LENGTHUNIT")]
    for unit in units:
        try:
            metres = float(unit.values[1])
        except (IndexError, ValueError):
            continue
        if metres == 1.0 and _FEET.search(unit.values[0]):  # some writers give the size of every unit as 1
            return _foot(unit.values[0])
        if 1e-6 < metres < 1e6:
            return next((known for known in _METRES.values() if abs(metres / known - 1) < 1e-9), metres)
    return None


def _parsed(text: str) -> _Node | None:
    """The outermost node; None if the text is none. Brackets that are not closed are taken as closed at its end."""
    root: _Node | None = None
    stack: list[_Node] = []
    word = ""
    for count, found in enumerate(_TOKEN.finditer(text)):
        if count > _MOST_TOKENS or len(stack) > _MOST_DEPTH:
            return None
        string, mark, plain = found.groups()
        if mark in ("[", "("):
            node = _Node(word.upper())
            if stack:
                del stack[-1].values[-1:]
                stack[-1].nodes.append(node)
            root = root or node
            stack.append(node)
        elif mark in ("]", ")"):
            if not stack:
                return root
            stack.pop()
        elif mark is None:
            word = plain or ""
            if stack:
                stack[-1].values.append(string if plain is None else plain)
    return root if root is not None and root.word else None


def convertible(system: CoordinateSystem, path: Path) -> tuple[float, float, str]:
    """Metres of a unit of x and y, and of one of z, and a note on them.

    Raises:
        DatasetError: x and y are degrees.
    """
    if system.kind == "geographic":
        message = (
            f"its x and y are degrees ({quoted(system.name, 60)}); expected metres: project it first, such as to UTM"
        )
        raise DatasetError(message, path)
    if system.metres is None:
        return (
            1.0,
            system.vertical or 1.0,
            f"coordinates of {system.name}, whose unit is not stated, are taken as metres",
        )
    vertical = system.metres if system.vertical is None else system.vertical
    if abs(system.metres - 1) < _SAME and abs(vertical - 1) < _SAME:
        return 1.0, 1.0, ""
    names = unit_name(system.metres), unit_name(vertical)
    if system.vertical is None:
        what = f"coordinates are {names[0]}, and heights, whose unit is not stated, taken as such"
    else:
        what = f"coordinates are {names[0]}" if names[0] == names[1] else f"x and y are {names[0]}, z {names[1]}"
    return system.metres, vertical, f"{what} ({system.name}): converted to metres"
