"""The summary of a pair set: every metric of the registry over all pairs.

Shares are 0..1 here; tables print percent. Values are plain ``float``, ``int`` or None, so that a summary can be
written as JSON; medians may be ``inf``, which Python's ``json`` writes as ``Infinity``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.errors import DatasetError
from relocbench.metrics.pose.errors import PoseErrors
from relocbench.metrics.pose.failure_policy import mean_over_pair_sets
from relocbench.metrics.pose.registry import METRICS
from relocbench.metrics.pose.scores import PairScores


@dataclass(frozen=True)
class PairSetSummary:
    """All metrics of one method on one pair set."""

    pairs: int
    """N, the denominator of every share"""
    answered: int
    values: Mapping[str, float | None]
    """by metric name, in the registry's order; None where its inputs were not given"""

    def __getitem__(self, name: str) -> float | None:
        return self.values[name]

    def to_dict(self) -> dict[str, Any]:
        """``pairs``, ``answered`` and every metric as one flat mapping."""
        return {"pairs": self.pairs, "answered": self.answered, **self.values}


def summarize(errors: PoseErrors, seconds: Array | None = None, confidence: Array | None = None) -> PairSetSummary:
    """Compute every metric that errors, seconds and confidences give.

    Args:
        errors: N pairs.
        seconds: (N,) seconds of a pair, NaN where the method was not run; None if not measured at all.
        confidence: (N,) higher is more certain, NaN where not given; None if the method gives none.

    Raises:
        DatasetError: as :func:`summarize_scores`.
        ValueError: the lengths do not fit.
    """
    return summarize_scores(PairScores(errors, seconds, confidence))


def summarize_scores(scores: PairScores) -> PairSetSummary:
    """Compute every metric of the registry over a pair set. Raises DatasetError where there is no pair to score."""
    errors = scores.errors
    if len(errors) == 0:
        raise DatasetError("the pair set holds no accepted pair; expected at least one to score")
    values = {metric.name: metric.compute(scores) for metric in METRICS}
    return PairSetSummary(pairs=len(errors), answered=int(np.sum(errors.answered)), values=values)


def totals(summaries: Sequence[PairSetSummary | None]) -> dict[str, float | None]:
    """The mean of each metric over the pair sets, each set with equal weight.

    ``summaries`` has one entry for each pair set; where one is None (no result), every total is None.
    """
    return {
        metric.name: mean_over_pair_sets([None if s is None else s[metric.name] for s in summaries])
        for metric in METRICS
    }


@dataclass(frozen=True)
class Spread:
    """The mean and standard deviation of a metric over runs that differ by their seed alone."""

    mean: float
    standard_deviation: float | None
    """of the sample (divided by n - 1); None for a single seed, or where a value is infinite"""
    seeds: int


def spread_over_seeds(values: Sequence[float]) -> Spread:
    """The mean and standard deviation of one metric over runs that differ by their seed alone.

    Raises:
        ValueError: no values.
    """
    if not values:
        raise ValueError("a spread needs the value of at least one seed")
    mean = float(np.mean(values))
    known = len(values) > 1 and math.isfinite(mean)
    return Spread(mean, float(np.std(values, ddof=1)) if known else None, len(values))
