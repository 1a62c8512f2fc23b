"""A pair set in numbers: every metric of the registry over all pairs.

Shares are 0..1 here; tables print percent. Values are plain ``float``, ``int`` or None, so a summary goes to
JSON as it is; medians may be ``inf``, which Python's ``json`` writes as ``Infinity``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.errors import DatasetError
from relocbench.metrics.pose.errors import PoseErrors
from relocbench.metrics.pose.failure_policy import mean_over_pair_sets
from relocbench.metrics.pose.registry import METRICS, PairScores

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PairSetSummary:
    """All metrics of one method on one pair set."""

    pairs: int
    """N, the denominator of every share"""
    answered: int
    values: Mapping[str, float | None]
    """by metric name, in the registry's order; None where the method gave nothing to compute it from"""

    def __getitem__(self, name: str) -> float | None:
        return self.values[name]

    def to_dict(self) -> dict[str, Any]:
        """``pairs``, ``answered`` and every metric, flat."""
        return {"pairs": self.pairs, "answered": self.answered, **self.values}


def summarize(errors: PoseErrors, seconds: Array | None = None, confidence: Array | None = None) -> PairSetSummary:
    """Every metric of the registry.

    Args:
        errors: N pairs.
        seconds: (N,) seconds of a pair, NaN where the method was not run; None if never measured.
        confidence: (N,) higher is surer, NaN where not given; None if the method gives none.

    Raises:
        DatasetError: there is no pair to score.
        ValueError: the lengths do not fit.
    """
    if len(errors) == 0:
        raise DatasetError("the pair set holds no accepted pair; expected at least one to score")
    scores = PairScores(errors, seconds, confidence)
    values = {metric.name: metric.compute(scores) for metric in METRICS}
    return PairSetSummary(pairs=len(errors), answered=int(np.sum(errors.answered)), values=values)


def totals(summaries: Sequence[PairSetSummary | None]) -> dict[str, float | None]:
    """Each metric's mean over the pair sets, each set counting the same.

    One entry a pair set of the dataset, None where the method has no result: then every total is None.
    """
    return {
        metric.name: mean_over_pair_sets([None if s is None else s[metric.name] for s in summaries])
        for metric in METRICS
    }


@dataclass(frozen=True)
class Spread:
    """A metric of a method with randomness over several seeds."""

    mean: float
    standard_deviation: float | None
    """of the sample (n - 1); None for one seed, or where a value is infinite"""
    seeds: int


def spread_over_seeds(values: Sequence[float]) -> Spread:
    """Mean and standard deviation of one metric over runs that differ by seed alone.

    Raises ValueError when there is none.
    """
    if not values:
        raise ValueError("a spread needs the value of at least one seed")
    mean = float(np.mean(values))
    known = len(values) > 1 and math.isfinite(mean)
    return Spread(mean, float(np.std(values, ddof=1)) if known else None, len(values))
