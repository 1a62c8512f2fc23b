"""Readers that find every fault of a file, whereas the usual readers stop at the first."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from relocbench.arrays import Array
from relocbench.datasets.core.intrinsics import INTRINSICS_COLUMNS, parse_intrinsics
from relocbench.datasets.core.pair_table import FURTHER_COLUMNS, known_number, pair_rows
from relocbench.datasets.core.pairfile import POSE_LINE, PairKey, PoseLine, parse_pose
from relocbench.datasets.core.traversal import POSE_COLUMNS
from relocbench.errors import DatasetError, RelocbenchError
from relocbench.files import (
    first_fault,
    load_yaml_values,
    parse_floats,
    parse_timestamp,
    read_csv,
    read_rows,
    values_by_time,
    yaml_line,
)
from relocbench.geometry import Camera

Model = TypeVar("Model", bound=BaseModel)

_PAIR_NUMBERS = ("distance_m", "angle_deg", "overlap", "sigma_translation_m", "sigma_rotation_deg")
_RANGES = {
    "overlap": (0.0, 1.0),
    "overlap_query": (0.0, 1.0),
    "scale_change": (1.0, math.inf),
    "depth_error": (0.0, math.inf),
    "similarity": (-1.0, 1.0),
}
"""the least and the greatest value of the measures of a pair"""
_POINT_COLUMNS = ("u", "v", "inverse_depth", "sigma")


@dataclass(frozen=True)
class Finding:
    """One fault or note about a file."""

    message: str
    path: Path | None = None
    line: int | None = None
    """1-based"""

    def __str__(self) -> str:
        return str(RelocbenchError(self.message, self.path, self.line))


@dataclass
class Findings:
    """The results of a check: faults, and notes on what is worth knowing but not a fault."""

    faults: list[Finding] = field(default_factory=list)
    notes: list[Finding] = field(default_factory=list)

    @classmethod
    def joined(cls, parts: Iterable[Findings]) -> Findings:
        """All findings of several checks."""
        each = list(parts)
        return cls([f for part in each for f in part.faults], [f for part in each for f in part.notes])

    def fault(self, message: str, path: Path | None = None, line: int | None = None) -> None:
        self.faults.append(Finding(message, path, line))

    def note(self, message: str, path: Path | None = None, line: int | None = None) -> None:
        self.notes.append(Finding(message, path, line))

    @contextmanager
    def catching(self) -> Iterator[None]:
        """Record an error that a reader raises as a fault, and continue."""
        try:
            yield
        except RelocbenchError as bad:
            self.fault(bad.expected, bad.path, bad.line)

    def by_place(self) -> Findings:
        """The same findings, grouped by file and in the order of lines."""
        return Findings(_by_place(self.faults), _by_place(self.notes))

    def to_dict(self) -> dict[str, list[dict[str, Any]]]:
        """The faults and the notes as plain values for scripts."""
        return {
            name: [{"path": str(f.path) if f.path else None, "line": f.line, "message": f.message} for f in findings]
            for name, findings in (("faults", self.faults), ("notes", self.notes))
        }

    @property
    def count(self) -> str:
        """How many faults there are, in words."""
        return {0: "no fault", 1: "1 fault"}.get(len(self.faults), f"{len(self.faults)} faults")

    @property
    def faulty_files(self) -> set[Path]:
        return {f.path for f in self.faults if f.path is not None}


def _by_place(findings: list[Finding]) -> list[Finding]:
    first: dict[Path | None, int] = {}
    for finding in findings:
        first.setdefault(finding.path, len(first))
    return sorted(findings, key=lambda f: (first[f.path], f.line or 0))


@dataclass(frozen=True)
class TableRow:
    """One row of a pair set's table."""

    key: PairKey
    accepted: bool
    group: str
    source: str
    distance_m: float | None
    angle_deg: float | None
    line: int


def read_yaml(path: Path, model: type[Model], what: str, findings: Findings) -> Model | None:
    """Like :func:`relocbench.files.load_yaml`, with a fault for each wrong key."""
    with findings.catching():
        values, node = load_yaml_values(path, what, DatasetError)
        try:
            return model.model_validate(values)
        except ValidationError as bad:
            for one in single_errors(bad):
                message, location = first_fault(one)
                findings.fault(message, path, yaml_line(node, location))
    return None


def read_pose_table(path: Path, findings: Findings) -> dict[int, Array]:
    """The valid rows of ``poses.csv``: timestamp_ns -> (4, 4) ``T_world_rig``."""
    rows = _table(path, POSE_COLUMNS, "poses", findings)
    return values_by_time(rows, path, lambda row, line: parse_pose(row, path, line), DatasetError, findings.catching)


