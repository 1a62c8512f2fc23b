"""The task of trackers in a submission: poses of the pairs of a dataset, or of a blind export of it.

Every fault of a file of poses, and of the table beside it, is found with its line.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from relocbench.arrays import Array
from relocbench.datasets.checks.faults import Findings
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey, PoseLine, parse_pose, write_pose_lines
from relocbench.errors import PredictionError, quoted
from relocbench.evaluation.common.opening import open_for_evaluation
from relocbench.evaluation.common.results import (
    DatasetResults,
    MethodResults,
    RunRecord,
    dataset_results,
    write_dataset_record,
)
from relocbench.evaluation.submission.card import Answered
from relocbench.evaluation.submission.contract import (
    AnsweredDataset,
    SubmissionOptions,
    SubmissionTask,
    UnitAnswers,
    check_blind_only,
    files_of_units,
    run_beside,
    withheld,
)
from relocbench.evaluation.submission.folder import answer_files
from relocbench.evaluation.submission.resolving import ResolvedDataset, resolve
from relocbench.evaluation.submission.suspicions import odd_answers, same_answers
from relocbench.evaluation.tables.answers import ANSWERS, Answer
from relocbench.evaluation.tables.schema import KEY_COLUMNS, STATUS, TableRow
from relocbench.evaluation.tracking.score import read_predictions, score_method
from relocbench.files import parse_timestamp, read_csv, read_rows
from relocbench.progress import Reporter

FARTHEST_M = 1e6
"""translations beyond it are no poses of a camera on the same road in metres"""
_LINE_BYTES, _ROW_BYTES, _SPARE_BYTES = 1024, 20_000, 2**16
"""of a line of poses, of a row of a table with its info of 8192 characters, and of comments and headers"""
_WHAT = "predictions (ref_ts query_ts tx ty tz qx qy qz qw)"
_OPTIONAL = ANSWERS.columns[len(KEY_COLUMNS) :]


@dataclass
class PairSetAnswers(UnitAnswers):
    """What was submitted for a pair set. Keys are those of the dataset, also where the answers name blind ones."""

    pair_set: PairSet
    poses: dict[PairKey, Array] = field(default_factory=dict)
    """(4, 4) ``T_query_ref`` of answered pairs"""
    answers: dict[PairKey, Answer] = field(default_factory=dict)
    """rows of the table; empty where there is none"""

    @property
    def name(self) -> str:
        return self.pair_set.name

    @property
    def asked(self) -> int:
        return len(self.pair_set.evaluated)

    @property
    def answered(self) -> int:
        return len(self.poses)

    def oddities(self) -> Iterator[str]:
        return odd_answers(self.pair_set, self.poses, self.answers)

    def complete_answers(self) -> list[Answer]:
        """A row for each evaluated pair, in the pair set's order."""
        return [self.answers.get(key) or self._without_row(key) for key in self.pair_set.by_key]

    def _without_row(self, key: PairKey) -> Answer:
        answered = key in self.poses
        return Answer(*key, "ok" if answered else "failed", message="" if answered else "not in the prediction file")


def read_answered(path: Path, pair_set: PairSet, resolved: ResolvedDataset, findings: Findings) -> PairSetAnswers:
    """Read ``PAIRSET.txt`` and, where there is one, ``PAIRSET.csv``."""
    out = PairSetAnswers(pair_set, given=True)
    keys = resolved.keys(pair_set)
    if _of_possible_size(path, _LINE_BYTES, len(keys), findings):
        _read_poses(path, resolved, keys, out, findings)
    table = path.with_suffix(".csv")
    if table.exists() and _of_possible_size(table, _ROW_BYTES, len(keys), findings):
        _read_table(table, resolved, keys, out, findings)
        _compare(path, table, keys, out, findings)
    return out


def _of_possible_size(path: Path, most: int, pairs: int, findings: Findings) -> bool:
    size, limit = path.stat().st_size, _SPARE_BYTES + most * pairs
    if size > limit:
        findings.fault(f"holds {size} bytes; of answers to {pairs} pairs at most {limit} are read", path)
    return size <= limit


