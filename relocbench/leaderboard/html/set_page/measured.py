"""What was measured of methods besides their answers, and how many months lie between keyframe and query.

Measured are the matching of single pixels, and basins by ``relocbench probe``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from relocbench.arrays import Indices
from relocbench.datasets.core.dataset import Dataset
from relocbench.evaluation.common.results import PairSetRecord
from relocbench.evaluation.probe.records import PROBE, ProbeTables, read_probe
from relocbench.evaluation.probe.starts import KINDS
from relocbench.evaluation.tables.matching import OFFSETS_PX, Summary
from relocbench.leaderboard.tracking.matching import matching_lines
from relocbench.leaderboard.tracking.model import DatasetBoard

_NEAR = ("1px", "3px")


def matching_payload(dataset: DatasetBoard) -> dict[str, Any]:
    """By pair set: the shares of pixels that each method found, and of starts that were near already, by offset."""
    pair_sets = {}
    for name in dataset.entry.pair_sets:
        lines = matching_lines(dataset, name)
        if lines:
            methods = {method.label: _shares(summary, "match") for method, summary in lines}
            pair_sets[name] = {"methods": methods, "starts": _shares(lines[0][1], "start")}
    return {"offsets": list(OFFSETS_PX), "pair_sets": pair_sets} if pair_sets else {}


def probes_of(dataset: DatasetBoard) -> list[ProbeTables]:
    """The probes of a dataset whose folders lie in the results folder, or in the dataset's folder there.

    Raises:
        PredictionError: a table of a probe is bad.
    """
    entry = dataset.entry
    results = {method.results.root.parent for method in entry.methods if method.results is not None}
    folders = {path.parent for root in results for where in (root, root.parent) for path in _probes_in(where)}
    known = {entry.record.fingerprint, *entry.copies}
    probes = [read_probe(folder) for folder in sorted(folders)]
    return [p for p in probes if p.dataset == entry.record.name and p.fingerprint in known]


_CURVE = ("method", "what", "level", "conditions", "criterion", "unit", "pairs")
_START = {name: name for name in ("method", "conditions", "pairs", *KINDS)}
_START["ahead"] = "ahead_text"


def probe_payload(probe: ProbeTables) -> dict[str, Any]:
    """A probe as the page takes it."""
    return {
        "folder": probe.folder.name,
        "lines": [
            {
                **{name: getattr(line.points[0], name) for name in _CURVE},
                "offsets": [point.offset for point in line.points],
                "shares": [point.share for point in line.points],
                "starts": [point.share_of_starts for point in line.points],
                "half": None if line.radii is None else line.radii.half_text,
            }
            for line in probe.lines
        ],
        "starts": [{name: getattr(start, of) for name, of in _START.items()} for start in probe.starts],
    }


def _probes_in(folder: Path) -> list[Path]:
    return [path for path in folder.glob(f"*/{PROBE}") if path.is_file()]


def _shares(summary: Summary, what: str) -> dict[str, list[float | int | None]]:
    return {near: [summary[f"{offset}px"][f"{what}@{near}"] for offset in OFFSETS_PX] for near in _NEAR}


SEASONS = {"winter": 0, "spring": 1, "summer": 2, "autumn": 3, "fall": 3}
"""season -> its place in the year, in quarters"""
_EARLIEST_NS, _LATEST_NS = 631_152_000_000_000_000, 4_102_444_800_000_000_000
"""the beginnings of 1990 and 2100: other times count from the beginning of a drive and are no dates"""


def months_apart(record: PairSetRecord, keys: Indices, dataset: Dataset | None) -> dict[str, Any]:
    """What tells the months between the two images of a pair: ``by`` is one of these.

    - ``drive``: both are of one drive, and none lie between them.
    - ``dates``: the times of both are dates, so that they tell it for each pair.
    - ``seasons``: the seasons of both drives are recorded; ``months`` is 3 for neighbouring seasons, at most 6.
    - ``None``: not recorded.

    Args:
        record: of the pair set.
        keys: (N, 2) times of keyframes and queries, nanoseconds.
        dataset: the dataset where it is available; otherwise seasons are looked for in the names of conditions.
    """
    if record.reference == record.query:
        return {"by": "drive", "months": 0}
    if len(keys) and int(keys.min()) >= _EARLIEST_NS and int(keys.max()) < _LATEST_NS:
        return {"by": "dates", "months": None}
    sides = ((record.reference, record.reference_condition), (record.query, record.query_condition))
    seasons = [_season(name, condition, dataset) for name, condition in sides]
    if None in seasons:
        return {"by": None, "months": None}
    quarters = abs(SEASONS[str(seasons[0])] - SEASONS[str(seasons[1])])
    return {"by": "seasons", "months": 3 * min(quarters, 4 - quarters)}


def _season(traversal: str, condition: str, dataset: Dataset | None) -> str | None:
    words = condition.split(",") if dataset is None else [dataset.traversal(traversal).condition.season]
    return next((word.strip().lower() for word in words if word.strip().lower() in SEASONS), None)
