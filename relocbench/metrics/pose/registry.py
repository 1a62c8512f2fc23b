"""The registry of pair-set metrics: stable name, unit, direction, formula and thresholds of each."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.errors import ConfigError
from relocbench.metrics.pose.confidence import CONFIDENT, is_confident, precision_recall, risk_coverage_area
from relocbench.metrics.pose.curves import area_shares
from relocbench.metrics.pose.errors import PoseErrors
from relocbench.metrics.pose.metric import Metric, Place
from relocbench.metrics.pose.scores import CORRECT, PairScores, within
from relocbench.metrics.pose.sequences import Drive, LostStretches, right_runs
from relocbench.metrics.pose.tiers import LOOKS, TIERS

_Judged = tuple[Mask, Mask, Array]
"""(N,) whether each pair is correct, whether it is answered, and how confidently"""

MLAD_THRESHOLDS_M: tuple[float, ...] = (0.1, 0.2, 0.5)
PRECISIONS_PERCENT: tuple[int, ...] = (95, 99)
"""the precision of the answers that are kept, where the share that can be kept is measured"""
VCRE_THRESHOLD = 0.1
"""of the image's diagonal, as in Map-free relocalization, whose images have a diagonal of 900 px"""
OVERLAPS: tuple[float, ...] = (-math.inf, 0.1, 0.2, 0.5, math.inf)
"""ends of the ranges of overlap whose pairs are counted apart; a range includes its lower end"""
SCALE_CHANGES: tuple[float, ...] = (-math.inf, 1.15, 1.4, 1.8, math.inf)
"""the same of the change of scale; a range includes its upper end"""
STRETCHES: tuple[int, ...] = (2, 5, 10)
"""numbers of wrong queries in a row from which a stretch is counted"""
RUNS: tuple[int, ...] = (3, 5)
"""numbers of consecutive queries that are judged together"""


def metric_named(name: str) -> Metric:
    """The metric of that name. Raises ConfigError, which lists the names, if there is none."""
    for metric in METRICS:
        if metric.name == name:
            return metric
    raise ConfigError(f"unknown metric '{name}'; expected one of {', '.join(m.name for m in METRICS)}")


def _mean_metric(
    name: str,
    description: str,
    per_pair: Callable[[PoseErrors], Array],
    metres: float | None = None,
    degrees: float | None = None,
) -> Metric:
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


def _recall(metres: float, degrees: float) -> Metric:
    return _mean_metric(
        f"recall@({metres:g}m,{degrees:g}deg)",
        f"share of all pairs with translation_error_m <= {metres:g} and rotation_error_deg <= {degrees:g}",
        lambda errors: within(errors, metres, degrees).astype(np.float64),
        metres,
        degrees,
    )


def _mlad_recall(metres: float) -> Metric:
    return _mean_metric(
        f"mlad_recall@{metres:g}m",
        f"share of all pairs with mlad_translation_error_m <= {metres:g}",
        lambda errors: (errors.mlad_translation_error_m <= metres).astype(np.float64),
        metres,
    )


def _translation_auc(metres: float) -> Metric:
    return _mean_metric(
        f"t_auc@{metres:g}m",
        f"area under the cumulative curve of translation_error_m: 1/N sum max(0, 1 - e / {metres:g} m)",
        lambda errors: area_shares(errors.translation_error_m, metres),
        metres,
    )


def _rotation_auc(degrees: float) -> Metric:
    return _mean_metric(
        f"r_auc@{degrees:g}deg",
        f"area under the cumulative curve of rotation_error_deg: 1/N sum max(0, 1 - e / {degrees:g} deg)",
        lambda errors: area_shares(errors.rotation_error_deg, degrees),
        degrees=degrees,
    )


def _pose_auc(metres: float, degrees: float) -> Metric:
    return _mean_metric(
        f"pose_auc@({metres:g}m,{degrees:g}deg)",
        "area under the cumulative curve of the joint error: "
        f"1/N sum max(0, 1 - max(translation_error_m / {metres:g} m, rotation_error_deg / {degrees:g} deg))",
        lambda errors: area_shares(errors.joint_error(metres, degrees), 1.0),
        metres,
        degrees,
    )


def _median(error: str, unit: str) -> Metric:
    return Metric(
        name=f"median_{error}",
        unit=unit,
        higher_is_better=False,
        description=f"median of {error} over all pairs; inf when half of the pairs or more have no answer",
        compute=lambda scores: float(np.median(getattr(scores.errors, error))),
    )


