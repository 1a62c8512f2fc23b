"""Comparing pipelines of a retriever and a tracker: on each task, by conditions, and with shared ranks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relocbench.errors import ConfigError, PredictionError, available
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.relocalization.answers import PipelineAnswer, errors_of, read_pipeline
from relocbench.evaluation.relocalization.records import (
    ORACLE,
    SET_FILE,
    PipelineBasin,
    PipelineResults,
    PipelineRun,
    PipelineSet,
    PipelineSetResults,
    PipelineTask,
    all_pipeline_sets,
)
from relocbench.evaluation.relocalization.rescoring import AGAIN, PipelineTruth
from relocbench.evaluation.relocalization.score import (
    FAILURES,
    HIT,
    POSE_METRICS,
    RANKING,
    basin_recall,
    per_query,
    pose_errors_of,
)
from relocbench.files import sha256_file
from relocbench.leaderboard.common.untrusted_results import check_file_names, check_folder, check_same_queries
from relocbench.leaderboard.retrieval.board import holds_tracking
from relocbench.metrics import Interval, generator, mean_interval, rank_with_ties

Array = NDArray[np.float64]
SHARES = (basin_recall(1), HIT, "right_and_hit", "right_without_hit", "right_among_K", *FAILURES)
WITH_INTERVAL = (RANKING, "recall@(1m,5deg)", HIT)


@dataclass(frozen=True, eq=False)
class Pipeline:
    """The results of one pipeline on one set."""

    label: str
    run: PipelineRun
    basins: Mapping[str, PipelineBasin]
    answers: Mapping[str, Sequence[PipelineAnswer]]
    """by task; tasks without results are absent"""
    rescored: frozenset[str] = frozenset()
    """the tasks whose rows were computed anew from rankings, trackers' answers and truth"""

    @property
    def knows_truth(self) -> bool:
        return self.run.retriever == ORACLE

    @property
    def uses_times(self) -> bool:
        """Whether the tracker was shown times."""
        return self.run.tracker_run is not None and self.run.tracker_run.uses_times

    @property
    def is_ranked(self) -> bool:
        """Whether the pipeline is ranked: one that knows the truth or sees times is not."""
        return not (self.knows_truth or self.uses_times)


@dataclass(frozen=True, eq=False)
class PipelineRow:
    """A row for one pipeline; it has no values if the pipeline misses a task."""

    pipeline: Pipeline
    values: Mapping[str, float | None]
    """means over the tasks of means over queries; medians are over all queries together"""
    intervals: Mapping[str, Interval | None]
    rank: int | None
    """None if a task is missing, and for a pipeline that uses the truth or times"""
    failed: int | None = None
    broke: int | None = None
    missing: tuple[str, ...] = ()
    rescored: bool = False
    """whether all tasks were scored again"""


@dataclass(frozen=True, eq=False)
class PipelineTable:
    """A row for each pipeline, on one task or for the mean over several tasks."""

    name: str
    tasks: tuple[str, ...]
    records: tuple[PipelineTask, ...]
    rows: tuple[PipelineRow, ...]
    """best first; pipelines without a value come last"""

    @property
    def queries(self) -> int:
        return sum(r.queries for r in self.records)


@dataclass(frozen=True, eq=False)
class PipelineSetBoard:
    """All tables of one dataset."""

    record: PipelineSet
    pipelines: tuple[Pipeline, ...]
    tables: tuple[PipelineTable, ...]
    folder: PipelineSetResults | None = None
    truth: PipelineTruth | None = None
    """None where the dataset is not available"""

    @property
    def title(self) -> str:
        return f"{self.record.dataset}@{self.record.dataset_fingerprint[:12]}"


@dataclass(frozen=True, eq=False)
class PipelineBoard:
    """Everything that a leaderboard of pipelines shows."""

    sets: tuple[PipelineSetBoard, ...]
    metric: str
    seed: int
    split: str | None = None


