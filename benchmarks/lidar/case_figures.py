"""The figures of a case of a benchmark of ground truth: how many pairs are accepted, and how far they are off."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from ground_truth_judging import errors

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.pairs.outcome import PairOutcome
from relocbench.datasets.groundtruth.pairs.reasons import by_kind, common

Off = tuple[float, float, float]
"""metres and degrees off the truth, and the normalised error squared"""


def off_truth(pair: PairOutcome, T_query_ref: Array) -> Off:
    """How far a pair with a pose is off the true one (4, 4)."""
    assert pair.T_query_ref is not None
    assert pair.covariance is not None
    metres, degrees, _, xi = errors(pair.T_query_ref, T_query_ref)
    return metres, degrees, float(xi @ np.linalg.solve(pair.covariance, xi) / 6)


def case_figures(found: Sequence[PairOutcome], off: Sequence[Off], wrong: int) -> dict[str, Any]:
    """The figures of all pairs of a case; ``off`` is of the accepted ones."""
    kinds = by_kind(pair.reason for pair in found if not pair.accepted)
    often = max(kinds.values(), key=len, default=[])
    out: dict[str, Any] = {"pairs": len(found), "accepted": len(off), "wrong": wrong}
    out["refused_because"] = common(often) if often else ""
    if off:
        metres, degrees, normalised = np.array(off).T
        out |= {
            "median_m": round(float(np.median(metres)), 5),
            "max_m": round(float(metres.max()), 5),
            "median_deg": round(float(np.median(degrees)), 4),
            "max_deg": round(float(degrees.max()), 4),
            "normalised": round(float(normalised.mean()), 2),
        }
    return out