def _seconds(name: str, percent: float, words: str) -> Metric:
    def compute(scores: PairScores) -> float | None:
        measured = np.array([]) if scores.seconds is None else scores.seconds[np.isfinite(scores.seconds)]
        return float(np.percentile(measured, percent)) if measured.size else None

    return Metric(name, "s", False, f"{words} of the seconds a pair, over the pairs that were run", compute)


def _peak_memory() -> Metric:
    def compute(scores: PairScores) -> float | None:
        known = scores.column("peak_memory_bytes")
        return float(np.nanmax(known)) if not np.isnan(known).all() else None

    description = (
        "most resident memory that a process of the method had, with its children, as the evaluator measured it"
    )
    return Metric("peak_memory_bytes", "bytes", False, description, compute)


def _confidence_area(metres: float, degrees: float) -> Metric:
    def compute(scores: PairScores) -> float | None:
        answered = scores.errors.answered
        if scores.confidence is None or not np.any(answered & ~np.isnan(scores.confidence)):
            return None
        correct = within(scores.errors, metres, degrees)
        return precision_recall(correct, answered, scores.confidence).area

    return Metric(
        name=f"confidence_auc_pr@({metres:g}m,{degrees:g}deg)",
        unit="share",
        higher_is_better=True,
        description="area under precision against recall as the threshold on the confidence falls; correct is "
        f"translation_error_m <= {metres:g} and rotation_error_deg <= {degrees:g}; recall is over all pairs",
        compute=compute,
        translation_threshold_m=metres,
        rotation_threshold_deg=degrees,
    )


def _of_confidence(
    name: str, higher_is_better: bool, description: str, value: Callable[[_Judged], float | None]
) -> Metric:
    """A metric of how confidences fit what is correct; without any confidence all answers count as equally sure."""
    metres, degrees = CORRECT

    def compute(scores: PairScores) -> float | None:
        correct = within(scores.errors, metres, degrees)
        return value((correct, scores.errors.answered, scores.column("confidence")))

    return Metric(
        name=f"{name}@({metres:g}m,{degrees:g}deg)",
        unit="share",
        higher_is_better=higher_is_better,
        description=f"{description}; correct is translation_error_m <= {metres:g} and rotation_error_deg <= "
        f"{degrees:g}",
        compute=compute,
        translation_threshold_m=metres,
        rotation_threshold_deg=degrees,
    )


def _wrong_of_answered() -> Metric:
    def value(judged: _Judged) -> float | None:
        correct, answered, _ = judged
        return float(1.0 - np.mean(correct[answered])) if np.any(answered) else None

    description = "share of the answers that are not correct; nothing where there is no answer"
    return _of_confidence("wrong_of_answered", False, description, value)


def _risk_coverage_area() -> Metric:
    description = (
        "area under the risk-coverage curve, 1/N sum over k of the share of wrong ones among the k most confident "
        "pairs; pairs without an answer come last and are wrong"
    )
    return _of_confidence("aurc", False, description, lambda judged: risk_coverage_area(*judged))


def _coverage_at(percent: int) -> Metric:
    description = (
        f"largest share of all pairs that a threshold on the confidence keeps with at least {percent} % of them "
        "correct; 0 where there is no such threshold"
    )
    return _of_confidence(
        f"coverage_at_precision_{percent}",
        True,
        description,
        lambda judged: precision_recall(*judged).coverage_at(percent / 100),
    )


def _precision_of_confident() -> Metric:
    def value(judged: _Judged) -> float | None:
        correct, answered, confidence = judged
        confident = answered & is_confident(confidence)
        return float(np.mean(correct[confident])) if np.any(confident) else None

    description = (
        f"share of correct ones among the answers with a confidence of {CONFIDENT:g} or more, which means "
        "something where confidences are probabilities; nothing where there is no such answer"
    )
    return _of_confidence(f"precision_at_confidence_{100 * CONFIDENT:g}", True, description, value)


def _coverage_of_confident() -> Metric:
    def compute(scores: PairScores) -> float:
        if scores.confidence is None:
            return 0.0
        return float(np.mean(scores.errors.answered & is_confident(scores.confidence)))

    return Metric(
        name=f"coverage_at_confidence_{100 * CONFIDENT:g}",
        unit="share",
        higher_is_better=True,
        description=f"share of all pairs with an answer of confidence {CONFIDENT:g} or more",
        compute=compute,
    )


def _of_vcre(name: str, description: str, value: Callable[[Array, PairScores], float], **options: Any) -> Metric:
    """A metric of the reprojection errors (N,); None where one of them is not known."""

    def compute(scores: PairScores) -> float | None:
        vcre = scores.column("vcre")
        return None if np.isnan(vcre).any() else value(vcre, scores)

    return Metric(name=name, unit="share", description=description, compute=compute, **options)


