"""The results of one tracker on one dataset, and the refusal of scores that do not belong to the predictions."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from relocbench.datasets.core.pairfile import ELSEWHERE
from relocbench.errors import PredictionError
from relocbench.evaluation.common.dataset_lookup import Truth
from relocbench.evaluation.common.results import (
    PREDICTIONS,
    DatasetRecord,
    MethodResults,
    PairSetRecord,
    RunRecord,
    ScoreRecord,
)
from relocbench.evaluation.isolation.journal import answered_keys
from relocbench.evaluation.submission.kept import KeptCard, kept_card
from relocbench.evaluation.tables.errors import ErrorTable, read_errors
from relocbench.evaluation.tables.matching import MatchingRow
from relocbench.evaluation.tables.schema import ALL
from relocbench.evaluation.tracking.trivial import IDENTITY_TARGETS
from relocbench.evaluation.tracking.trivial import TARGET as CLOCK_TARGET
from relocbench.evaluation.tracking.verification import (
    faults_of_pair_set,
    faults_of_record,
    faults_of_summary,
    matching_of_pair_set,
    rescored,
)
from relocbench.leaderboard.common.cards import add_command
from relocbench.leaderboard.common.commands import method_words
from relocbench.leaderboard.common.untrusted_results import check_lies_with

SEED = "seed"


@dataclass(frozen=True, eq=False)
class Method:
    """The results of one method on one dataset."""

    label: str
    run: RunRecord
    errors: dict[str, ErrorTable]
    """by pair set, of pairs of one place, ordered by reference time; pair sets without results are absent"""
    missing: dict[str, str]
    """pair set -> why its results are absent"""
    stopped: frozenset[str] = frozenset()
    """the missing pair sets on which a run was begun"""
    matching: dict[str, tuple[MatchingRow, ...]] = field(default_factory=dict)
    """matching quality by pair set, where it was measured"""
    rescored: bool = False
    """whether all errors were computed anew from the predictions and the dataset's truth"""
    elsewhere: dict[str, ErrorTable] = field(default_factory=dict)
    """the errors of pairs of different places, by pair set that has any; ``errors`` is without them"""
    ran_as: str = ""
    """the label in the run's record, which the name of the folder replaces"""
    results: MethodResults | None = None
    """where the answers themselves lie"""
    card: KeptCard | None = None
    """of predictions that were submitted"""

    @property
    def answers(self) -> Mapping[str, ErrorTable]:
        """The errors, which are what is compared."""
        return self.errors

    def tables(self, pair_set: str) -> list[ErrorTable]:
        """The errors of the pairs of one place, and those of different places where there are any."""
        return [self.errors[pair_set], *([self.elsewhere[pair_set]] if pair_set in self.elsewhere else [])]

    @property
    def is_identity(self) -> bool:
        """Whether the method is the identity pose, whatever its label."""
        return self.run.target.removeprefix(PREDICTIONS) in IDENTITY_TARGETS

    @property
    def is_clock(self) -> bool:
        """Whether the method is the timestamp-only baseline, whatever its label."""
        return self.run.target.removeprefix(PREDICTIONS) == CLOCK_TARGET

    @property
    def is_baseline(self) -> bool:
        """Whether the method is a trivial baseline: the identity pose, or what timestamps alone give."""
        return self.is_identity or self.is_clock

    @property
    def seed(self) -> int | None:
        """The seed of the run."""
        value = self.run.parameters.get(SEED, self.run.seed)
        return value if isinstance(value, int) else None

    @property
    def settings(self) -> dict[str, Any]:
        """The method's parameters except the seed."""
        return {k: v for k, v in self.run.parameters.items() if k != SEED}

    @property
    def machine(self) -> str:
        """The machine that the seconds were measured on, in words; empty if it is not recorded."""
        words = machine_words(self.run)
        workers = "" if self.run.workers is None else f", {self.run.workers} pairs at a time"
        return f"{words}{workers}" if words else ""


def machine_words(run: RunRecord) -> str:
    """The processor and number of cores; empty where the processor is not recorded."""
    cores = f", {run.machine['cores']} cores" if "cores" in run.machine else ""
    return f"{run.machine['cpu']}{cores}" if "cpu" in run.machine else ""


