"""Both phases of an evaluation of retrievers: run what is missing, then score all answers."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from pydantic import Field, model_validator

from relocbench.datasets.pairs.street_places import Positives
from relocbench.evaluation.common.folders import result_folders
from relocbench.evaluation.common.foreign import blind_methods
from relocbench.evaluation.common.options import AnswerOptions, LimitOptions
from relocbench.evaluation.common.predictions import predictions_label
from relocbench.evaluation.common.results import first_crash
from relocbench.evaluation.common.runs import Asking, run_each
from relocbench.evaluation.retrieval.answers import ANSWERS
from relocbench.evaluation.retrieval.external import import_rankings
from relocbench.evaluation.retrieval.opening import OpenedSet, SetOptions, open_set
from relocbench.evaluation.retrieval.records import RetrieverResults, SetRecord, set_results, write_set_record
from relocbench.evaluation.retrieval.run import BROKEN, run_retriever
from relocbench.evaluation.retrieval.score import Values, score_retriever, suspicion, unanswered
from relocbench.execution import Run, kept_workers
from relocbench.methods import RETRIEVERS
from relocbench.progress import Reporter

KEEP = 100


class RetrievalOptions(AnswerOptions, LimitOptions):
    """Fields are options of ``relocbench evaluate-retrieval`` and keys of its YAML file."""

    keep: int = Field(KEEP, ge=1)
    radius: float | None = Field(None, gt=0, allow_inf_nan=False)
    """metres within which a keyframe is right"""
    heading: float | None = Field(None, gt=0, le=180)
    """degrees within which a keyframe is right"""
    positives: Positives | None = None
    by_condition: bool = False
    workers: int | None = Field(None, ge=0)
    """None: a worker process for the method; 0: this process, without limits"""

    @property
    def run(self) -> Run:
        return Run(1 if self.workers is None else self.workers, None, self.limits, self.sandbox)

    @model_validator(mode="after")
    def _one_process(self) -> Self:
        if self.workers:
            raise ValueError("--workers can only be 0, this process: a retriever runs in one worker process")
        return self


@dataclass(frozen=True)
class RetrievalReport:
    """The results of an evaluation of retrievers."""

    asked: OpenedSet
    record: SetRecord
    folders: list[RetrieverResults]
    results: Path
    crashed: list[tuple[str, str]]
    """label and message of each retriever that crashed on queries"""
    suspicions: list[tuple[str, str]]
    """label and advice for each retriever whose R@1 is no better than chance"""
    left_out: list[tuple[str, str]] = field(default_factory=list)
    """label and message of each retriever that could not be made"""

    def scores(self, folder: RetrieverResults) -> dict[str, Values]:
        """A retriever's scores on the evaluated tasks; none of answers to a blind export."""
        if self.record.is_withheld:
            return {}
        names = [task.name for task in self.asked.chosen]
        return {name: values for name, values in folder.retrieval_scores().tasks.items() if name in names}

    def counts(self) -> dict[str, int]:
        """Queries of all tasks, and how many of them each retriever did not answer, together."""
        values = [v for folder in self.folders for v in self.scores(folder).values()]
        return {
            "tasks": len(self.asked.chosen),
            "queries": sum(self.record.tasks[task.name].queries for task in self.asked.chosen),
            "methods": len(self.folders),
            **unanswered(values),
            "suspicious": len(self.suspicions),
        }

    def to_dict(self) -> dict[str, Any]:
        """Scores, chance levels and broken methods, as plain values for scripts."""
        return {
            "task": "retrieval",
            "dataset": self.asked.name,
            "fingerprint": self.asked.fingerprint,
            "results": str(self.results),
            "chance": {task.name: self.record.tasks[task.name].chance for task in self.asked.chosen},
            "methods": {folder.label: self.scores(folder) for folder in self.folders},
            "broken": [{"method": label, "message": message} for label, message in self.crashed],
            "left_out": [{"method": label, "message": message} for label, message in self.left_out],
            "suspicious": [{"method": label, "message": message} for label, message in self.suspicions],
        }


@kept_workers()
def evaluate_retrievers(options: RetrievalOptions, reporter: Reporter) -> RetrievalReport:
    """Run the retrievers and score their answers.

    Raises:
        RelocbenchError: a bad dataset, method, option or prediction.
    """
    # Methods are found and configured before anything is written: a typing error must not leave a folder behind.
    named = [] if options.predictions else options.methods
    run = options.run.hiding(options.dataset, *result_folders(options.out))
    specs = blind_methods(options.dataset, named, options.set, options.seed, run, RETRIEVERS)
    opened = open_set(options.dataset, options.out, _set_options(options), reporter)
    results = set_results(options.out, opened)
    left_out: list[tuple[str, str]] = []
    if options.predictions is not None:
        label = predictions_label(options.predictions, options.methods)
        folders = [import_rankings(opened, opened.chosen, options.predictions, label, results)]
        write_set_record(results, opened, opened.chosen)
    else:
        asking = Asking(run, reporter, options.overwrite, options.seed)
        done, left_out = run_each(
            specs, lambda spec: run_retriever(opened, opened.chosen, spec, results, options.keep, asking)
        )
        folders = [folder for _, folder in done]
        write_set_record(results, opened, opened.chosen)
    record = results.record
    names = [task.name for task in opened.chosen]
    crashed = [b for folder in folders for b in _crashes(folder, names)]
    if record.is_withheld:
        reporter.note(f"{opened.name} is a blind export: answers are kept, and scored by who has the truth")
        return RetrievalReport(opened, record, folders, results.root, crashed, [], left_out)
    for folder in folders:
        score_retriever(record, folder)
    return RetrievalReport(
        opened, record, folders, results.root, crashed, _suspicions(record, folders, names), left_out
    )


def _set_options(options: RetrievalOptions) -> SetOptions:
    return SetOptions(
        options.split, options.pair_sets, options.radius, options.heading, options.positives, options.by_condition
    )


def _crashes(folder: RetrieverResults, names: list[str]) -> list[tuple[str, str]]:
    answers = [a for name in names if folder.complete(name) for a in ANSWERS.read(folder.answers(name))]
    crashed = [(a.query, a.message) for a in answers if a.status == BROKEN]
    return first_crash(
        folder.label, f"crashed on {len(crashed)} of {len(answers)} queries, counted as not found", crashed
    )


def _suspicions(record: SetRecord, folders: list[RetrieverResults], names: list[str]) -> list[tuple[str, str]]:
    out = []
    for folder in folders:
        runs, scores = folder.run_record().tasks, folder.retrieval_scores().tasks
        for name in names:
            if name in scores and (reason := suspicion(name, record.tasks[name], scores[name], runs.get(name))):
                out.append((folder.label, reason))
    return out