def _read_poses(
    path: Path, resolved: ResolvedDataset, keys: Mapping[PairKey, PairKey], out: PairSetAnswers, findings: Findings
) -> None:
    seen: dict[PairKey, int] = {}
    with findings.catching():
        for number, fields in read_rows(path, _WHAT, PredictionError):
            try:
                _read_line(fields, path, number, resolved, keys, seen, out, findings)
            except PredictionError as bad:
                out.invalid += 1
                findings.fault(bad.expected, path, number)


def _read_line(
    fields: list[str],
    path: Path,
    number: int,
    resolved: ResolvedDataset,
    keys: Mapping[PairKey, PairKey],
    seen: dict[PairKey, int],
    out: PairSetAnswers,
    findings: Findings,
) -> None:
    """Take one line in. Raises PredictionError where it cannot be read."""
    if len(fields) not in (2, 9):
        raise PredictionError(f"expected 2 or 9 columns (ref_ts query_ts [tx ty tz qx qy qz qw]), found {len(fields)}")
    key = _key(fields, path, number)
    if key in seen:
        out.duplicate += 1
        findings.fault(f"pair {key[0]} {key[1]} occurs again (first on line {seen[key]})", path, number)
        return
    seen[key] = number
    if key not in keys:
        out.unknown += 1
        findings.fault(resolved.why_unknown(out.pair_set, key), path, number)
    elif len(fields) == 9:
        out.poses[keys[key]] = _pose(fields, path, number)


def _key(fields: list[str], path: Path, number: int) -> PairKey:
    ref, query = (parse_timestamp(field, path, number, PredictionError) for field in fields[:2])
    return ref, query


def _pose(fields: list[str], path: Path, number: int) -> Array:
    pose = parse_pose(fields[2:], path, number, PredictionError)
    distance = math.hypot(*pose[:3, 3])
    if not distance <= FARTHEST_M:
        message = f"the translation is {distance:.3g} m long, expected metres between two cameras on one road"
        raise PredictionError(message, path, number)
    return pose


def _read_table(
    path: Path, resolved: ResolvedDataset, keys: Mapping[PairKey, PairKey], out: PairSetAnswers, findings: Findings
) -> None:
    seen: dict[PairKey, int] = {}
    with findings.catching():
        rows = read_csv(path, f"a table ({','.join(KEY_COLUMNS)} and any of {','.join(_OPTIONAL)})", PredictionError)
        columns = _columns(next(rows, (1, []))[1], path)
        for number, fields in rows:
            with findings.catching():
                if len(fields) != len(columns):
                    raise PredictionError(f"expected {len(columns)} columns, found {len(fields)}", path, number)
                row = TableRow(path, number, dict.fromkeys(_OPTIONAL, "") | dict(zip(columns, fields, strict=True)))
                key = row.key()
                if key in seen:
                    raise row.fault(f"pair {key[0]} {key[1]} occurs again (first on line {seen[key]})")
                seen[key] = number
                if key not in keys:
                    raise row.fault(resolved.why_unknown(out.pair_set, key))
                out.answers[keys[key]] = _answer(row, keys[key], out)


def _columns(header: list[str], path: Path) -> list[str]:
    """The columns of a table. Raises PredictionError unless they are pairs and what may be said of them."""
    unknown = [name for name in header if name not in ANSWERS.columns]
    if unknown or header[:2] != list(KEY_COLUMNS) or len(set(header)) != len(header):
        instead = f", found {quoted(unknown[0])}" if unknown else ""
        wanted = f"{','.join(KEY_COLUMNS)} and any of {','.join(_OPTIONAL)}"
        raise PredictionError(f"expected the header {wanted}, each once{instead}", path, 1)
    return header