def natural(text: str) -> list[tuple[bool, int, str]]:
    """A sort key that puts step_2 before step_10, and under_1m before 1_to_2m."""
    parts = re.findall("[0-9]{1,18}|[^0-9]", re.sub("^under_([0-9]+).*", r"\1", text))
    return [(not part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]


def evaluate_command(
    method: RunRecord, dataset: str = "DATASET", results: str = "RESULTS", *, matching: bool = False
) -> str:
    """The command that runs a method as it was run, resumes a run that was stopped, or brings a submission in."""
    if method.submitted:
        return add_command(method.method, results=results, dataset=dataset)
    words = ["relocbench", "evaluate", "--dataset", dataset, "--out", results, *method_words(method)]
    words += ["--one-core"] if method.one_core else []
    return shlex.join([*words, "--matching"] if matching and not method.target.startswith(PREDICTIONS) else words)


def read_method(
    folder: MethodResults, dataset: DatasetRecord, pair_sets: Mapping[str, PairSetRecord], truth: Truth | None
) -> Method:
    run = folder.run_record()
    check_lies_with(run.dataset, run.fingerprint, dataset, folder.run_yaml)
    ran_as, card = run.method, kept_card(folder.root, run)
    run = run.model_copy(update={"method": folder.label})
    errors: dict[str, ErrorTable] = {}
    elsewhere: dict[str, ErrorTable] = {}
    missing: dict[str, str] = {}
    done = {name for name in pair_sets if _complete(folder, name)}
    scores = _scores(folder, run) if done else None  # read once: it holds every pair set
    for name, record in pair_sets.items():
        if scores is not None and name in done:
            rows = _errors(folder, run, name, record, scores, truth)
            errors[name] = rows.of_group(ALL)
            if record.elsewhere:
                elsewhere[name] = rows.of_group(ELSEWHERE)
        else:
            missing[name] = _why_missing(folder, name, record)
    stopped = frozenset(name for name in missing if folder.journal(name).is_dir())
    again = _again(folder, run, matching=True)
    matching = {
        name: tuple(matching_of_pair_set(folder, name, list(map(tuple, rows.keys.tolist())), scores, again))
        for name, rows in errors.items()
        if scores is not None and (name in scores.matching or folder.matching(name).exists())
    }
    confirmed = truth is not None and bool(errors)
    return Method(folder.label, run, errors, missing, stopped, matching, confirmed, elsewhere, ran_as, folder, card)


def _complete(folder: MethodResults, pair_set: str) -> bool:
    """Whether the pair set is predicted: with a table, or elsewhere without one (a killed run has a journal)."""
    return folder.complete(pair_set) or (
        folder.predictions(pair_set).exists() and not folder.journal(pair_set).is_dir()
    )


def _why_missing(folder: MethodResults, pair_set: str, record: PairSetRecord) -> str:
    journal = folder.journal(pair_set)
    if not journal.is_dir():
        return "not run"
    return f"the run was stopped after {len(answered_keys(journal))} of {record.asked} pairs"


def _scores(folder: MethodResults, run: RunRecord) -> ScoreRecord:
    if not folder.scores_yaml.exists():
        raise PredictionError(f"missing: the predictions are not scored; {_again(folder, run)}", folder.scores_yaml)
    scores = folder.score_record()
    for fault in faults_of_record(folder, run, scores, _again(folder, run)):
        raise fault
    return scores


def _again(folder: MethodResults, run: RunRecord, *, matching: bool = False) -> str:
    return f"score again: {evaluate_command(run, results=str(folder.root.parent.parent), matching=matching)}"


def _errors(
    folder: MethodResults,
    run: RunRecord,
    name: str,
    record: PairSetRecord,
    scores: ScoreRecord,
    truth: Truth | None,
) -> ErrorTable:
    """The errors of one pair set by reference time, computed anew where the truth is available.

    Raises:
        PredictionError: they do not fit predictions, scores and truth.
    """
    again = _again(folder, run)
    for fault in faults_of_pair_set(folder, name, scores, again):
        raise fault
    path = folder.errors(name)
    rows = read_errors(path).by_time()
    twice = bool((np.diff(rows.keys, axis=0) == 0).all(axis=1).any())
    if twice or len(rows) != record.asked:
        raise PredictionError(f"{len(rows)} rows, expected one for each of the {record.asked} pairs; {again}", path)
    if rows.different_places.pairs != record.elsewhere:
        why = f"{rows.different_places.pairs} pairs of different places, expected {record.elsewhere}"
        raise PredictionError(f"{why}; {again}", path)
    absent = [group for group in record.groups if group not in rows.group_names]
    if absent and len(record.groups) > 1:
        raise PredictionError(f"no pair of the group '{absent[0]}', which the dataset's record names; {again}", path)
    for fault in faults_of_summary(folder, name, rows, scores, again):
        raise fault
    if truth is None:
        return rows
    return rescored(folder, truth.dataset.pair_set(name), rows, scores, again, copy=truth.copy)
