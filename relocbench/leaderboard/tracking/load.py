"""Reading a results folder, and refusing scores that do not belong to the predictions beside them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.pairfile import ELSEWHERE
from relocbench.datasets.cross_view import CrossViewSet
from relocbench.errors import ConfigError, PredictionError, available
from relocbench.evaluation.common.dataset_lookup import DatasetLookup, Truth
from relocbench.evaluation.common.error_table import ErrorTable, read_errors
from relocbench.evaluation.common.matching_table import ALL, MatchingRow
from relocbench.evaluation.common.results import (
    PREDICTIONS,
    DatasetRecord,
    DatasetResults,
    MethodResults,
    PairSetRecord,
    RunRecord,
    ScoreRecord,
    all_results,
)
from relocbench.evaluation.submission.kept import KeptCard, kept_card
from relocbench.evaluation.tracking.clock import TARGET as CLOCK_TARGET
from relocbench.evaluation.tracking.identity import IDENTITY_TARGETS
from relocbench.evaluation.tracking.verification import (
    faults_of_pair_set,
    faults_of_record,
    faults_of_summary,
    matching_of_pair_set,
    rescored,
)
from relocbench.files import read_journal
from relocbench.leaderboard.common.cards import add_command
from relocbench.leaderboard.common.commands import method_words
from relocbench.leaderboard.common.copies import distinct_label
from relocbench.leaderboard.common.untrusted_results import check_file_names, check_folder

if TYPE_CHECKING:
    from relocbench.leaderboard.tracking.doubt import TruthCheck

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

    def tables(self, pair_set: str) -> list[ErrorTable]:
        """The errors of the pairs of one place, and those of different places where there are any."""
        return [self.errors[pair_set], *([self.elsewhere[pair_set]] if pair_set in self.elsewhere else [])]

    def has_pairs_of(self, other: Method, pair_set: str) -> bool:
        """Whether both have errors of the same pairs."""
        ours, theirs = ([table.keys for table in m.tables(pair_set)] for m in (self, other))
        return len(ours) == len(theirs) and all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))

    def has_groups_of(self, other: Method, pair_set: str) -> bool:
        """Whether both name the same groups of these pairs."""
        return [table.groups for table in self.tables(pair_set)] == [table.groups for table in other.tables(pair_set)]

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


@dataclass(frozen=True, eq=False)
class DatasetEntry:
    """One dataset with all results on it."""

    record: DatasetRecord
    methods: tuple[Method, ...]
    """sorted by label"""
    pair_sets: dict[str, PairSetRecord]
    """the pair sets that are compared: chosen, with ground truth, and with at least one pair"""
    splits: dict[str, tuple[str, ...]]
    """split -> pair sets of its total; one split called '' with all pair sets where the dataset has none"""
    withheld: tuple[str, ...] = ()
    """chosen pair sets that cannot be scored: the ground truth is withheld or no pair was accepted"""
    copies: tuple[str, ...] = ()
    """fingerprints of other copies of the same question, from other processors, that methods answered on"""
    dataset: Dataset | None = None
    """the dataset itself, or a copy of it, where it is available"""
    truth_checks: Mapping[str, TruthCheck] = field(default_factory=dict)
    """by pair set whose truth was compared with its images"""

    @property
    def title(self) -> str:
        """The name and short fingerprint, as in the name of the results folder."""
        return f"{self.record.name}@{self.record.fingerprint[:SHORT]}"

    @cached_property
    def identity(self) -> Method | None:
        """The identity pose, if it was run."""
        return next((m for m in self.methods if m.is_identity), None)

    @cached_property
    def clock(self) -> Method | None:
        """The timestamp-only baseline, if it was run."""
        return next((m for m in self.methods if m.is_clock), None)

    @cached_property
    def used(self) -> tuple[str, ...]:
        """The pair sets on which at least one method was run, completely or not."""
        return tuple(n for n in self.pair_sets if any(n in m.errors or n in m.stopped for m in self.methods))

    def errors_of(self, pair_set: str) -> ErrorTable | None:
        """The errors of the first method that has a result on a pair set: all have the same pairs."""
        return next((m.errors[pair_set] for m in self.methods if pair_set in m.errors), None)

    def groups(self, pair_set: str) -> list[str]:
        """The named groups of a pair set in natural order; none where all pairs are in one group."""
        return sorted(self.pair_sets[pair_set].groups, key=natural) if len(self.pair_sets[pair_set].groups) > 1 else []


def load_results(
    results: Path, split: str | None = None, *, datasets: DatasetLookup | None = None
) -> list[DatasetEntry]:
    """Read all results of trackers in a results folder.

    Where a dataset is available, all errors on it are computed anew from predictions and truth; elsewhere the results
    are believed as far as their digests agree.

    Args:
        results: ``RESULTS``, or one of its ``DATASET@FINGERPRINT`` folders.
        split: only the pair sets of this split; datasets without such a split are left out.
        datasets: with their truth; without them, those in folders beside ``RESULTS``.

    Raises:
        PredictionError: with file and line: no results, a bad file, scores that are missing or stale, or errors that
            are not those of the predictions.
        ConfigError: a split that no dataset has.
        DatasetError: a dataset that was named is damaged.
    """
    check_folder(results)
    folders = all_results(results)
    _check_apart(folders)
    lookup = datasets or DatasetLookup(results)
    for folder in folders:
        lookup.mark_used(partial(_belongs, record=folder.record))
    if split is not None:
        known = sorted({name for folder in folders for name in folder.record.splits})
        folders = [folder for folder in folders if split in folder.record.splits]
        if not folders:
            raise ConfigError(f"no split '{split}'{available(split, known)}", results)
    truths = [lookup.of(folder.record, _yaml(folder)) for folder in folders]
    entries = merge_copies([_dataset(folder, split, truth) for folder, truth in zip(folders, truths, strict=True)])
    if not any(entry.methods for entry in entries):
        raise PredictionError("holds no method's predictions; expected results of `relocbench evaluate`", results)
    return entries


def load_methods(folder: DatasetResults, labels: Collection[str], pair_sets: Collection[str]) -> DatasetEntry:
    """The results of some methods on some pair sets of a dataset, as they were just scored. Raises PredictionError."""
    entry = _dataset(folder, None, None, labels)
    chosen = {name: record for name, record in entry.pair_sets.items() if name in pair_sets}
    splits = {split: kept for split, of in entry.splits.items() if (kept := tuple(n for n in of if n in chosen))}
    return replace(entry, pair_sets=chosen, splits=splits)


def _belongs(dataset: Dataset | CrossViewSet, record: DatasetRecord) -> bool:
    """Whether results are of a dataset or of a copy of it."""
    return dataset.name == record.name and (
        dataset.fingerprint == record.fingerprint or dataset.content_id == record.question
    )


def merge_copies(entries: Sequence[DatasetEntry]) -> list[DatasetEntry]:
    """Merge the entries of copies of one question: the same poses and pairs, with images that differ in last digits.

    The first copy represents all. A label that occurs on several copies is made distinct by the copy's fingerprint.

    Raises:
        PredictionError: two results of the same question hold different pairs.
    """
    out: dict[tuple[str, str], DatasetEntry] = {}
    for entry in entries:
        key = entry.record.name, entry.record.compared_by
        out[key] = _merged(out[key], entry) if key in out else entry
    return list(out.values())


def _merged(first: DatasetEntry, other: DatasetEntry) -> DatasetEntry:
    known = {method.label: method for method in first.methods}
    for method in other.methods:
        for name in method.errors:
            same = next((m for m in first.methods if name in m.errors), method)
            if not method.has_pairs_of(same, name) or not method.has_groups_of(same, name):
                raise PredictionError(
                    f"{other.title}: '{method.label}' answered other pairs of '{name}' than methods on {first.title}, "
                    "although both are marked as results of the same dataset; evaluate one of them again"
                )
        label = distinct_label(method.label, known, other.record.fingerprint)
        known[label] = replace(method, label=label, run=method.run.model_copy(update={"method": label}))
    methods = tuple(known[label] for label in sorted(known))
    copies = (*first.copies, other.record.fingerprint)
    return replace(first, methods=methods, copies=copies, dataset=first.dataset or other.dataset)


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
    return shlex.join([*words, "--matching"] if matching and not method.target.startswith(PREDICTIONS) else words)


def _dataset(
    folder: DatasetResults, split: str | None, truth: Truth | None, labels: Collection[str] | None = None
) -> DatasetEntry:
    record = folder.record
    check_file_names(record.pair_sets, "the pair set", _yaml(folder))
    unknown = [name for names in record.splits.values() for name in names if name not in record.pair_sets]
    if unknown:
        raise PredictionError(f"a split names the pair set '{unknown[0]}', which is not there", _yaml(folder))
    in_order = dict.fromkeys([name for names in record.splits.values() for name in names] + list(record.pair_sets))
    chosen = list(in_order) if split is None else list(record.splits[split])
    pair_sets = {n: s for n in chosen if (s := record.pair_sets[n]).has_truth and s.pairs > 0}
    there = [method for method in folder.methods() if labels is None or method.label in labels]
    check_file_names((m.label for m in there), "the method", folder.root)
    methods = tuple(_method(m, record, pair_sets, truth) for m in there)
    _check_same_pairs(folder, methods)
    splits = {name: names for name, names in record.splits.items() if split in (None, name)} or {"": tuple(chosen)}
    return DatasetEntry(
        record,
        methods,
        pair_sets,
        {name: kept for name, names in splits.items() if (kept := tuple(n for n in names if n in pair_sets))},
        tuple(n for n in chosen if n not in pair_sets),
        dataset=None if truth is None else truth.dataset,
    )


def _method(
    folder: MethodResults, dataset: DatasetRecord, pair_sets: dict[str, PairSetRecord], truth: Truth | None
) -> Method:
    run = folder.run_record()
    if run.fingerprint != dataset.fingerprint:
        raise PredictionError(
            f"was made for {run.dataset}@{run.fingerprint[:SHORT]}, but lies among the results of "
            f"{dataset.name}@{dataset.fingerprint[:SHORT]}",
            folder.run_yaml,
        )
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
    keys = {
        str(entry["key"])
        for path in sorted(journal.glob("*.jsonl"))
        for entry in read_journal(path)
        if isinstance(entry, dict) and "key" in entry
    }
    return f"the run was stopped after {len(keys)} of {record.asked} pairs"


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
        told = f"{rows.different_places.pairs} pairs of different places, expected {record.elsewhere}"
        raise PredictionError(f"{told}; {again}", path)
    absent = [group for group in record.groups if group not in rows.group_names]
    if absent and len(record.groups) > 1:
        raise PredictionError(f"no pair of the group '{absent[0]}', which the dataset's record names; {again}", path)
    for fault in faults_of_summary(folder, name, rows, scores, again):
        raise fault
    if truth is None:
        return rows
    return rescored(folder, truth.dataset.pair_set(name), rows, scores, again, copy=truth.copy)


def _check_same_pairs(folder: DatasetResults, methods: Sequence[Method]) -> None:
    first: dict[str, Method] = {}
    for method in methods:
        for name in method.errors:
            other = first.setdefault(name, method)
            path = folder.method(method.label).errors(name)
            if not method.has_pairs_of(other, name):
                raise PredictionError(f"holds other pairs than the errors of '{other.label}'; score both again", path)
            if method is not other and not method.has_groups_of(other, name):
                raise PredictionError(f"holds other groups than the errors of '{other.label}'; score both again", path)


def _check_apart(folders: Sequence[DatasetResults]) -> None:
    """Refuse two folders of one dataset, whose pictures would overwrite each other."""
    first: dict[tuple[str, str], DatasetResults] = {}
    for folder in folders:
        check_file_names([folder.record.name, folder.record.fingerprint], "the name or fingerprint", _yaml(folder))
        other = first.setdefault((folder.record.name, folder.record.fingerprint[:SHORT]), folder)
        if other is not folder:
            raise PredictionError(f"is the same dataset as {other.root.name}; expected one folder of each", folder.root)


def _yaml(folder: DatasetResults) -> Path:
    return folder.root / "dataset.yaml"
