"""Checking predictions and results for every fault, with file and line."""

from __future__ import annotations

import contextlib
import shlex
from dataclasses import dataclass
from pathlib import Path

from relocbench.datasets.checks.faults import Findings, read_pair_lines, read_yaml
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.pairfile import PairKey, PoseLine
from relocbench.errors import PredictionError, available
from relocbench.evaluation.common.dataset_lookup import check_record
from relocbench.evaluation.common.results import PREDICTIONS, DatasetRecord, MethodResults, RunRecord, ScoreRecord
from relocbench.evaluation.common.runs import labelled_target, settings_of
from relocbench.evaluation.isolation.journal import answered_keys
from relocbench.evaluation.tables.answers import ANSWERS
from relocbench.evaluation.tables.errors import ERRORS, read_errors
from relocbench.evaluation.tracking.score import FORMULAS
from relocbench.evaluation.tracking.verification import (
    faults_of_pair_set,
    faults_of_record,
    faults_of_summary,
    matching_of_pair_set,
    rescored,
)
from relocbench.progress import Reporter

_OTHERS = ("retrieval.yaml", "relocalization.yaml")
_AGAIN = "run `relocbench evaluate` again to score"


@dataclass(frozen=True)
class _Expected:
    """The pairs that predictions should answer."""

    record: DatasetRecord | None
    """the results folder's record of its dataset"""
    dataset: Dataset | None
    """the dataset itself, where it is available"""

    @property
    def pair_sets(self) -> dict[str, int] | None:
        """Pair set -> number of pairs; None where neither the dataset nor a record of it is known."""
        if self.dataset is not None:
            return {s.name: len(s.evaluated) for s in self.dataset.pair_sets()}
        return None if self.record is None else {n: p.asked for n, p in self.record.pair_sets.items()}

    @property
    def fingerprint(self) -> str | None:
        if self.dataset is not None:
            return self.dataset.fingerprint
        return None if self.record is None else self.record.fingerprint


def is_tracking_folder(path: Path) -> bool:
    """Whether a folder has the layout of ``relocbench evaluate``, for several datasets, for one, or for one method."""
    if any((path / name).exists() for name in ("run.yaml", "dataset.yaml", "scores.yaml")):
        return True
    return any(path.glob("*@*/dataset.yaml")) or any(path.glob("*@*/*/run.yaml"))


def validate_results(root: Path, dataset: Dataset | None, reporter: Reporter) -> Findings:
    """Check a results folder, one ``DATASET@FINGERPRINT`` folder of it, or one method's folder.

    If ``dataset`` is given, predictions are compared with it and scored again; another dataset's results in the folder
    are noted and checked on their own.
    """
    findings = Findings()
    if (root / "run.yaml").exists():
        record = _dataset_record(root.parent, findings) if (root.parent / "dataset.yaml").exists() else None
        folders = [(MethodResults(root), record)]
    else:
        tops = [root] if (root / "dataset.yaml").exists() else sorted(p for p in root.glob("*@*") if _is_trackers(p))
        folders = []
        for top in tops:
            record = _dataset_record(top, findings)
            if record is not None and dataset is not None and record.fingerprint == dataset.fingerprint:
                with findings.catching():
                    check_record(record, dataset, top / "dataset.yaml")
            folders += [(MethodResults(p), record) for p in sorted(top.iterdir()) if p.is_dir() and p.name[0] != "."]
        if not folders and (tops or not any(root.glob("*@*"))):
            findings.note("holds no method's results yet", root)
    with reporter.stage("checking results", len(folders)) as advance:
        for folder, record in folders:
            theirs = dataset
            if dataset is not None and len(folders) > 1 and record and record.fingerprint != dataset.fingerprint:
                findings.note(f"is of another dataset than {dataset.root}", folder.root)
                theirs = None
            _check_method(folder, _Expected(record, theirs), findings)
            advance(1)
    return findings


def _is_trackers(top: Path) -> bool:
    """Whether a ``NAME@FINGERPRINT`` folder is one of trackers, and not of retrievers or pipelines, which have
    no record of a dataset but one of their own."""
    return top.is_dir() and ((top / "dataset.yaml").exists() or not any((top / name).exists() for name in _OTHERS))


