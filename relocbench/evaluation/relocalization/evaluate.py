"""Evaluating every retriever with every tracker on a dataset: retrieve, track against the best K, choose, score."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

from pydantic import Field, model_validator

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import PairKey
from relocbench.errors import ConfigError, available, cut
from relocbench.evaluation.common.blindness import check_blind
from relocbench.evaluation.common.folders import result_folders
from relocbench.evaluation.common.foreign import parse_apart
from relocbench.evaluation.common.opening import open_for_evaluation
from relocbench.evaluation.common.options import EvaluationOptions, ExecutionOptions
from relocbench.evaluation.common.results import PREDICTIONS, MethodResults
from relocbench.evaluation.common.runs import Asking, run_each
from relocbench.evaluation.relocalization.basin import Basin, Basins, given_basin, read_basins
from relocbench.evaluation.relocalization.candidates import read_tracked, track_candidates
from relocbench.evaluation.relocalization.pipeline import Retrieved, keyframe_poses
from relocbench.evaluation.relocalization.rankings import RankingSource, label_of, run_retrievers
from relocbench.evaluation.relocalization.records import (
    KEYFRAME,
    ORACLE,
    PipelineResults,
    PipelineRun,
    PipelineScores,
    PipelineSetResults,
    pipeline_results,
    write_set,
)
from relocbench.evaluation.relocalization.score import Values
from relocbench.evaluation.relocalization.tasks import PipelineTasks, pipeline_tasks
from relocbench.evaluation.relocalization.truth import MapTruth
from relocbench.evaluation.relocalization.writing import crashed_queries, write_pipeline_results
from relocbench.evaluation.retrieval.evaluate import KEEP
from relocbench.evaluation.retrieval.opening import SetOptions, open_set
from relocbench.evaluation.retrieval.records import set_results
from relocbench.evaluation.retrieval.score import unanswered
from relocbench.execution import kept_workers
from relocbench.files import check_label
from relocbench.methods import RETRIEVERS, TRACKERS, MethodKind, MethodSpec
from relocbench.methods.specs import parse_method, setting_label
from relocbench.progress import Reporter

TOP = 3


class RelocalizationOptions(EvaluationOptions, ExecutionOptions):
    """Fields are options of ``relocbench evaluate-relocalization`` and keys of its YAML file."""

    retriever: tuple[str, ...] = ()
    """the retrievers; ``methods`` are the trackers"""
    top: int = Field(TOP, ge=1, le=KEEP)
    """K, the number of keyframes that a tracker is run against"""
    radius: float | None = Field(None, gt=0, allow_inf_nan=False)
    """metres of the basin"""
    heading: float | None = Field(None, gt=0, le=180)
    """degrees of the basin"""
    probe: Path | None = None
    """results of ``relocbench probe``, from which each tracker gets its own basin"""

    @model_validator(mode="after")
    def _something_to_do(self) -> Self:
        if not self.retriever:
            raise ValueError(f"nothing to evaluate: give --retriever NAME (or {ORACLE}, which knows the truth)")
        if self.probe is not None and (self.radius is not None or self.heading is not None):
            raise ValueError(
                "--probe takes measured basins of convergence, --radius and --heading set one; give one or the other"
            )
        return self


@dataclass(frozen=True)
class RelocalizationReport:
    """The results of an evaluation of pipelines."""

    tasks: PipelineTasks
    folders: list[PipelineResults]
    results: Path
    crashed: list[tuple[str, str]] = field(default_factory=list)
    """label and message of each pipeline that crashed on queries"""
    left_out: list[tuple[str, str]] = field(default_factory=list)
    """label and message of each method that could not be made"""

    @cached_property
    def _scores(self) -> dict[str, PipelineScores]:
        return {folder.label: folder.scores() for folder in self.folders}

    def scores(self, folder: PipelineResults) -> dict[str, Values]:
        """A pipeline's scores on the evaluated tasks."""
        tasks = self._scores[folder.label].tasks
        return {name: values for name, values in tasks.items() if name in self.tasks.names}

    def basins(self, folder: PipelineResults) -> dict[str, Basin]:
        """A pipeline's basins on the evaluated tasks."""
        return {name: basin for name, basin in self._scores[folder.label].basins.items() if name in self.tasks.names}

    def counts(self) -> dict[str, int]:
        """Queries of all tasks, and how many of them each pipeline did not answer, together."""
        return {
            "tasks": len(self.tasks.record.tasks),
            "queries": sum(task.queries for task in self.tasks.record.tasks.values()),
            "pipelines": len(self.folders),
            **unanswered(v for folder in self.folders for v in self.scores(folder).values()),
        }

    def to_dict(self) -> dict[str, Any]:
        """Tasks, pipelines with their scores, and broken methods, as plain values for scripts."""
        return {
            "task": "relocalization",
            "dataset": self.tasks.record.dataset,
            "fingerprint": self.tasks.record.fingerprint,
            "results": str(self.results),
            "tasks": {name: record.model_dump() for name, record in self.tasks.record.tasks.items()},
            "pipelines": [
                {
                    "pipeline": folder.label,
                    "retriever": run.retriever,
                    "tracker": run.tracker,
                    "top": run.top,
                    "basins": {name: basin.model_dump() for name, basin in self.basins(folder).items()},
                    "tasks": self.scores(folder),
                }
                for folder in self.folders
                for run in (folder.run_record(),)
            ],
            "broken": [{"pipeline": label, "message": message} for label, message in self.crashed],
            "left_out": [{"method": label, "message": message} for label, message in self.left_out],
        }


