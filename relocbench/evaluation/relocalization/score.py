"""The scores of a pipeline on a task: pose recall, basin recall, and the share of each kind of failure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relocbench.arrays import Array
from relocbench.errors import ConfigError, available
from relocbench.evaluation.relocalization.answers import OUTCOMES, PipelineAnswer, errors_of
from relocbench.metrics import METRICS, PairScores, mean_interval, metric_named, summarize_scores

Values = dict[str, float | int | None]
RANKING = "recall@(0.25m,2deg)"
POSE_METRICS = tuple(m.name for m in METRICS if m.per_pair is not None)
FAILURES = tuple(f"failed_{outcome}" for outcome in OUTCOMES if outcome != "right")
HIT = "hit"
"""basin recall@K: the share of queries with a keyframe in the basin among the K"""


def basin_recall(count: int) -> str:
    """The name of the metric: share of queries with a keyframe in the basin among the first ``count``."""
    return f"basin_recall@{count}"


def pipeline_metrics(top: int) -> tuple[str, ...]:
    """The names of all metrics of a pipeline that are means over queries."""
    shares = (HIT, "right_and_hit", "right_without_hit", "right_among_K", *FAILURES)
    return (*POSE_METRICS, *(basin_recall(k) for k in range(1, top + 1)), *shares)


def per_query(answers: Sequence[PipelineAnswer], metric: str) -> Array:
    """(Q,) values whose mean is the metric. Raises ConfigError for an unknown metric."""
    if metric in POSE_METRICS:
        compute = metric_named(metric).per_pair
        assert compute is not None
        return compute(errors_of(answers))
    hit = np.array([a.hit_rank is not None for a in answers])
    right = np.array([a.outcome == "right" for a in answers])
    shares = {
        HIT: hit,
        "right_and_hit": right & hit,
        "right_without_hit": right & ~hit,
        "right_among_K": np.array([a.right_rank is not None for a in answers]),
        **{name: np.array([f"failed_{a.outcome}" == name for a in answers]) for name in FAILURES},
    }
    if metric.startswith("basin_recall@"):
        count = int(metric.partition("@")[2])
        shares[metric] = np.array([a.hit_rank is not None and a.hit_rank <= count for a in answers])
    if metric not in shares:
        known = (*POSE_METRICS, *shares, basin_recall(1))
        raise ConfigError(f"pipelines have no metric '{metric}'{available(metric, known)}")
    out: Array = shares[metric].astype(np.float64)
    return out


def pose_errors_of(answers: Sequence[PipelineAnswer]) -> Array:
    """(2, N) the translation and rotation errors: by them, intervals know how alike neighbouring queries are."""
    errors = errors_of(answers)
    return np.stack([errors.translation_error_m, errors.rotation_error_deg])


def summary(answers: Sequence[PipelineAnswer], top: int) -> Values:
    """Counts, means over all queries, and their intervals from blocks along the drive.

    Args:
        answers: of one task, one for each query, in the order of the drive.
        top: number of candidates that the tracker was given.
    """
    seconds = np.array([np.nan if a.seconds is None else a.seconds for a in answers])
    confidence = np.array([np.nan if a.confidence is None else a.confidence for a in answers])
    times = np.array([a.query_timestamp_ns for a in answers], dtype=np.int64)
    whole = summarize_scores(PairScores(errors_of(answers), seconds, confidence, query_ns=times)).to_dict()
    statuses = [a.status for a in answers]
    values: Values = {
        "queries": len(answers),
        "failed": statuses.count("failed"),
        "broke": statuses.count("error"),
        **{name: whole[name] for name in whole if name not in ("pairs", "answered")},
    }
    for metric in pipeline_metrics(top):
        each = per_query(answers, metric)
        interval = mean_interval([each], [pose_errors_of(answers)])
        values[metric] = float(np.mean(each))
        values[f"{metric}_low"] = None if interval is None else interval.low
        values[f"{metric}_high"] = None if interval is None else interval.high
    hit, both = values[HIT], values["right_and_hit"]
    assert hit is not None
    assert both is not None
    values["right_given_hit"] = both / hit if hit else None
    return values
