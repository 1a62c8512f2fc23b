"""Points as text (``.xyz``, ``.txt``, ``.asc``, ``.pts``, ``.csv``): a point a line, in columns that a header names."""

from __future__ import annotations

import re
from array import array
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.errors import DatasetError, quoted
from relocbench.files import lines_of, read_text, whole_number

_AXIS = re.compile(
    r"(?:coord(?:inate)?s?_?|pos(?:ition)?_?|points?[_.]?)?([xyz])(?:[ _]*[\[(]([a-z]+)[\])]|_([a-z]+))?"
)
_OTHER_AXES = {
    "points:0": "x", "points:1": "y", "points:2": "z", "easting": "x", "northing": "y", "elevation": "z", "height": "z",
}  # fmt: skip
"""as ParaView and surveyors name them"""
_COLUMN_WORDS = {"id", "index", "intensity", "reflectance", "time", "timestamp", "range", "r", "g", "b", "red", "green",
                 "blue", "nx", "ny", "nz", "x", "y", "z", "easting", "northing"}  # fmt: skip
"""words of which a line of spaced words has one if it is a header and no title"""
_METRES = ("", "m", "metre", "metres", "meter", "meters")
_UNITS = ("mm", "cm", "dm", "km", "ft", "feet", "foot", "in", "inch", "deg")
_DEGREES = re.compile(r"(?:lon|lat)(?:g|gitude|itude)?(?:[ _]*[\[(]?deg[a-z]*[\])]?)?|long")
_DECIMAL_COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+")
_INDEX_ROWS = 20
"""rows whose first column counts them, from which on it is taken for an index"""


def read_text_points(path: Path, most_bytes: int) -> dict[str, Array]:
    """The columns of a text, name -> (N,): ``x``, ``y``, ``z``, and all others of numbers that its header names.

    Commas, semicolons, tabs or spaces part the columns, and ``#`` or ``//`` begin a comment. A line above the points,
    also one behind such a mark, that names x, y and z is obeyed; without one these are the first three columns. A line
    with a single number above points is their number, and other lines of words above them are left out.

    Raises:
        DatasetError: with file and line: a line does not hold a point, its numbers have decimal commas, the header
            names columns but no x, y and z, or gives them in other units than metres; there are not as many points as
            promised, or what would be x counts the lines.
    """
    text = read_text(path, "points as text (x y z a line)", DatasetError, most_bytes)
    table = _Table(path)
    for number, line in enumerate(lines_of(text), start=1):
        table.add(line, number)
    return table.columns()


