"""The kinds of metrics of a pair set: what each is computed from, and what it says where that is not known."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.metrics.pose.errors import PoseErrors
from relocbench.metrics.pose.metric import Metric
from relocbench.metrics.pose.scores import CORRECT, PairScores
from relocbench.metrics.pose.sequences import Drive

WITHIN_CORRECT = f"translation_error_m <= {CORRECT[0]:g} and rotation_error_deg <= {CORRECT[1]:g}"
"""what is correct, in words"""


def mean_over_pairs(
    name: str,
    description: str,
    per_pair: Callable[[PoseErrors], Array],
    metres: float | None = None,
    degrees: float | None = None,
) -> Metric:
    """A share that is the plain mean of (N,) values.

    Args:
        metres, degrees: the thresholds that it has.
    """
    return Metric(
        name=name,
        unit="share",
        higher_is_better=True,
        description=description,
        compute=lambda scores: float(np.mean(per_pair(scores.errors))),
        per_pair=per_pair,
        translation_threshold_m=metres,
        rotation_threshold_deg=degrees,
    )


def of_correct(
    name: str,
    unit: str,
    higher_is_better: bool,
    description: str,
    compute: Callable[[PairScores], float | None],
    over: Callable[[PairScores], int] | None = None,
) -> Metric:
    """A metric of which answers are correct, whose thresholds stand behind its name."""
    metres, degrees = CORRECT
    return Metric(
        f"{name}@({metres:g}m,{degrees:g}deg)",
        unit,
        higher_is_better,
        description,
        compute,
        over=over,
        translation_threshold_m=metres,
        rotation_threshold_deg=degrees,
    )


def of_confidence(
    name: str, higher_is_better: bool, description: str, value: Callable[[Mask, Mask, Array], float | None]
) -> Metric:
    """A metric of how confidences fit what is correct; without any confidence all answers count as equally sure.

    Args:
        value: of (N,) whether each pair is correct, whether it is answered, and how confidently.
    """

    def compute(scores: PairScores) -> float | None:
        return value(scores.correct, scores.errors.answered, scores.column("confidence"))

    return of_correct(name, "share", higher_is_better, f"{description}; correct is {WITHIN_CORRECT}", compute)


def recall_where(name: str, words: str, inside: Callable[[PairScores], Mask]) -> Metric:
    """The recall over some of the pairs; one for which it is not known whether it belongs to them does not."""

    def compute(scores: PairScores) -> float | None:
        rows = inside(scores)
        return float(np.mean(scores.correct[rows])) if rows.any() else None

    description = f"share of the pairs {words} with {WITHIN_CORRECT}; nothing without such a pair"
    return of_correct(
        f"recall_{name}", "share", True, description, compute, lambda scores: int(np.count_nonzero(inside(scores)))
    )


def of_drives(
    name: str, unit: str, higher_is_better: bool, description: str, value: Callable[[list[Drive]], float | None]
) -> Metric:
    """A metric of what is right along the drives of the queries; None where their times are not given."""

    def compute(scores: PairScores) -> float | None:
        return None if scores.drives is None else value(scores.drives)

    return of_correct(name, unit, higher_is_better, f"{description}; right is {WITHIN_CORRECT}", compute)


def of_vcre(name: str, description: str, value: Callable[[Array, PairScores], float], **options: Any) -> Metric:
    """A metric of the reprojection errors (N,); None where one of them is not known."""

    def compute(scores: PairScores) -> float | None:
        vcre = scores.column("vcre")
        return None if np.isnan(vcre).any() else value(vcre, scores)

    return Metric(name=name, unit="share", description=description, compute=compute, **options)
