"""The tables of a probe as they are written and read: shares at each offset, radii at which half is left, starts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict

from relocbench.datasets.core.schema import Fingerprint, FolderName
from relocbench.errors import PredictionError
from relocbench.evaluation.tables.schema import COUNT, TEXT, Kind, Record, Schema, TableRow
from relocbench.files import load_yaml
from relocbench.metrics import LEVEL, Difference, Interval, in_points


def _share(row: TableRow, name: str) -> float:
    value = row.number(name)
    if not 0 <= value <= 1:
        raise row.fault(f"{name} is {row[name][:60]}, expected a share from 0 to 1")
    return value


def _decimals(value: float | None) -> str:
    return "" if value is None else f"{value:.6f}"


def _known(row: TableRow, name: str) -> float | None:
    if row[name] == "inf":
        return math.inf
    return None if row[name] in ("", "nan") else row.number(name)


SHARE = Kind(_share, _decimals)
"""0..1, with six decimals"""
DECIMAL = Kind(_known, _decimals)
"""a number with six decimals, or ``inf``; nothing where none is known"""
OFFSET = Kind(TableRow.number, lambda value: f"{value:g}")
FLAG = Kind(lambda row, name: row[name] == "1", int)
"""0 or 1"""


@dataclass(frozen=True)
class Curve(Record):
    """What a row is of."""

    method: Annotated[str, TEXT]
    what: Annotated[str, TEXT]
    level: Annotated[str, TEXT]
    """pyramid level that was used alone; empty where the method worked as usual"""
    conditions: Annotated[str, TEXT]
    criterion: Annotated[str, TEXT]
    unit: Annotated[str, TEXT]

    @property
    def curve(self) -> tuple[str, ...]:
        """By which rows of one curve are known."""
        return self.method, self.what, self.level, self.conditions, self.criterion


@dataclass(frozen=True)
class SharePoint(Curve):
    """The share of starts at one offset that ended near the truth."""

    offset: Annotated[float, OFFSET]
    pairs: Annotated[int, COUNT]
    starts: Annotated[int, COUNT]
    share: Annotated[float, SHARE]
    share_of_starts: Annotated[float, SHARE]
    """that the starts themselves would get"""


@dataclass(frozen=True)
class Radii(Curve):
    """Where the share falls below a half, and below half of the share from the truth, beside the first method's."""

    pairs: Annotated[int, COUNT]
    radius: Annotated[float | None, DECIMAL]
    beyond: Annotated[bool, FLAG]
    """whether it lies beyond the largest offset, which it then is"""
    low: Annotated[float | None, DECIMAL]
    high: Annotated[float | None, DECIMAL]
    ratio: Annotated[float | None, DECIMAL]
    ratio_low: Annotated[float | None, DECIMAL]
    ratio_high: Annotated[float | None, DECIMAL]
    from_truth: Annotated[float, SHARE]
    half_left: Annotated[float | None, DECIMAL]
    half_left_beyond: Annotated[bool, FLAG]
    half_left_low: Annotated[float | None, DECIMAL]
    half_left_high: Annotated[float | None, DECIMAL]
    half_ratio: Annotated[float | None, DECIMAL]
    half_ratio_low: Annotated[float | None, DECIMAL]
    half_ratio_high: Annotated[float | None, DECIMAL]

    @property
    def half_text(self) -> str | None:
        """The offset at which half of the share from the truth is left, as people read it: ``6.31 [5.90, 6.84] px``."""
        if self.half_left is None:
            return None
        value = f"> {self.half_left:g}" if self.half_left_beyond else f"{self.half_left:.2f}"
        low, high = self.half_left_low, self.half_left_high
        return f"{value}{'' if low is None or high is None else f' [{low:.2f}, {high:.2f}]'} {self.unit}"


@dataclass(frozen=True)
class StartShares(Record):
    """How often a method comes back from the keyframe's pose, and from others as far away."""

    method: Annotated[str, TEXT]
    conditions: Annotated[str, TEXT]
    criterion: Annotated[str, TEXT]
    pairs: Annotated[int, COUNT]
    keyframe: Annotated[float, SHARE]
    mirrored: Annotated[float, SHARE]
    random: Annotated[float, SHARE]
    keyframe_less_random: Annotated[float | None, DECIMAL]
    low: Annotated[float | None, DECIMAL]
    high: Annotated[float | None, DECIMAL]

    @property
    def ahead_text(self) -> str:
        """``keyframe_less_random`` in percentage points, as people read it; empty where it is not known."""
        if self.keyframe_less_random is None:
            return ""
        interval = None if self.low is None or self.high is None else Interval(self.low, self.high, LEVEL)
        return in_points(Difference(self.keyframe_less_random, interval))


SHARES, RADII, STARTS = Schema(SharePoint), Schema(Radii), Schema(StartShares)


PROBE = "probe.yaml"
"""the record of a probe, by which its folder is known"""


@dataclass(frozen=True)
class ProbeLine:
    """The curve of one method: the share of starts that ended near the truth, by how far off they began."""

    points: tuple[SharePoint, ...]
    """at least one"""
    radii: Radii | None
    """known for the main criterion"""


@dataclass(frozen=True)
class ProbeTables:
    """What the folder of a probe holds."""

    folder: Path
    dataset: str
    fingerprint: str
    lines: tuple[ProbeLine, ...]
    starts: tuple[StartShares, ...] = ()
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
    curves: dict[tuple[str, ...], list[SharePoint]] = {}
    for point in SHARES.read(folder / "probe.csv"):
        curves.setdefault(point.curve, []).append(point)
    radii = {row.curve: row for row in RADII.read(folder / "radii.csv")}
    lines = tuple(ProbeLine(tuple(points), radii.get(curve)) for curve, points in curves.items())
    starts = folder / "starts.csv"
    return ProbeTables(
        folder, record.dataset, record.fingerprint, lines, tuple(STARTS.read(starts)) if starts.exists() else ()
    )