@dataclass
class _Table:
    """The points of a text, line by line."""

    path: Path
    header: tuple[int, list[str]] | None = None
    """its line and the columns' names"""
    in_comment: bool = False
    """whether the header stands in a comment"""
    titles: list[tuple[int, list[str]]] = field(default_factory=list)
    promised: tuple[int, int] | None = None
    """number of points, and the line that promises it"""
    names: list[str] = field(default_factory=list)
    """of the columns that are read"""
    places: list[int] = field(default_factory=list)
    width: int = 0
    """columns of the first point"""
    values: array[float] = field(default_factory=lambda: array("d"))

    def add(self, line: str, number: int) -> None:
        content = line.split("#", 1)[0].split("//", 1)[0].strip()
        if not content:
            words = line.strip().lstrip("#/ \t")
            if words and not self.names:
                self._name_columns(self._split(words, number), number, in_comment=True)
            return
        words_of_line = self._split(content, number)
        count = whole_number(words_of_line[0]) if len(words_of_line) == 1 else None
        if count is not None and self._promise(count, number):
            return
        if not self.names:
            if not _is_number(words_of_line[0]) and sum(map(_is_number, words_of_line[1:3])) < 2:
                self._name_columns(words_of_line, number)
                self.titles.append((number, words_of_line))
                return
            self._begin(words_of_line, line, number)
        self._add_point(words_of_line, line, number)

    def _promise(self, count: int, number: int) -> bool:
        """Take a line with one number as the number of the points that follow, if it can be."""
        if self.names and (self.promised is None or len(self) != self.promised[0]):
            return False
        self.promised = (count + len(self), number)
        return True

    def __len__(self) -> int:
        return len(self.values) // max(len(self.names), 1)

    def _split(self, line: str, number: int) -> list[str]:
        mark = ";" if ";" in line else "," if "," in line else None
        words = line.split()
        if mark is None:
            return words
        parts = [part.strip() for part in line.split(mark)]
        commas = [_DECIMAL_COMMA.fullmatch(part) is not None for part in (parts if mark == ";" else words)]
        if (mark == ";" and any(commas)) or (len(commas) > 2 and all(commas[:3])):
            message = f"has decimal commas ({quoted(line, 60)}); expected decimal points"
            raise DatasetError(message, self.path, number)
        if parts[-1] == "":
            parts.pop()
        # Some write "1.0, 2.0, 3.0 255 255 255".
        return line.replace(mark, " ").split() if any(" " in p or "\t" in p for p in parts) else parts

    def _name_columns(self, words: list[str], number: int, *, in_comment: bool = False) -> None:
        """Take a line as the header if it names x, y and z."""
        names = [self._name(word, number) for word in words]
        if not set("xyz") <= set(names):
            if not in_comment and sum(_DEGREES.fullmatch(name) is not None for name in names) >= 2:
                message = f"its header names longitude and latitude ({quoted(' '.join(names), 60)})"
                raise DatasetError(f"{message}; expected x y z in metres: project it first", self.path, number)
            return
        repeated = next((name for name in names if name and names.count(name) > 1), None)
        if repeated is not None:
            raise DatasetError(f"names the column {quoted(repeated, 30)} twice", self.path, number)
        self.header, self.in_comment = (number, names), in_comment

    def _name(self, word: str, number: int) -> str:
        name = word.strip("\"' ").lower()
        axis = _AXIS.fullmatch(name)
        if axis is None:
            return _OTHER_AXES.get(name, name)
        unit = axis[2] or axis[3] or ""
        if unit in _UNITS:
            raise DatasetError(f"its header gives {axis[1]} in {unit}; expected metres", self.path, number)
        return axis[1] if unit in _METRES else name

    def _begin(self, words: list[str], line: str, number: int) -> None:
        """Settle by the first point which columns are read."""
        self.width = len(words)
        if self.in_comment and self.header is not None and len(self.header[1]) > len(words):
            self.header = None  # a sentence
        if self.header is None:
            for at, title in self.titles[-1:]:
                spaced = not {",", ";"} & set(line)
                named = not spaced or any(self._name(word, at) in _COLUMN_WORDS for word in title)
                if len(title) == len(words) > 2 and named:
                    message = f"its header names no x, y and z: {quoted(' '.join(title), 100)}"
                    raise DatasetError(message, self.path, at)
            self.names, self.places = list("xyz"), [0, 1, 2]
            return
        names = self.header[1]
        if len(names) != len(words) and not (self.in_comment and names[:3] == list("xyz")):
            message = f"has {len(words)} columns, but line {self.header[0]} names {len(names)}"
            raise DatasetError(f"{message}: {quoted(line.strip(), 60)}", self.path, number)
        known = list(enumerate(names))[: len(words)]
        chosen = [(k, name) for k, name in known if name in set("xyz") or (name and _is_number(words[k]))]
        self.places, self.names = [k for k, _ in chosen], [name for _, name in chosen]

    def _add_point(self, words: list[str], line: str, number: int) -> None:
        if self.header is not None and len(words) != self.width:
            message = f"has {len(words)} columns, the points above it {self.width}"
            raise DatasetError(f"{message}: {quoted(line.strip(), 60)}", self.path, number)
        try:
            numbers = [float(words[k]) for k in self.places]
            if "_" in line and any("_" in words[k] for k in self.places):
                raise ValueError
        except (ValueError, IndexError):
            said = " ".join(self.names[:12])
            raise DatasetError(f"expected {said}, found {quoted(line.strip(), 60)}", self.path, number) from None
        self.values.extend(numbers)

    def columns(self) -> dict[str, Array]:
        count = len(self)
        if self.promised is not None and self.promised[0] != count:
            said = f"{self.promised[0]} points are promised, but the file holds {count}"
            raise DatasetError(said, self.path, self.promised[1])
        values = np.array(self.values).reshape(count, max(len(self.names), 1))
        if self.header is None and self.width > 3 and count >= _INDEX_ROWS and np.all(np.diff(values[:, 0]) == 1):
            message = f"its first column counts the lines from {values[0, 0]:g}, which x does not"
            raise DatasetError(f"{message}; name the columns in a first line, such as 'id x y z'", self.path)
        return {name: values[:, k].copy() for k, name in enumerate(self.names)} or {axis: np.empty(0) for axis in "xyz"}


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return word.isascii() and "_" not in word