def _vcre_precision() -> Metric:
    return _of_vcre(
        f"vcre_precision@{VCRE_THRESHOLD:.0%}",
        "share of all pairs whose virtual correspondence reprojection error is below "
        f"{VCRE_THRESHOLD:.0%} of the image's diagonal",
        lambda vcre, _: float(np.mean(vcre < VCRE_THRESHOLD)),
        higher_is_better=True,
    )


def _vcre_auc() -> Metric:
    def value(vcre: Array, scores: PairScores) -> float:
        judged = vcre < VCRE_THRESHOLD, scores.errors.answered, scores.column("confidence")
        return precision_recall(*judged).area_over_coverage

    description = (
        "area under precision against coverage as the threshold on the confidence falls; correct is a virtual "
        f"correspondence reprojection error below {VCRE_THRESHOLD:.0%} of the diagonal"
    )
    return _of_vcre(f"vcre_auc@{VCRE_THRESHOLD:.0%}", description, value, higher_is_better=True)


def _median_vcre() -> Metric:
    description = (
        "median over all pairs of the virtual correspondence reprojection error, as a share of the image's diagonal"
    )
    return _of_vcre("median_vcre", description, lambda vcre, _: float(np.median(vcre)), higher_is_better=False)


def _recall_where(name: str, words: str, inside: Callable[[PairScores], Mask]) -> Metric:
    """The recall over some of the pairs; one for which it is not known whether it belongs to them does not."""
    metres, degrees = CORRECT

    def compute(scores: PairScores) -> float | None:
        rows = inside(scores)
        return float(np.mean(within(scores.errors, metres, degrees)[rows])) if rows.any() else None

    return Metric(
        f"recall_{name}@({metres:g}m,{degrees:g}deg)",
        "share",
        True,
        f"share of the pairs {words} with translation_error_m <= {metres:g} and rotation_error_deg <= {degrees:g}; "
        "nothing without such a pair",
        compute,
        over=lambda scores: int(np.count_nonzero(inside(scores))),
        translation_threshold_m=metres,
        rotation_threshold_deg=degrees,
    )


def _ends(low: float, high: float) -> str:
    return f"to_{high:g}" if low == -math.inf else f"over_{low:g}" if high == math.inf else f"{low:g}_to_{high:g}"


def _recall_by_overlap(low: float, high: float) -> Metric:
    def inside(scores: PairScores) -> Mask:
        overlap = scores.column("overlap")
        return (low <= overlap) & (overlap < high)

    parts = (f"overlap >= {low:g}" if low > 0 else "", f"overlap < {high:g}" if high < 1 else "")
    return _recall_where(f"overlap_{_ends(low, high)}", f"with {' and '.join(filter(None, parts))}", inside)


def _recall_by_scale(low: float, high: float) -> Metric:
    def inside(scores: PairScores) -> Mask:
        change = scores.column("scale_change")
        return (low < change) & (change <= high)

    parts = (f"change of scale > {low:g}" if low > 1 else "", f"change of scale <= {high:g}" if high < math.inf else "")
    return _recall_where(f"scale_{_ends(low, high)}", f"with {' and '.join(filter(None, parts))}", inside)


def _recall_of_tier(tier: str) -> Metric:
    return _recall_where(tier, f"of the tier {tier}", lambda scores: scores.tiers == TIERS.index(tier))


def _recall_of_look(look: str) -> Metric:
    return _recall_where(f"look_{look}", f"whose images look {look}", lambda scores: scores.looks == LOOKS.index(look))


def _of_drives(
    name: str, unit: str, higher_is_better: bool, description: str, value: Callable[[list[Drive]], float | None]
) -> Metric:
    """A metric of what is right along the drives of the queries; None where their times are not given."""
    metres, degrees = CORRECT

    def compute(scores: PairScores) -> float | None:
        return None if scores.drives is None else value(scores.drives)

    return Metric(
        f"{name}@({metres:g}m,{degrees:g}deg)",
        unit,
        higher_is_better,
        f"{description}; right is translation_error_m <= {metres:g} and rotation_error_deg <= {degrees:g}",
        compute,
        translation_threshold_m=metres,
        rotation_threshold_deg=degrees,
    )


def _longest_lost(unit: str, column: str, words: str) -> Metric:
    def value(drives: list[Drive]) -> float | None:
        longest = float(np.max(getattr(LostStretches.of(drives), column), initial=0.0))
        return None if np.isnan(longest) else longest

    description = f"the most {words} of a stretch of consecutive queries of a drive that are all wrong"
    return _of_drives(f"longest_lost_{column}", unit, False, description, value)