def load_pipelines(
    results: Path,
    *,
    metric: str = RANKING,
    split: str | None = None,
    seed: int = 0,
    datasets: DatasetLookup | None = None,
) -> PipelineBoard | None:
    """Load the results of all pipelines in a results folder; None where there is nothing of theirs to show.

    Args:
        metric: the metric that ranks pipelines, a mean over queries.
        split: only the tasks of this split; sets without such a split are left out.
        seed: of the draws that decide ranks.
        datasets: with their truth; without them, those in folders beside ``RESULTS``. Where the dataset of a set is
            among them, all rows are computed anew.

    Raises:
        PredictionError: with file and line: a bad file, scores that are missing or stale, or rows that do not follow
            from rankings, answers and truth.
        ConfigError: a metric that pipelines do not have, or a split that no set has.
        DatasetError: a dataset that was named is damaged.
    """
    if metric not in (*POSE_METRICS, *SHARES):
        raise ConfigError(f"pipelines cannot be ranked by '{metric}'; expected one of {', '.join(POSE_METRICS)}")
    there = all_pipeline_sets(results)
    if there:
        check_folder(results)
    for folder in there:
        check_file_names(folder.record.tasks, "the task", folder.root / SET_FILE)
    chosen = [s for s in there if split is None or split in s.record.splits]
    if there and not chosen and not holds_tracking(results):
        known = sorted({name for s in there for name in s.record.splits})
        raise ConfigError(f"no split '{split}'{available(str(split), known)}", results)
    lookup = datasets or DatasetLookup(results)
    named = {(each.record.dataset, each.record.dataset_fingerprint) for each in there}
    lookup.mark_used(lambda one: (one.name, one.fingerprint) in named)
    boards = [board for s in chosen if (board := _set(s, metric, split, seed, lookup)) is not None]
    return PipelineBoard(tuple(boards), metric, seed, split) if boards else None


def _set(
    folder: PipelineSetResults, metric: str, split: str | None, seed: int, lookup: DatasetLookup
) -> PipelineSetBoard | None:
    record = folder.record
    whose = record.dataset, record.dataset_fingerprint
    dataset = lookup.find(lambda one: (one.name, one.fingerprint) == whose)
    truth = None if dataset is None else PipelineTruth(dataset, folder)
    tasks = {n: r for n, r in record.tasks.items() if split is None or n in record.splits[split]}
    pipelines = tuple(load_pipeline(each, record, tasks, truth) for each in folder.pipelines())
    used = {n: r for n, r in tasks.items() if any(n in pipeline.answers for pipeline in pipelines)}
    if not used:
        return None
    tables_of_tasks = (
        (task, c.label, [a.query_timestamp_ns for a in answers], PipelineResults(folder.root / c.label).answers(task))
        for c in pipelines
        for task, answers in c.answers.items()
    )
    check_same_queries(tables_of_tasks, "queries")
    plans = {**_means(used), **{name: (name,) for name in used}}
    tables = tuple(_table(record, name, of, pipelines, metric, seed) for name, of in plans.items())
    return PipelineSetBoard(record, pipelines, tables, folder, truth)


def _means(tasks: Mapping[str, PipelineTask]) -> dict[str, tuple[str, ...]]:
    """The tables of means: over all tasks, across conditions, within conditions, and for each pair of conditions."""
    out = {"mean over all tasks": list(tasks), "mean across conditions": [], "mean within a condition": []}
    for name, record in tasks.items():
        same = record.condition_gallery == record.condition_query
        out["mean within a condition" if same else "mean across conditions"].append(name)
        out.setdefault(f"conditions {record.condition_gallery} → {record.condition_query}", []).append(name)
    kept = {name: tuple(of) for name, of in out.items() if len(of) > 1}
    whole = kept.get("mean over all tasks")
    return {name: of for name, of in kept.items() if name == "mean over all tasks" or of != whole}