@kept_workers()
def evaluate_pipelines(options: RelocalizationOptions, reporter: Reporter) -> RelocalizationReport:
    """Run and score every retriever with every tracker, and with the trivial baseline, the first keyframe's pose.

    Raises:
        RelocbenchError: a bad dataset, method, option or list.
    """
    # Methods are found and configured before anything is written: a typing error must not leave a folder behind.
    run = options.run.with_shared_folders(options.out, options.dataset)
    run = run.hiding(options.dataset, *result_folders(options.out))
    parse = partial(parse_apart, run=run)
    retrievers, trackers = parse_pipeline(options.retriever, options.methods, options.set, options.seed, parse)
    check_blind([*(one for one in retrievers if not isinstance(one, str)), *trackers], options.dataset)
    basins = _basins(options, trackers, reporter)
    dataset = open_for_evaluation(options.dataset, options.out)
    places = SetOptions(options.split, options.pair_sets, positives="pairs")
    tasks = pipeline_tasks(dataset, open_set(options.dataset, options.out, places, reporter), reporter)
    asking = Asking(run, reporter, options.overwrite, options.seed)
    return _evaluate(options, asking, dataset, tasks, retrievers, trackers, basins)


def _evaluate(
    options: RelocalizationOptions,
    asking: Asking,
    dataset: Dataset,
    tasks: PipelineTasks,
    retrievers: Sequence[MethodSpec | str],
    trackers: Sequence[MethodSpec],
    basins: Basins,
) -> RelocalizationReport:
    ranked, unmade = run_retrievers(tasks.asked, retrievers, set_results(options.out, tasks.asked), asking)
    results = pipeline_results(options.out, tasks.record.name, tasks.record.fingerprint)
    write_set(results, tasks.record)
    retrieved = {each.label: _retrieved(each, tasks, options.top) for each in ranked}
    wanted = {name: _pairs(tasks.truth[name], [of[name] for of in retrieved.values()]) for name in tasks.names}
    done, left_out = run_each(trackers, lambda spec: track_candidates(dataset, wanted, spec, results.trackers, asking))
    answered = [folder for _, folder in done]
    answers = {folder.label: {name: read_tracked(dataset, folder, name) for name in tasks.names} for folder in answered}
    folders = []
    for each in ranked:
        of = retrieved[each.label]
        floor = {name: keyframe_poses(tasks.truth[name], of[name]) for name in tasks.names}
        record = _record(tasks, each, KEYFRAME, 1, None)
        folders.append(write_pipeline_results(_folder(results, record), record, tasks, of, floor, basins))
        for folder in answered:
            record = _record(tasks, each, folder.label, options.top, folder)
            of_tracker = answers[folder.label]
            folders.append(write_pipeline_results(_folder(results, record), record, tasks, of, of_tracker, basins))
    messages = [each for folder in folders for each in crashed_queries(folder, tasks.names)]
    return RelocalizationReport(tasks, folders, results.root, messages, unmade + left_out)


