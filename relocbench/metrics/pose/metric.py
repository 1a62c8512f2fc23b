"""What a metric of a pair set is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from relocbench.arrays import Array
from relocbench.metrics.pose.errors import PoseErrors
from relocbench.metrics.pose.scores import PairScores

SIGMA_FACTOR = 2.0
"""a threshold below this many ground-truth sigmas measures the errors of the ground truth rather than the method's"""
Place = Literal["set page", "more", "first page", "paper", "terminal", "confidence"]
"""tables for people: on the page of a dataset, folded away there, on the first page, in LaTeX, on the terminal, and of
confidences"""


@dataclass(frozen=True)
class Metric:
    """A metric of a pair set: its name, how it is computed, and its description."""

    name: str
    unit: str
    """share (0..1; printed as percent), m, deg, s, bytes, or count"""
    higher_is_better: bool
    description: str
    compute: Callable[[PairScores], float | None]
    """the value over all pairs; None when its inputs (seconds, confidence, cameras) were not given"""
    per_pair: Callable[[PoseErrors], Array] | None = None
    """(N,) values whose plain mean is the metric, for metrics that are such a mean: the bootstrap resamples them"""
    over: Callable[[PairScores], int] | None = None
    """the number of pairs that the metric is over, where it is not over all; tables show it beside the value"""
    translation_threshold_m: float | None = None
    rotation_threshold_deg: float | None = None
    shown: frozenset[Place] = frozenset()
    """the tables for people that have it, besides those of CSV and JSON, which have all"""
    with_interval: bool = False
    """whether tables have its 95 % interval, also where another metric ranks"""

    def threshold_finer_than(self, sigma_m: float | None, sigma_deg: float | None = None) -> bool:
        """Whether a threshold of the metric is below :data:`SIGMA_FACTOR` times the ground truth's sigma.

        Tables print such a number in grey. ``sigma_m`` and ``sigma_deg`` are standard deviations of the pair set's
        ground truth; a threshold is never too fine for an unknown one (None).
        """
        return finer_than_truth(self.translation_threshold_m, self.rotation_threshold_deg, sigma_m, sigma_deg)


def finer_than_truth(
    metres: float | None, degrees: float | None, sigma_m: float | None, sigma_deg: float | None
) -> bool:
    """Whether a threshold is below :data:`SIGMA_FACTOR` times the truth's sigma; never where one of the two is None."""
    limits = ((metres, sigma_m), (degrees, sigma_deg))
    return any(t is not None and sigma is not None and t < SIGMA_FACTOR * sigma for t, sigma in limits)
