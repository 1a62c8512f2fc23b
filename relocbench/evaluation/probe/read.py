"""Reading what a probe wrote: its curves, and the offset at which half of the successes are left."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from relocbench.datasets.core.schema import Fingerprint, FolderName
from relocbench.errors import PredictionError
from relocbench.evaluation.probe.records import RADII, SHARES, STARTS, Radii, SharePoint, StartShares
from relocbench.files import load_yaml

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