def _lost_queries(least: int) -> Metric:
    def value(drives: list[Drive]) -> float:
        return LostStretches.of(drives).queries_in(least) / sum(len(drive.right) for drive in drives)

    description = f"share of the queries on stretches of at least {least} consecutive wrong ones"
    return _of_drives(f"lost_for_{least}", "share", False, description, value)


def _lost_stretches(least: int) -> Metric:
    def value(drives: list[Drive]) -> float | None:
        return LostStretches.of(drives).share_of_stretches(least)

    description = f"share of the stretches of consecutive wrong queries that have at least {least}; nothing without any"
    return _of_drives(f"lost_stretches_of_{least}", "share", False, description, value)


def _run_recall(length: int) -> Metric:
    def value(drives: list[Drive]) -> float | None:
        right = right_runs(drives, length)
        return float(np.mean(right)) if right.size else None

    description = f"share of the runs of {length} consecutive queries of a drive of which more than half are right"
    return _of_drives(f"run_recall_{length}", "share", True, description, value)


def _shown(metric: Metric, *places: Place, with_interval: bool = False) -> Metric:
    return replace(metric, shown=frozenset(places), with_interval=with_interval)


METRICS: tuple[Metric, ...] = (
    _shown(_translation_auc(0.5), "set page", "first page", "paper", with_interval=True),
    _translation_auc(1),
    _shown(_rotation_auc(0.5), "set page", "first page", "paper", with_interval=True),
    _rotation_auc(1),
    _shown(_pose_auc(0.5, 4), with_interval=True),
    _shown(_recall(0.05, 0.5), "set page"),
    _shown(_recall(0.1, 1), "set page"),
    _shown(_recall(0.25, 2), "set page", "terminal", with_interval=True),
    _shown(_recall(0.5, 5), "set page", with_interval=True),
    _shown(_recall(1, 5), "set page"),
    _shown(_recall(5, 10), "set page"),
    *(_mlad_recall(metres) for metres in MLAD_THRESHOLDS_M),
    _shown(_median("translation_error_m", "m"), "set page", "first page", "paper", "terminal", with_interval=True),
    _shown(_median("rotation_error_deg", "deg"), "set page", "first page", "paper", "terminal", with_interval=True),
    _median("mlad_translation_error_m", "m"),
    _shown(
        _mean_metric(
            "coverage", "share of all pairs with an answer", lambda errors: errors.answered.astype(np.float64)
        ),
        *("set page", "first page", "paper", "terminal", "confidence"),
    ),
    *(_shown(metric, "more") for metric in (_median_vcre(), _vcre_precision(), _vcre_auc())),
    _shown(_longest_lost("count", "queries", "queries"), "more"),
    _shown(_longest_lost("s", "seconds", "seconds, to the next right query,"), "more"),
    _shown(_longest_lost("m", "metres", "metres, to the next right query,"), "more"),
    *(_shown(_lost_queries(least), "more") for least in STRETCHES),
    *(_shown(_lost_stretches(least), "more") for least in STRETCHES),
    *(_shown(_run_recall(length), "more") for length in RUNS),
    *(_shown(_recall_of_tier(tier), "more") for tier in TIERS),
    *(_shown(_recall_of_look(look), "more") for look in LOOKS),
    *(_shown(_recall_by_overlap(*ends), "more") for ends in pairwise(OVERLAPS)),
    *(_shown(_recall_by_scale(*ends), "more") for ends in pairwise(SCALE_CHANGES)),
    _confidence_area(*CORRECT),
    _shown(_risk_coverage_area(), "confidence"),
    _shown(_wrong_of_answered(), "confidence"),
    *(_shown(_coverage_at(percent), "confidence") for percent in PRECISIONS_PERCENT),
    _shown(_precision_of_confident(), "confidence"),
    _shown(_coverage_of_confident(), "confidence"),
    _shown(_seconds("median_seconds", 50, "median"), "terminal"),
    _seconds("p95_seconds", 95, "95th percentile"),
    _shown(_peak_memory(), "more"),
)
"""All metrics of a pair set, in the order in which tables show them.

An entry is all that a metric needs: CSV and JSON have a column for each, and so has each table that the entry names.
"""


def shown_in(place: Place, ranking: Metric | None = None) -> list[Metric]:
    """The metrics of a table for people, the one that ranks first where it is given."""
    shown = [metric for metric in METRICS if place in metric.shown and metric != ranking]
    return shown if ranking is None else [ranking, *shown]
