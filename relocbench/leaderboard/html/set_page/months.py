"""How many months lie between keyframe and query, as far as results record it, or a dataset that is available."""

from __future__ import annotations

from typing import Any

from relocbench.arrays import Indices
from relocbench.datasets.core.dataset import Dataset
from relocbench.evaluation.common.results import PairSetRecord

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
