"""The registry of pair-set metrics: stable name, unit, direction, formula and thresholds of each."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.errors import ConfigError
from relocbench.metrics.pose.confidence import CONFIDENT, is_confident, precision_recall, risk_coverage_area
from relocbench.metrics.pose.curves import area_shares
from relocbench.metrics.pose.kinds import (
    WITHIN_CORRECT,
    mean_over_pairs,
    of_confidence,
    of_correct,
    of_drives,
    of_vcre,
    recall_where,
)
from relocbench.metrics.pose.metric import Metric, Place
from relocbench.metrics.pose.scores import PairScores, within
from relocbench.metrics.pose.sequences import Drive, LostStretches, right_runs
from relocbench.metrics.pose.tiers import LOOKS, TIERS

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


def _recall(metres: float, degrees: float) -> Metric:
    return mean_over_pairs(
        f"recall@({metres:g}m,{degrees:g}deg)",
        f"share of all pairs with translation_error_m <= {metres:g} and rotation_error_deg <= {degrees:g}",
        lambda errors: within(errors, metres, degrees).astype(np.float64),
        metres,
        degrees,
    )


def _mlad_recall(metres: float) -> Metric:
    return mean_over_pairs(
        f"mlad_recall@{metres:g}m",
        f"share of all pairs with mlad_translation_error_m <= {metres:g}",
        lambda errors: (errors.mlad_translation_error_m <= metres).astype(np.float64),
        metres,
    )


def _translation_auc(metres: float) -> Metric:
    return mean_over_pairs(
        f"t_auc@{metres:g}m",
        f"area under the cumulative curve of translation_error_m: 1/N sum max(0, 1 - e / {metres:g} m)",
        lambda errors: area_shares(errors.translation_error_m, metres),
        metres,
    )


def _rotation_auc(degrees: float) -> Metric:
    return mean_over_pairs(
        f"r_auc@{degrees:g}deg",
        f"area under the cumulative curve of rotation_error_deg: 1/N sum max(0, 1 - e / {degrees:g} deg)",
        lambda errors: area_shares(errors.rotation_error_deg, degrees),
        degrees=degrees,
    )


def _pose_auc(metres: float, degrees: float) -> Metric:
    return mean_over_pairs(
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


def _confidence_area() -> Metric:
    def compute(scores: PairScores) -> float | None:
        answered = scores.errors.answered
        if scores.confidence is None or not np.any(answered & ~np.isnan(scores.confidence)):
            return None
        return precision_recall(scores.correct, answered, scores.confidence).area

    description = (
        f"area under precision against recall as the threshold on the confidence falls; correct is {WITHIN_CORRECT}; "
        "recall is over all pairs"
    )
    return of_correct("confidence_auc_pr", "share", True, description, compute)


def _wrong_of_answered() -> Metric:
    def value(correct: Mask, answered: Mask, confidence: Array) -> float | None:
        return float(1.0 - np.mean(correct[answered])) if np.any(answered) else None

    description = "share of the answers that are not correct; nothing where there is no answer"
    return of_confidence("wrong_of_answered", False, description, value)


def _risk_coverage_area() -> Metric:
    description = (
        "area under the risk-coverage curve, 1/N sum over k of the share of wrong ones among the k most confident "
        "pairs; pairs without an answer come last and are wrong"
    )
    return of_confidence("aurc", False, description, risk_coverage_area)


def _coverage_at(percent: int) -> Metric:
    def value(correct: Mask, answered: Mask, confidence: Array) -> float:
        return precision_recall(correct, answered, confidence).coverage_at(percent / 100)

    description = (
        f"largest share of all pairs that a threshold on the confidence keeps with at least {percent} % of them "
        "correct; 0 where there is no such threshold"
    )
    return of_confidence(f"coverage_at_precision_{percent}", True, description, value)


def _precision_of_confident() -> Metric:
    def value(correct: Mask, answered: Mask, confidence: Array) -> float | None:
        confident = answered & is_confident(confidence)
        return float(np.mean(correct[confident])) if np.any(confident) else None

    description = (
        f"share of correct ones among the answers with a confidence of {CONFIDENT:g} or more, which means "
        "something where confidences are probabilities; nothing where there is no such answer"
    )
    return of_confidence(f"precision_at_confidence_{100 * CONFIDENT:g}", True, description, value)


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


def _vcre_precision() -> Metric:
    return of_vcre(
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
    return of_vcre(f"vcre_auc@{VCRE_THRESHOLD:.0%}", description, value, higher_is_better=True)


def _median_vcre() -> Metric:
    description = (
        "median over all pairs of the virtual correspondence reprojection error, as a share of the image's diagonal"
    )
    return of_vcre("median_vcre", description, lambda vcre, _: float(np.median(vcre)), higher_is_better=False)


def _ends(low: float, high: float) -> str:
    return f"to_{high:g}" if low == -math.inf else f"over_{low:g}" if high == math.inf else f"{low:g}_to_{high:g}"


def _recall_between(name: str, words: str, column: str, low: float, high: float, *, includes_low: bool) -> Metric:
    """The recall over the pairs with a value in a range, which includes one of its ends."""

    def inside(scores: PairScores) -> Mask:
        x = scores.column(column)
        return (low <= x) & (x < high) if includes_low else (low < x) & (x <= high)

    signs = (">=", "<") if includes_low else (">", "<=")
    ends = [f"{words} {sign} {end:g}" for sign, end in zip(signs, (low, high), strict=True) if math.isfinite(end)]
    return recall_where(f"{name}_{_ends(low, high)}", f"with {' and '.join(ends)}", inside)


def _recall_of_tier(tier: str) -> Metric:
    return recall_where(tier, f"of the tier {tier}", lambda scores: scores.tiers == TIERS.index(tier))


def _recall_of_look(look: str) -> Metric:
    return recall_where(f"look_{look}", f"whose images look {look}", lambda scores: scores.looks == LOOKS.index(look))


def _longest_lost(unit: str, column: str, words: str) -> Metric:
    def value(drives: list[Drive]) -> float | None:
        longest = float(np.max(getattr(LostStretches.of(drives), column), initial=0.0))
        return None if np.isnan(longest) else longest

    description = f"the most {words} of a stretch of consecutive queries of a drive that are all wrong"
    return of_drives(f"longest_lost_{column}", unit, False, description, value)


def _lost_queries(least: int) -> Metric:
    def value(drives: list[Drive]) -> float:
        return LostStretches.of(drives).queries_in(least) / sum(len(drive.right) for drive in drives)

    description = f"share of the queries on stretches of at least {least} consecutive wrong ones"
    return of_drives(f"lost_for_{least}", "share", False, description, value)


def _lost_stretches(least: int) -> Metric:
    description = f"share of the stretches of consecutive wrong queries that have at least {least}; nothing without any"
    return of_drives(
        f"lost_stretches_of_{least}",
        "share",
        False,
        description,
        lambda drives: LostStretches.of(drives).share_of_stretches(least),
    )


def _run_recall(length: int) -> Metric:
    def value(drives: list[Drive]) -> float | None:
        right = right_runs(drives, length)
        return float(np.mean(right)) if right.size else None

    description = f"share of the runs of {length} consecutive queries of a drive of which more than half are right"
    return of_drives(f"run_recall_{length}", "share", True, description, value)


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
        mean_over_pairs(
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
    *(
        _shown(_recall_between("overlap", "overlap", "overlap", *ends, includes_low=True), "more")
        for ends in pairwise(OVERLAPS)
    ),
    *(
        _shown(_recall_between("scale", "change of scale", "scale_change", *ends, includes_low=False), "more")
        for ends in pairwise(SCALE_CHANGES)
    ),
    _confidence_area(),
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