def validate_prediction_files(path: Path, dataset: Dataset | None) -> Findings:
    """Check one pair or prediction file, or a folder of them; without a dataset, each file by itself."""
    findings = Findings()
    files = sorted(path.glob("*.txt")) if path.is_dir() else [path]
    expected = _Expected(None, dataset)
    for file in files:
        lines = read_pair_lines(file, findings, PredictionError)
        _check_keys(file, file.stem, lines, expected, findings)
        if file.with_suffix(".csv").exists() and path.is_dir():
            _read_answers(file.with_suffix(".csv"), findings)
    return findings


def _dataset_record(top: Path, findings: Findings) -> DatasetRecord | None:
    record = read_yaml(top / "dataset.yaml", DatasetRecord, "the record of a dataset", findings)
    if record is not None and top.name != f"{record.name}@{record.fingerprint[:SHORT]}":
        findings.note(f"has another name than its dataset, {record.name}@{record.fingerprint[:SHORT]}", top)
    return record


def _check_method(folder: MethodResults, expected: _Expected, findings: Findings) -> None:
    run = read_yaml(folder.run_yaml, RunRecord, "the record of a run", findings)
    if run is not None and expected.fingerprint is not None and run.fingerprint != expected.fingerprint:
        findings.fault(
            f"predictions are for {run.dataset}@{run.fingerprint[:SHORT]}, the dataset has the fingerprint "
            f"{expected.fingerprint[:SHORT]}",
            folder.run_yaml,
        )
    for part in sorted(folder.root.glob(".*.part*")):
        findings.note("left behind by a run that was killed", part)
    journals = folder.root / ".journal"
    running = {p.name for p in journals.iterdir() if p.is_dir()} if journals.is_dir() else set()
    present = {p.stem for p in folder.root.glob("*__*__*.txt")} | {
        p.stem for p in folder.root.glob("*__*__*.csv") if not p.name.endswith((".errors.csv", ".matching.csv"))
    }
    for name in sorted(present - running):
        _check_pair_set(folder, name, expected, findings)
    _note_unfinished(folder, run, running, present, expected, findings)
    _check_scores(folder, run, present - running, expected, findings)


def _check_pair_set(folder: MethodResults, name: str, expected: _Expected, findings: Findings) -> None:
    """Check the prediction file and the table of answers, each by itself and against each other."""
    predictions, table = folder.predictions(name), folder.answers(name)
    lines = read_pair_lines(predictions, findings, PredictionError)
    _check_keys(predictions, name, lines, expected, findings)
    statuses = _read_answers(table, findings)
    wanted = (expected.pair_sets or {}).get(name)
    if statuses and wanted is not None and len(statuses) != wanted:
        findings.fault(f"holds {len(statuses)} pairs, the pair set has {wanted}", table)
    for key, (status, number) in statuses.items():
        if status == "ok" and key not in lines:
            findings.fault(f"pair {key[0]} {key[1]} is 'ok' but has no pose in {predictions.name}", table, number)
        elif status != "ok" and key in lines:
            findings.fault(f"pair {key[0]} {key[1]} is '{status}' but has a pose in {predictions.name}", table, number)
    for key, line in lines.items():
        if statuses and key not in statuses:
            findings.fault(f"pair {key[0]} {key[1]} is missing from {table.name}", predictions, line.line)


def _check_keys(path: Path, name: str, lines: dict[PairKey, PoseLine], expected: _Expected, findings: Findings) -> None:
    """Check that the pair set exists, and that every line answers one of its pairs."""
    pair_sets = expected.pair_sets
    if pair_sets is None:
        return
    if name not in pair_sets:
        findings.fault(f"no pair set '{name}' in the dataset{available(name, pair_sets)}", path)
        return
    if expected.dataset is None:
        return
    wanted = expected.dataset.pair_set(name).by_key
    for key, line in lines.items():
        if key not in wanted:
            findings.fault(f"unknown pair {key[0]} {key[1]}; expected one of the {len(wanted)} pairs", path, line.line)
    missing = len(wanted.keys() - lines.keys())
    if missing:
        findings.note(f"{missing} of {len(wanted)} pairs are not answered and count as failures", path)


def _read_answers(path: Path, findings: Findings) -> dict[PairKey, tuple[str, int]]:
    """Read the status and line number of each pair in ``PAIRSET.csv``."""
    out: dict[PairKey, tuple[str, int]] = {}
    for row, _ in ANSWERS.readable(path, findings):
        with contextlib.suppress(PredictionError):  # it is among the findings
            out.setdefault(row.key(), (row["status"], row.line))
    return out


