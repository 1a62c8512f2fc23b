"""Which methods of a board are nearly copies of each other, and which of them came first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from relocbench.evaluation.common.results import PREDICTIONS, RunRecord

SETTINGS_WITHIN = 0.1
"""by which share of the larger one two numbers may differ in parameters that are apart in little"""
_SEED = "seed"


def nearly_same_settings(a: Sequence[RunRecord], b: Sequence[RunRecord]) -> bool:
    """Whether runs are of the same code and weights, and their parameters differ by seeds or by little.

    Of predictions that were made elsewhere nobody knows what made them.
    """
    return len(a) == len(b) and all(map(_nearly_same, a, b))


def _nearly_same(a: RunRecord, b: RunRecord) -> bool:
    same = (a.target, a.files, a.versions.get("method")) == (b.target, b.files, b.versions.get("method"))
    return same and not a.target.startswith(PREDICTIONS) and _close(_settings(a), _settings(b))


def _settings(run: RunRecord) -> dict[str, Any]:
    return {key: value for key, value in run.parameters.items() if key != _SEED}


def _close(a: Any, b: Any) -> bool:
    """Whether two parameters are equal but for numbers that differ by little."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_close(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_close, a, b))
    numbers = [isinstance(x, int | float) and not isinstance(x, bool) for x in (a, b)]
    if all(numbers):
        return bool(abs(a - b) <= SETTINGS_WITHIN * max(abs(a), abs(b)))
    return type(a) is type(b) and bool(a == b)


def came(runs: Sequence[Sequence[RunRecord]], label: str) -> tuple[bool, bool, str, str]:
    """What sorts methods by when they came: those that were run here first, then those that others handed in.

    A run's start is what this machine wrote; what is handed in has none that could be believed.

    Args:
        runs: of each dataset, of which the first counts; both halves of a pipeline, of which the last counts.
    """
    handed_in = any(run.made_elsewhere or run.target.startswith(PREDICTIONS) for of in runs for run in of)
    starts = [start for of in runs if (start := max((run.start for run in of), default=""))]
    return handed_in, not starts, min(starts, default=""), label
