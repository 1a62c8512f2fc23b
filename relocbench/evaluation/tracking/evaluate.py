"""Both phases of an evaluation of trackers: run what is missing, then score all answers."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from pydantic import model_validator

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.errors import ConfigError, MethodError
from relocbench.evaluation.common.folders import result_folders
from relocbench.evaluation.common.foreign import blind_methods
from relocbench.evaluation.common.opening import open_for_evaluation
from relocbench.evaluation.common.options import AnswerOptions, ExecutionOptions
from relocbench.evaluation.common.predictions import predictions_label
from relocbench.evaluation.common.results import (
    MethodResults,
    dataset_results,
    first_crash,
    write_dataset_record,
)
from relocbench.evaluation.common.runs import Asking, run_each
from relocbench.evaluation.isolation.capabilities import capabilities_of
from relocbench.evaluation.tables.answers import read_answers
from relocbench.evaluation.tables.matching import MATCHING
from relocbench.evaluation.tracking.external import import_predictions
from relocbench.evaluation.tracking.matching import match_method
from relocbench.evaluation.tracking.run import run_method
from relocbench.evaluation.tracking.score import score_method
from relocbench.evaluation.tracking.trivial import CLOCK, is_identity, run_clock, run_identity
from relocbench.execution import Run, kept_workers
from relocbench.methods import MethodSpec
from relocbench.progress import Reporter


class EvaluateOptions(AnswerOptions, ExecutionOptions):
    """Fields are options of ``relocbench evaluate`` and keys of its YAML file."""

    matching: bool = False
    """whether to measure matching quality, of methods that have ``match`` and on pair sets with correspondences"""
    one_core: bool = False
    """whether to run one pair at a time on a single core, so that seconds compare between methods and machines"""

    @property
    def run(self) -> Run:
        return replace(super().run, workers=1, one_core=True) if self.one_core else super().run

    @model_validator(mode="after")
    def _one_core_is_one_process(self) -> Self:
        elsewhere = self.scheduler is not None or self.predictions is not None
        if self.one_core and (elsewhere or self.workers not in (None, 1)):
            raise ValueError(
                "--one-core runs methods in one process at a time here: leave out --workers, --scheduler, --predictions"
            )
        if self.one_core and not hasattr(os, "sched_setaffinity"):
            raise ValueError("--one-core: this system binds no process to a core (Linux does)")
        return self

    @model_validator(mode="after")
    def _has_methods_to_match(self) -> Self:
        if self.predictions is not None and self.matching:
            raise ValueError("--matching runs a method, and --predictions come without one")
        return self


@dataclass(frozen=True)
class Report:
    """The results of an evaluation of trackers."""

    dataset: Dataset
    pair_sets: list[PairSet]
    folders: list[MethodResults]
    results: Path
    crashed: list[tuple[str, str]]
    """label and message of each method that crashed on pairs, rather than reporting failures"""
    matching: bool = False
    """whether matching quality was asked for"""
    left_out: list[tuple[str, str]] = field(default_factory=list)
    """label and message of each method that could not be made"""

    def counts(self) -> dict[str, int]:
        """Answers of all methods to all evaluated pairs, by their status; predictions made elsewhere may have none."""
        tables = [folder.answers(pair_set.name) for folder in self.folders for pair_set in self.pair_sets]
        statuses = Counter(answer.status for path in tables if path.exists() for answer in read_answers(path).values())
        return {
            "pair_sets": len(self.pair_sets),
            "pairs": sum(len(s.evaluated) for s in self.pair_sets),
            "rejected": sum(len(s.rejected) for s in self.pair_sets),
            "methods": len(self.folders),
            "answered": statuses["ok"],
            "failed": statuses["failed"],
            "broke": statuses["error"],
        }

    def to_dict(self) -> dict[str, Any]:
        """Scores and broken methods, as plain values for scripts."""
        scored = {folder.label: folder.score_record() for folder in self.folders}
        return {
            "dataset": self.dataset.name,
            "fingerprint": self.dataset.fingerprint,
            "results": str(self.results),
            "rejected_pairs": {s.name: len(s.rejected) for s in self.pair_sets},
            "methods": {label: scores.pair_sets for label, scores in scored.items()},
            "elsewhere": {label: scores.elsewhere for label, scores in scored.items() if scores.elsewhere},
            "matching": {label: scores.matching for label, scores in scored.items() if scores.matching},
            "broken": [{"method": label, "message": message} for label, message in self.crashed],
            "left_out": [{"method": label, "message": message} for label, message in self.left_out],
        }


@kept_workers()
def evaluate_methods(options: EvaluateOptions, reporter: Reporter) -> Report:
    """Run the trackers and score their answers.

    Raises:
        RelocbenchError: a bad dataset, method, option or prediction.
    """
    dataset = open_for_evaluation(options.dataset, options.out)
    pair_sets = _chosen(dataset, options)
    # Methods are found and configured before anything is written: a typing error must not leave a folder behind.
    named = [name for name in options.methods if name != CLOCK]
    run = options.run.with_shared_folders(options.out, options.dataset)
    run = run.hiding(dataset.root, *result_folders(options.out))
    specs = [] if options.predictions else blind_methods(dataset.root, named, options.set, options.seed, run)
    pictured = _check_images(dataset, pair_sets, specs)
    results = dataset_results(options.out, dataset)
    asking = Asking(run, reporter, options.overwrite, options.seed)
    left_out: list[tuple[str, str]] = []
    if options.predictions is not None:
        label = predictions_label(options.predictions, options.methods)
        folders = [import_predictions(dataset, pair_sets, options.predictions, label, results)]
        write_dataset_record(results, dataset)
    else:
        write_dataset_record(results, dataset)
        if pictured:
            done, left_out = run_each(specs, lambda spec: run_method(dataset, pair_sets, spec, results, asking))
        else:
            done = [(spec, run_identity(dataset, pair_sets, spec, results)) for spec in specs]
        if options.matching and pictured:
            _match(dataset, pair_sets, done, asking)
        folders = [folder for _, folder in done]
        if CLOCK in options.methods:
            folders.append(run_clock(dataset, pair_sets, results))
    for folder in folders:
        score_method(dataset, pair_sets, folder)
    crashed = [crash for folder in folders for crash in _crashes(folder, pair_sets)]
    return Report(dataset, pair_sets, folders, results.root, crashed, options.matching, left_out)


def _check_images(dataset: Dataset, pair_sets: list[PairSet], specs: list[MethodSpec]) -> bool:
    """Whether there are images of all pairs. Raises DatasetError where there are not, for trackers that need them."""
    if any(not is_identity(spec) for spec in specs):
        dataset.require_images(
            pair_sets,
            "no tracker can run except the baselines identity and clock; score predictions with --predictions",
        )
    return all(dataset.has_images(pair_set) for pair_set in pair_sets)


def _match(
    dataset: Dataset, pair_sets: list[PairSet], done: list[tuple[MethodSpec, MethodResults]], asking: Asking
) -> None:
    """Measure matching quality of the methods that offer it; whatever is left out is reported."""
    reporter = asking.reporter
    for name in (s.name for s in pair_sets if not dataset.layout.correspondence_file(s.name).exists()):
        reporter.note(f"{name} has no correspondences: no matching quality (build-dataset --correspondences N)")
    unable = []
    for spec, folder in done:
        try:
            if capabilities_of(spec, asking.run).match:
                match_method(dataset, pair_sets, spec, folder, asking)
            else:
                unable.append(spec.label)
        except MethodError as bad:  # it was made before, and its answers stand
            reporter.note(f"matching quality of {spec.label} is not measured: {bad}")
    if unable:
        reporter.note(f"matching quality is not measured without match(): {', '.join(unable)}")


def _chosen(dataset: Dataset, options: EvaluateOptions) -> list[PairSet]:
    chosen = dataset.pair_sets(options.split)
    if options.pair_sets:
        wanted = [dataset.pair_set(name).name for name in options.pair_sets]
        chosen = [s for s in chosen if s.name in wanted]
    if not chosen:
        raise ConfigError("no pair set is left to evaluate", dataset.root)
    return chosen


def _crashes(folder: MethodResults, pair_sets: list[PairSet]) -> list[tuple[str, str]]:
    answers = [
        answer
        for pair_set in pair_sets
        if folder.answers(pair_set.name).exists()
        for answer in read_answers(folder.answers(pair_set.name)).values()
    ]
    crashed = [(_pair_text(a.key), a.message) for a in answers if a.status == "error"]
    tables = [path for s in pair_sets if (path := folder.matching(s.name)).exists()]
    unmatched = {_pair_text(row.key): row.message for path in tables for row in MATCHING.read(path) if row.message}
    return [
        *first_crash(folder.label, f"crashed on {len(crashed)} of {len(answers)} pairs, counted as failures", crashed),
        *first_crash(
            folder.label, f"match crashed on {len(unmatched)} pairs, counted as not found", list(unmatched.items())
        ),
    ]


def _pair_text(key: PairKey) -> str:
    return f"{key[0]} {key[1]}"
