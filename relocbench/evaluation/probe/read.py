"""Reading what a probe wrote: its curves, and the offset at which half of the successes are left."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from relocbench.datasets.core.schema import Fingerprint, FolderName
from relocbench.errors import PredictionError
from relocbench.evaluation.probe.starts import KINDS
from relocbench.evaluation.probe.write import RADIUS_COLUMNS, SHARE_COLUMNS, START_COLUMNS
from relocbench.evaluation.tables.rows import TableRow, read_rows
from relocbench.files import load_yaml

PROBE = "probe.yaml"
"""the record of a probe, by which its folder is known"""
_LINE = ("method", "what", "level", "conditions", "criterion")


@dataclass(frozen=True)
class ProbeHalf:
    """The offset at which half of the share from the truth is left."""

    value: float
    beyond: bool
    """whether it lies beyond the largest offset, which ``value`` then is"""
    low: float | None
    high: float | None
    """its interval, where there are pairs enough"""
    unit: str

    @property
    def text(self) -> str:
        """As people read it: ``6.31 [5.90, 6.84] px``."""
        value = f"> {self.value:g}" if self.beyond else f"{self.value:.2f}"
        bounds = "" if self.low is None or self.high is None else f" [{self.low:.2f}, {self.high:.2f}]"
        return f"{value}{bounds} {self.unit}"


@dataclass(frozen=True)
class ProbeLine:
    """The curve of one method: the share of starts that ended near the truth, by how far off they began."""

    method: str
    what: str
    level: str
    """pyramid level that was used alone; empty where the method worked as usual"""
    conditions: str
    criterion: str
    unit: str
    pairs: int
    offsets: tuple[float, ...]
    shares: tuple[float, ...]
    """0..1"""
    starts: tuple[float, ...]
    """the shares that the starts themselves would get"""
    half: ProbeHalf | None
    """known for the main criterion"""


@dataclass(frozen=True)
class ProbeStart:
    """How often a method comes back from the keyframe's pose, and from others as far away."""

    method: str
    conditions: str
    pairs: int
    keyframe: float
    """share 0..1"""
    mirrored: float
    random: float
    ahead: float
    """by how much the share from the keyframe's pose exceeds that from random ones"""
    low: float | None
    high: float | None
    """the interval of ``ahead``, where there are pairs enough"""


@dataclass(frozen=True)
class ProbeTables:
    """What the folder of a probe holds."""

    folder: Path
    dataset: str
    fingerprint: str
    lines: tuple[ProbeLine, ...]
    starts: tuple[ProbeStart, ...] = ()
    """known where whole poses were started at the keyframe's pose"""


class _Record(BaseModel):
    """What is needed of ``probe.yaml``."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    dataset: FolderName
    fingerprint: Fingerprint


def read_probe(folder: Path) -> ProbeTables:
    """Read the folder that ``relocbench probe`` wrote.

    Raises:
        PredictionError: with file and line: a table or record is missing or bad.
    """
    record = load_yaml(folder / PROBE, _Record, "the record of a probe", PredictionError)
    halves = {tuple(row[name] for name in _LINE): _half(row) for row in read_rows(folder / "radii.csv", RADIUS_COLUMNS)}
    points: dict[tuple[str, ...], list[TableRow]] = {}
    for row in read_rows(folder / "probe.csv", SHARE_COLUMNS):
        points.setdefault(tuple(row[name] for name in _LINE), []).append(row)
    lines = tuple(_line(key, rows, halves.get(key)) for key, rows in points.items())
    starts = folder / "starts.csv"
    probe_starts = tuple(map(_start, read_rows(starts, START_COLUMNS))) if starts.exists() else ()
    return ProbeTables(folder, record.dataset, record.fingerprint, lines, probe_starts)


def _start(row: TableRow) -> ProbeStart:
    keyframe, mirrored, random = (row.number(kind) for kind in KINDS)
    if not all(0 <= share <= 1 for share in (keyframe, mirrored, random)):
        raise row.fault("expected shares from 0 to 1")
    ahead, low, high = row.number("keyframe_less_random"), _known(row, "low"), _known(row, "high")
    return ProbeStart(
        row["method"], row["conditions"], row.count("pairs"), keyframe, mirrored, random, ahead, low, high
    )


def _line(key: tuple[str, ...], rows: list[TableRow], half: ProbeHalf | None) -> ProbeLine:
    offsets, shares, starts = (tuple(row.number(n) for row in rows) for n in ("offset", "share", "share_of_starts"))
    for row, *values in zip(rows, shares, starts, strict=True):
        if not all(0 <= value <= 1 for value in values):
            raise row.fault("expected shares from 0 to 1")
    method, what, level, conditions, criterion = key
    unit, pairs = rows[0]["unit"], rows[0].count("pairs")
    return ProbeLine(method, what, level, conditions, criterion, unit, pairs, offsets, shares, starts, half)


def _half(row: TableRow) -> ProbeHalf | None:
    value = _known(row, "half_left")
    if value is None:
        return None
    low, high = _known(row, "half_left_low"), _known(row, "half_left_high")
    return ProbeHalf(value, row["half_left_beyond"] == "1", low, high, row["unit"])


def _known(row: TableRow, name: str) -> float | None:
    """A number; None where the field is blank or no number is known."""
    return None if row[name] in ("", str(math.nan)) else row.number(name)