def load_pipeline(
    folder: PipelineResults, asked: PipelineSet, tasks: Mapping[str, PipelineTask], truth: PipelineTruth | None
) -> Pipeline:
    """Read the results of one pipeline. Raises PredictionError unless they are whole, scored and follow from files."""
    run = folder.run_record()
    if run.fingerprint != asked.fingerprint:
        raise PredictionError(
            f"was made for {run.dataset}, set {run.fingerprint[:12]}, but lies among the results of "
            f"{asked.name}@{asked.fingerprint[:12]}",
            folder.run_yaml,
        )
    answers: dict[str, Sequence[PipelineAnswer]] = {}
    rescored: set[str] = set()
    scores = folder.scores() if folder.scores_yaml.exists() else None
    if scores is not None and scores.run != sha256_file(folder.run_yaml):
        raise PredictionError(f"is not the record that was scored; {AGAIN}", folder.run_yaml)
    for name, record in tasks.items():
        path = folder.answers(name)
        if not path.exists():
            continue
        if scores is None or name not in scores.answers or name not in scores.basins:
            raise PredictionError(f"is not scored; {AGAIN}", path)
        if scores.answers[name] != sha256_file(path):
            raise PredictionError(f"changed since it was scored; {AGAIN}", path)
        answers[name] = read_pipeline(path)
        if len(answers[name]) != record.queries:
            raise PredictionError(f"{len(answers[name])} rows, expected one for each of {record.queries} queries", path)
        if truth is not None and truth.rescored(run, name, scores.basins[name], answers[name], path):
            rescored.add(name)
    return Pipeline(folder.label, run, scores.basins if scores else {}, answers, frozenset(rescored))


def _table(
    record: PipelineSet, name: str, tasks: tuple[str, ...], pipelines: Sequence[Pipeline], metric: str, seed: int
) -> PipelineTable:
    place = f"{record.fingerprint} {name}"
    ranked = {
        c.label: [per_query(c.answers[t], metric) if t in c.answers else None for t in tasks]
        for c in pipelines
        if c.is_ranked
    }
    better = not metric.startswith("failed_")
    errors = {
        c.label: [pose_errors_of(c.answers[t]) if t in c.answers else None for t in tasks]
        for c in pipelines
        if not c.knows_truth
    }
    ranks = rank_with_ties(ranked, generator(seed, place, metric), errors, higher_is_better=better) if ranked else {}
    rows = [_row(pipeline, tasks, metric, ranks.get(pipeline.label)) for pipeline in pipelines]
    sign = -1 if better else 1
    rows.sort(key=lambda r: (r.values[metric] is None, sign * (r.values[metric] or 0.0), r.pipeline.label))
    return PipelineTable(name, tasks, tuple(record.tasks[t] for t in tasks), tuple(rows))


def _row(pipeline: Pipeline, tasks: tuple[str, ...], metric: str, rank: int | None) -> PipelineRow:
    missing = tuple(task for task in tasks if task not in pipeline.answers)
    if missing:
        return PipelineRow(pipeline, dict.fromkeys((*POSE_METRICS, *SHARES)), {}, None, missing=missing)
    given = [a for task in tasks for a in pipeline.answers[task]]
    means: dict[str, list[Array]] = {
        m: [per_query(pipeline.answers[task], m) for task in tasks] for m in (*POSE_METRICS, *SHARES)
    }
    values: dict[str, float | None] = {m: float(np.mean([np.mean(v) for v in sets])) for m, sets in means.items()}
    hit, both = values[HIT], values["right_and_hit"]
    values["right_given_hit"] = both / hit if hit and both is not None else None
    errors = errors_of(given)
    values["median_translation_error_m"] = float(np.median(errors.translation_error_m))
    values["median_rotation_error_deg"] = float(np.median(errors.rotation_error_deg))
    seconds = [a.seconds for a in given if a.seconds is not None]
    values["median_seconds"] = float(np.median(seconds)) if seconds else None
    of_tasks = [pose_errors_of(pipeline.answers[task]) for task in tasks]
    intervals = {m: mean_interval(means[m], of_tasks) for m in dict.fromkeys((*WITH_INTERVAL, metric))}
    statuses = [a.status for a in given]
    return PipelineRow(
        pipeline,
        values,
        intervals,
        rank,
        statuses.count("failed"),
        statuses.count("error"),
        rescored=pipeline.rescored.issuperset(tasks),
    )