def _basins(options: RelocalizationOptions, trackers: Sequence[MethodSpec], reporter: Reporter) -> Basins:
    measured = None if options.probe is None else read_basins(options.probe)
    basins = Basins(given_basin(options.radius, options.heading), measured)
    for spec in trackers if measured is not None else ():
        if not basins.knows(spec.label):
            reporter.note(f"{spec.label} has no basin in {options.probe}: the reach of the pairs is used instead")
    return basins


def _retrieved(ranking: RankingSource, tasks: PipelineTasks, top: int) -> dict[str, list[Retrieved]]:
    """The keyframes that a retriever found, by task."""
    return {task.name: ranking.of(task, tasks.truth[task.name], top) for task in tasks.asked.chosen}


def _pairs(truth: MapTruth, found: Sequence[Sequence[Retrieved]]) -> set[PairKey]:
    """The pairs that trackers run on: every retrieved keyframe with its query."""
    return {
        (truth.keyframe_times[keyframe], time)
        for of_retriever in found
        for time, retrieved in zip(truth.query_times, of_retriever, strict=True)
        for keyframe in retrieved.keyframes
    }


def _record(
    tasks: PipelineTasks, ranking: RankingSource, tracker: str, top: int, folder: MethodResults | None
) -> PipelineRun:
    return PipelineRun(
        retriever=ranking.label,
        tracker=tracker,
        top=top,
        dataset=tasks.record.dataset,
        fingerprint=tasks.record.fingerprint,
        retriever_run=ranking.run,
        tracker_run=None if folder is None else folder.run_record(),
    )


def _folder(results: PipelineSetResults, run: PipelineRun) -> PipelineResults:
    return results.pipeline(run.retriever, run.tracker, run.top)


def parse_pipeline(
    retrievers: Sequence[str],
    trackers: Sequence[str],
    settings: Sequence[str],
    seed: int,
    parse: Callable[[str, Sequence[str], int, MethodKind], MethodSpec] = parse_method,
) -> tuple[list[MethodSpec | str], list[MethodSpec]]:
    """Parse retrievers and trackers, in the order given.

    The oracle, and rankings made elsewhere, stay strings.

    Raises:
        MethodError: an unknown method, one of another kind, or a wrong parameter.
        ConfigError: a repeated label, the name of a trivial baseline, or a setting without the label of its method.
    """
    for setting in settings:
        if setting_label(setting) is None:
            raise ConfigError(f"--set {cut(setting)}: say for which method, as LABEL.key=value")
    of_retrievers = [_retriever(text, settings, seed, parse) for text in retrievers]
    of_trackers = [parse(text, settings, seed, TRACKERS) for text in trackers]
    labels = [*map(label_of, of_retrievers), *(spec.label for spec in of_trackers)]
    floors = [one for one in of_retrievers if one == ORACLE]
    for label in labels:
        if "+" in label:
            raise ConfigError(f"label '{label}': '+' joins the two halves of a pipeline; choose another")
        if label == KEYFRAME or (label == ORACLE and not floors):
            raise ConfigError(
                f"'{label}' is the name of a trivial baseline; give the method another label: LABEL=METHOD"
            )
        if labels.count(label) > 1:
            raise ConfigError(f"two methods are called '{label}'; give one a label of its own: LABEL=METHOD")
    for setting in settings:
        wanted = setting_label(setting)
        if wanted not in labels:
            raise ConfigError(f"--set {cut(setting)}: no method '{wanted}' in this run{available(str(wanted), labels)}")
    return of_retrievers, of_trackers


def _retriever(
    text: str,
    settings: Sequence[str],
    seed: int,
    parse: Callable[[str, Sequence[str], int, MethodKind], MethodSpec],
) -> MethodSpec | str:
    label, separator, target = text.partition("=")
    if text == ORACLE:
        return text
    if not target.startswith(PREDICTIONS) and not text.startswith(PREDICTIONS):
        return parse(text, settings, seed, RETRIEVERS)
    try:
        if not separator or text.startswith(PREDICTIONS):
            raise ValueError("rankings made elsewhere need a label")
        check_label(label, "retriever label")
    except ValueError as bad:
        raise ConfigError(f"--retriever {cut(text)}: {bad}; give one: LABEL={PREDICTIONS}PATH") from None
    return text