def _answer(row: TableRow, key: PairKey, out: PairSetAnswers) -> Answer:
    status = STATUS.read(row, "status") if row["status"] else "ok" if key in out.poses else "failed"
    for name, most in (("message", 500), ("info", 8192)):
        if len(row[name]) > most:
            raise row.fault(f"{name} has {len(row[name])} characters, expected at most {most}")
    return Answer(
        *key, status, row.seconds_or_none("seconds"), row.number_or_none("confidence"), row["message"], row["info"]
    )


def _compare(path: Path, table: Path, keys: Mapping[PairKey, PairKey], out: PairSetAnswers, findings: Findings) -> None:
    """Faults of pairs whose row says otherwise than their line."""
    shown = {real: key for key, real in keys.items()}
    for real, answer in out.answers.items():
        ref, query = shown[real]
        if (answer.status == "ok") != (real in out.poses):
            held = "no valid pose" if answer.status == "ok" else "a pose"
            findings.fault(f"pair {ref} {query} is '{answer.status}' but has {held} in {path.name}", table)


@dataclass(frozen=True, eq=False)
class TrackedDataset(AnsweredDataset):
    """The answers of a tracker to one dataset."""

    record_file = "dataset.yaml"
    units: Sequence[PairSetAnswers]
    resolved: ResolvedDataset

    def home(self, results: Path) -> Path:
        dataset = self.resolved.dataset
        for of in self.units:
            if not of.pair_set.has_truth:
                raise withheld(of.name, dataset.root)
        return dataset_results(results, dataset).root

    def write_row(self, home: Path, made: Path, label: str) -> MethodResults:
        row = MethodResults(made / label)
        write_dataset_record(DatasetResults(made), self.resolved.dataset)
        for of in self.units:
            if of.given:
                lines = [PoseLine(*key, of.poses[key]) for key in of.pair_set.by_key if key in of.poses]
                write_pose_lines(row.predictions(of.name), lines)
                ANSWERS.write(row.answers(of.name), of.complete_answers())
        return row

    def run_record(self, fields: dict[str, Any]) -> RunRecord:
        dataset = self.resolved.dataset
        return RunRecord.on(dataset, **fields, answered_on=self.resolved.answered_on)

    def score(self, row: MethodResults) -> None:
        score_method(self.resolved.dataset, self.resolved.dataset.pair_sets(), row)

    def same_as_others(self, home: Path, label: str) -> Iterator[str]:
        given = sum(of.answered for of in self.units)
        for row in DatasetResults(home).methods() if home.is_dir() and given else ():
            if row.label != label:
                same = sum(
                    same_answers(of.poses, read_predictions(row.predictions(of.name), of.pair_set))
                    for of in self.units
                    if row.predictions(of.name).exists()
                )
                if 2 * same > given:
                    yield f"{same} of {given} answers are those of '{row.label}'"


class Tracking(SubmissionTask):
    """Datasets whose pairs are answered."""

    def __init__(self, root: Path, options: SubmissionOptions, reporter: Reporter) -> None:
        self._options = options
        self._datasets: list[Dataset] = [open_for_evaluation(path, root) for path in options.datasets]

    def read(self, folder: Path, answered: Answered, findings: Findings) -> TrackedDataset:
        run = run_beside(folder, RunRecord, folder.name, answered.fingerprint, findings)
        question = "" if run is None else run.question
        resolved = resolve(folder.name, answered.fingerprint, question, self._datasets, self._options.salt)
        check_blind_only(folder, self._options, is_blind=resolved.blind is not None)
        asked = {resolved.shown(s): s for s in resolved.dataset.pair_sets()}
        files = files_of_units(folder, "pair set", list(asked), "predictions (PAIRSET.txt)", findings)
        for path in answer_files(folder, ".csv"):
            if path.stem not in files:
                findings.fault("has no predictions (.txt) of that name beside it", path)
        units = [
            read_answered(files[name], s, resolved, findings) if name in files else PairSetAnswers(s)
            for name, s in asked.items()
        ]
        return TrackedDataset(folder, units, resolved)