def read_intrinsics_table(path: Path, findings: Findings) -> dict[int, Camera]:
    """The valid rows of ``intrinsics/CAMERA.csv``: timestamp_ns -> camera."""
    rows = _table(path, INTRINSICS_COLUMNS, "intrinsics", findings)
    return values_by_time(
        rows, path, lambda row, line: parse_intrinsics(row, path, line), DatasetError, findings.catching
    )


def read_pair_lines(
    path: Path, findings: Findings, error: type[RelocbenchError] = DatasetError
) -> dict[PairKey, PoseLine]:
    """The lines of a pair or prediction file whose timestamps are valid, the first of each pair.

    A line with an invalid pose is returned without a pose.
    """
    lines: dict[PairKey, PoseLine] = {}
    with findings.catching():
        for number, fields in read_rows(path, f"a relocalization file ({POSE_LINE})", error):
            with findings.catching():
                _read_pair_line(fields, path, number, lines, findings, error)
    return lines


def _read_pair_line(
    fields: list[str],
    path: Path,
    number: int,
    lines: dict[PairKey, PoseLine],
    findings: Findings,
    error: type[RelocbenchError],
) -> None:
    wanted = error(f"expected 2 or 9 columns ({POSE_LINE}), found {len(fields)}", path, number)
    if len(fields) < 2:
        raise wanted
    key = parse_timestamp(fields[0], path, number, error), parse_timestamp(fields[1], path, number, error)
    if key in lines:
        raise error(f"pair {key[0]} {key[1]} occurs again (first on line {lines[key].line})", path, number)
    lines[key] = PoseLine(*key, None, number)
    if len(fields) not in (2, 9):
        raise wanted
    if len(fields) == 9:
        lines[key] = PoseLine(*key, parse_pose(fields[2:], path, number, error), number)


def read_pair_table(path: Path, findings: Findings) -> dict[PairKey, TableRow]:
    """The rows of a pair set's table whose timestamps are valid, the first of each pair."""
    rows: dict[PairKey, TableRow] = {}
    for line, key, values in pair_rows(path, findings.catching):
        numbers: dict[str, float | None] = {}
        for name in [*_PAIR_NUMBERS, *(c for c in FURTHER_COLUMNS if c in values)]:
            numbers[name] = None
            with findings.catching():
                numbers[name] = known_number(values[name], name, path, line)
                _check_range(name, numbers[name], path, line)
        accepted, distance, angle = values["accepted"], numbers["distance_m"], numbers["angle_deg"]
        if accepted not in ("true", "false"):
            findings.fault(f"accepted is '{accepted}', expected true or false", path, line)
        rows[key] = TableRow(key, accepted != "false", values["group"], values["source"], distance, angle, line)
    return rows


def _check_range(name: str, value: float | None, path: Path, line: int) -> None:
    """Raise DatasetError if a measure of a pair is one that no pair has."""
    low, high = _RANGES.get(name, (-math.inf, math.inf))
    if value is not None and not low <= value <= high:
        wanted = f"at least {low:g}" if high == math.inf else f"{low:g} to {high:g}"
        raise DatasetError(f"{name} is {value:g}, expected {wanted}", path, line)


def check_points(path: Path, camera: Camera | None, findings: Findings) -> int:
    """Check sparse keyframe points and return the number of valid ones."""
    sound = 0
    for number, row in _table(path, _POINT_COLUMNS, "keyframe points", findings):
        with findings.catching():
            u, v, inverse_depth, sigma = parse_floats(row, path, number, " ".join(_POINT_COLUMNS), DatasetError)
            if inverse_depth <= 0 or sigma < 0:
                raise DatasetError("inverse_depth must be positive and sigma not negative", path, number)
            if camera is not None and not camera.contains([u, v], border=-0.5):
                raise DatasetError(
                    f"pixel ({u:g}, {v:g}) is outside the {camera.width}x{camera.height} image", path, number
                )
            sound += 1
    return sound


def _table(path: Path, columns: tuple[str, ...], what: str, findings: Findings) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields of each row after the header."""
    with findings.catching():
        rows = read_csv(path, what, DatasetError)
        if next(rows, (1, []))[1] != list(columns):
            raise DatasetError(f"expected the header {','.join(columns)}", path, 1)
        yield from rows


def single_errors(bad: ValidationError) -> Iterator[ValidationError]:
    """A validation error for each fault of one."""
    for error in bad.errors():
        kept = {k: v for k, v in error.items() if k in ("type", "loc", "input", "ctx")}
        yield ValidationError.from_exception_data(bad.title, [kept])  # type: ignore[list-item]