def _note_unfinished(
    folder: MethodResults,
    run: RunRecord | None,
    running: set[str],
    present: set[str],
    expected: _Expected,
    findings: Findings,
) -> None:
    """Note what an unfinished run has done and how to resume it; that is no fault."""
    pair_sets = expected.pair_sets or {}
    begun = {name: len(done) for name in sorted(running) if (done := answered_keys(folder.journal(name)))}
    for name, count in begun.items():
        of = f" of {pair_sets[name]}" if name in pair_sets else ""
        findings.note(
            f"unfinished: {count}{of} pairs of {name} are answered{_resume(folder, run, expected)}", folder.root
        )
    missing = sorted((pair_sets.keys() | running) - present - begun.keys())
    if missing and run is not None:
        state = "has no answers for" if run.end or run.target.startswith(PREDICTIONS) else "unfinished: not begun with"
        findings.note(f"{state} {', '.join(missing)}{_resume(folder, run, expected)}", folder.root)


def _resume(folder: MethodResults, run: RunRecord | None, expected: _Expected) -> str:
    if run is None or run.target.startswith(PREDICTIONS):
        return ""
    dataset = str(expected.dataset.root) if expected.dataset is not None else run.dataset.upper()
    words = ["relocbench", "evaluate", "-d", dataset, "-m", labelled_target(folder.label, run)]
    words += [word for setting in settings_of(folder.label, run) for word in ("--set", setting)]
    words += ["--seed", str(run.seed or 0), "-o", str(folder.root.parent.parent)]
    return f"; to go on: {shlex.join(words)}"


def _check_scores(
    folder: MethodResults, run: RunRecord | None, complete: set[str], expected: _Expected, findings: Findings
) -> None:
    """Check that scores belong to the files beside them and, with the dataset, that its truth confirms them."""
    if not folder.scores_yaml.exists():
        if complete:
            findings.note("not scored yet: `relocbench evaluate` scores it", folder.root)
        return
    scores = read_yaml(folder.scores_yaml, ScoreRecord, "the scores of a method", findings)
    if scores is None or run is None:
        return
    for fault in faults_of_record(folder, run, scores, _AGAIN):
        findings.fault(fault.expected, fault.path)
    for name in scores.predictions:
        if not folder.predictions(name).exists():
            if name not in complete:
                findings.fault(f"scores pair set '{name}', whose predictions are missing", folder.scores_yaml)
        elif scores.formulas == FORMULAS:
            _check_scored(folder, name, scores, expected.dataset, findings)
        else:
            ERRORS.check(folder.errors(name), findings)
    unscored = sorted(complete - scores.predictions.keys())
    truth = {n for n, p in expected.record.pair_sets.items() if p.has_truth} if expected.record else set(unscored)
    if truth & set(unscored):
        findings.note(f"not scored yet: {', '.join(sorted(truth & set(unscored)))}", folder.root)


def _check_scored(
    folder: MethodResults, name: str, scores: ScoreRecord, dataset: Dataset | None, findings: Findings
) -> None:
    """Check errors and matching quality of a pair set, their summaries and, with the dataset, each error."""
    before = len(findings.faults)
    for fault in faults_of_pair_set(folder, name, scores, _AGAIN):
        findings.fault(fault.expected, fault.path)
    if folder.errors(name).exists():
        ERRORS.check(folder.errors(name), findings)
    if len(findings.faults) > before:
        return  # the file that was changed is named; what else no longer fits follows from it
    with findings.catching():
        rows = read_errors(folder.errors(name)).by_time()
        for fault in faults_of_summary(folder, name, rows, scores, _AGAIN):
            findings.fault(fault.expected, fault.path)
        if dataset is not None and name in dataset.pair_set_names and dataset.fingerprint == scores.fingerprint:
            rescored(folder, dataset.pair_set(name), rows, scores, _AGAIN)
    if name in scores.matching or folder.matching(name).exists():
        with findings.catching():
            keys = list(map(tuple, read_errors(folder.errors(name)).keys.tolist()))
            matching_of_pair_set(folder, name, keys, scores, f"{_AGAIN}, with --matching")
