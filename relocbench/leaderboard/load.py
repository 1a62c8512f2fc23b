"""Read a results folder, and refuse scores that do not belong to the predictions beside them."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from relocbench.datasets.fingerprint import SHORT
from relocbench.errors import ConfigError, PredictionError
from relocbench.evaluation.matching_table import MatchingRow, check_complete, read_matching, summarize_matching
from relocbench.evaluation.results import (
    DatasetRecord,
    DatasetResults,
    MethodResults,
    PairErrors,
    PairSetRecord,
    RunRecord,
    ScoreRecord,
    all_results,
    read_errors,
)
from relocbench.evaluation.score import groups_of, predictions_hash, summarize_rows
from relocbench.files import read_journal

PREDICTIONS = "predictions:"
"""target of predictions that were made elsewhere"""
FLOOR = "identity"
"""the method that every other is read against"""
SEED = "seed"


@dataclass(frozen=True, eq=False)
class Method:
    """One method on one dataset."""

    label: str
    run: RunRecord
    errors: dict[str, tuple[PairErrors, ...]]
    """by pair set, ordered by reference time; a pair set without results is absent"""
    missing: dict[str, str]
    """why a pair set is absent"""
    stopped: frozenset[str] = frozenset()
    """the missing ones whose run was begun"""
    matching: dict[str, tuple[MatchingRow, ...]] = field(default_factory=dict)
    """matching quality by pair set, where it was measured"""

    @property
    def is_floor(self) -> bool:
        """Whether it is the identity pose, whatever label it was given."""
        return self.run.target.removeprefix(PREDICTIONS) == FLOOR or self.run.target.endswith(":Identity")

    @property
    def seed(self) -> int | None:
        """The seed it ran with."""
        value = self.run.parameters.get(SEED, self.run.seed)
        return value if isinstance(value, int) else None

    @property
    def settings(self) -> dict[str, Any]:
        """Its parameters except the seed."""
        return {k: v for k, v in self.run.parameters.items() if k != SEED}

    @property
    def machine(self) -> str:
        """The machine its seconds were measured on, in words; empty if that is not recorded."""
        if "cpu" not in self.run.machine:
            return ""
        cores = f", {self.run.machine['cores']} cores" if "cores" in self.run.machine else ""
        workers = "" if self.run.workers is None else f", {self.run.workers} pairs at a time"
        return f"{self.run.machine['cpu']}{cores}{workers}"


@dataclass(frozen=True, eq=False)
class DatasetEntry:
    """One dataset with everything that was scored on it."""

    record: DatasetRecord
    methods: tuple[Method, ...]
    """by label"""
    pair_sets: dict[str, PairSetRecord]
    """the pair sets that are compared, by name: chosen, with ground truth, and with at least one pair"""
    splits: dict[str, tuple[str, ...]]
    """the splits that a total is made for; one called '' over all pair sets where the dataset names none"""
    withheld: tuple[str, ...] = ()
    """chosen pair sets that cannot be scored: the ground truth is withheld or no pair was accepted"""

    @property
    def title(self) -> str:
        """Name and short fingerprint, as the results folder is called."""
        return f"{self.record.name}@{self.record.fingerprint[:SHORT]}"

    @cached_property
    def floor(self) -> Method | None:
        """The identity pose, if it was run."""
        return next((m for m in self.methods if m.is_floor), None)

    @cached_property
    def used(self) -> tuple[str, ...]:
        """The pair sets that at least one method was run on, if not to the end."""
        return tuple(n for n in self.pair_sets if any(n in m.errors or n in m.stopped for m in self.methods))

    def groups(self, pair_set: str) -> list[str]:
        """Named groups of a pair set in natural order; none where all its pairs are one group."""
        return sorted(self.pair_sets[pair_set].groups, key=natural) if len(self.pair_sets[pair_set].groups) > 1 else []


def load_results(results: Path, split: str | None = None) -> list[DatasetEntry]:
    """Everything in a results folder.

    Args:
        results: ``RESULTS``, or one ``DATASET@FINGERPRINT`` folder of it.
        split: only the pair sets of this split; datasets that have no such split are left out.

    Raises:
        PredictionError: with file and line: no results, a bad file, a method's scores are missing or stale.
        ConfigError: no dataset has that split.
    """
    folders = all_results(results)
    if split is not None:
        known = sorted({name for folder in folders for name in folder.record.splits})
        folders = [folder for folder in folders if split in folder.record.splits]
        if not folders:
            raise ConfigError(f"no split '{split}'; there is {', '.join(known) or 'none'}", results)
    entries = [_dataset(folder, split) for folder in folders]
    if not any(entry.methods for entry in entries):
        raise PredictionError("holds no method's predictions; expected results of `relocbench evaluate`", results)
    return entries


def natural(text: str) -> list[tuple[bool, int, str]]:
    """Sort key in which step_2 comes before step_10."""
    digits = "".join(c if c.isdigit() else f"\0{c}\0" for c in text).split("\0")
    return [(not part.isdigit(), int(part) if part.isdigit() else 0, part) for part in digits if part]


def evaluate_command(
    method: RunRecord, dataset: str = "DATASET", results: str = "RESULTS", *, matching: bool = False
) -> str:
    """The command that runs a method as it was run, and goes on where it stopped."""
    words = ["relocbench", "evaluate", "--dataset", dataset, "--out", results]
    if method.target.startswith(PREDICTIONS):
        return shlex.join([*words, "--method", method.method, "--predictions", method.target.removeprefix(PREDICTIONS)])
    named = method.target if method.target == method.method else f"{method.method}={method.target}"
    words += ["--method", named]
    for key, value in method.parameters.items():
        if key != SEED or value != method.seed:
            text = value if isinstance(value, str) else json.dumps(value)
            words += ["--set", f"{method.method}.{key}={text}"]
    words += ["--seed", str(method.seed)] if method.seed else []
    return shlex.join([*words, *(["--matching"] if matching else [])])


def _dataset(folder: DatasetResults, split: str | None) -> DatasetEntry:
    record = folder.record
    chosen = list(record.pair_sets) if split is None else list(record.splits[split])
    unknown = [name for names in record.splits.values() for name in names if name not in record.pair_sets]
    if unknown:
        raise PredictionError(f"a split names the pair set '{unknown[0]}', which is not there", _yaml(folder))
    pair_sets = {n: s for n in chosen if (s := record.pair_sets[n]).has_truth and s.pairs > 0}
    methods = tuple(_method(m, record, pair_sets) for m in folder.methods())
    _check_same_pairs(folder, methods)
    splits = {name: names for name, names in record.splits.items() if split in (None, name)} or {"": tuple(chosen)}
    return DatasetEntry(
        record,
        methods,
        pair_sets,
        {name: kept for name, names in splits.items() if (kept := tuple(n for n in names if n in pair_sets))},
        tuple(n for n in chosen if n not in pair_sets),
    )


def _method(folder: MethodResults, dataset: DatasetRecord, pair_sets: dict[str, PairSetRecord]) -> Method:
    run = folder.run_record()
    if run.fingerprint != dataset.fingerprint:
        raise PredictionError(
            f"was made for {run.dataset}@{run.fingerprint[:SHORT]}, but lies among the results of "
            f"{dataset.name}@{dataset.fingerprint[:SHORT]}",
            folder.run_yaml,
        )
    run = run.model_copy(update={"method": folder.label})
    errors: dict[str, tuple[PairErrors, ...]] = {}
    missing: dict[str, str] = {}
    for name, record in pair_sets.items():
        if _complete(folder, name):
            errors[name] = _errors(folder, run, name, record)
        else:
            missing[name] = _why_missing(folder, name, record)
    stopped = frozenset(name for name in missing if folder.journal(name).is_dir())
    matching = {
        name: _matching(folder, run, name, [row.key for row in rows])
        for name, rows in errors.items()
        if folder.matching(name).exists()
    }
    return Method(folder.label, run, errors, missing, stopped, matching)


def _complete(folder: MethodResults, pair_set: str) -> bool:
    """Predictions made elsewhere may come without a table; a run that was killed between the two keeps a journal."""
    return folder.complete(pair_set) or (
        folder.predictions(pair_set).exists() and not folder.journal(pair_set).is_dir()
    )


def _why_missing(folder: MethodResults, pair_set: str, record: PairSetRecord) -> str:
    journal = folder.journal(pair_set)
    if not journal.is_dir():
        return "not run"
    keys = {tuple(entry["key"]) for path in journal.glob("*.jsonl") for entry in read_journal(path)}
    return f"the run was stopped after {len(keys)} of {record.pairs} pairs"


def _errors(folder: MethodResults, run: RunRecord, name: str, record: PairSetRecord) -> tuple[PairErrors, ...]:
    """Errors of one pair set by reference time. Raises PredictionError unless they fit predictions and scores."""
    again = f"score again: {evaluate_command(run, results=str(folder.root.parent.parent))}"
    if not folder.scores_yaml.exists():
        raise PredictionError(f"missing: the predictions are not scored; {again}", folder.scores_yaml)
    scores = folder.score_record()
    if name not in scores.predictions or name not in scores.pair_sets:
        raise PredictionError(f"holds no scores of '{name}', which was predicted; {again}", folder.scores_yaml)
    if scores.predictions[name] != predictions_hash(folder, name):
        raise PredictionError(f"changed since it was scored; {again}", folder.predictions(name))
    path = folder.errors(name)
    rows = sorted(read_errors(path), key=lambda row: row.key)
    if len({row.key for row in rows}) != len(rows) or len(rows) != record.pairs:
        raise PredictionError(f"{len(rows)} rows, expected one for each of the {record.pairs} pairs; {again}", path)
    _check_scores(rows, scores, name, folder, again)
    return tuple(rows)


def _matching(
    folder: MethodResults, run: RunRecord, name: str, keys: Sequence[tuple[int, int]]
) -> tuple[MatchingRow, ...]:
    """Matching quality of one pair set. Raises PredictionError unless its summary is the one in ``scores.yaml``."""
    path = folder.matching(name)
    rows = read_matching(path)
    check_complete(rows, keys, path)
    recorded = folder.score_record().matching.get(name, {})
    if any(recorded.get(group) != summarize_matching(rows, group) for group in groups_of(rows)):
        again = evaluate_command(run, results=str(folder.root.parent.parent), matching=True)
        raise PredictionError(f"is not what {folder.scores_yaml.name} summarises; score again: {again}", path)
    return tuple(rows)


def _check_scores(
    rows: Sequence[PairErrors], scores: ScoreRecord, name: str, folder: MethodResults, again: str
) -> None:
    """The table of errors is not covered by a hash, but its summary must be the one in ``scores.yaml``."""
    for group in groups_of(rows):
        recorded = scores.pair_sets[name].get(group, {})
        for metric, value in summarize_rows(rows, group).to_dict().items():
            if metric not in recorded:
                raise PredictionError(f"no {metric} of '{name}' ({group}); {again}", folder.scores_yaml)
            if not _same(value, recorded[metric]):
                told = f"{metric} ({group}) is {value} here and {recorded[metric]} in {folder.scores_yaml.name}"
                raise PredictionError(f"{told}; {again}", folder.errors(name))


def _same(a: float | None, b: float | None) -> bool:
    return a is b if a is None or b is None else math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-12)


def _check_same_pairs(folder: DatasetResults, methods: Sequence[Method]) -> None:
    first: dict[str, tuple[str, list[tuple[int, int]]]] = {}
    for method in methods:
        for name, rows in method.errors.items():
            keys = [row.key for row in rows]
            label, expected = first.setdefault(name, (method.label, keys))
            if keys != expected:
                path = folder.method(method.label).errors(name)
                raise PredictionError(f"holds other pairs than the errors of '{label}'; score both again", path)


def _yaml(folder: DatasetResults) -> Path:
    return folder.root / "dataset.yaml"
