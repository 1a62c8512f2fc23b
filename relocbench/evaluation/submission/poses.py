"""Reading submitted poses and the tables beside them: every fault with its line, and what is there in numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from relocbench.arrays import Array
from relocbench.datasets.checks.faults import Findings
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey, parse_pose
from relocbench.errors import PredictionError, quoted
from relocbench.evaluation.submission.contract import UnitAnswers
from relocbench.evaluation.submission.resolving import ResolvedDataset
from relocbench.evaluation.submission.suspicions import odd_answers
from relocbench.evaluation.tables.answers import ANSWERS, Answer
from relocbench.evaluation.tables.rows import KEY_COLUMNS, TableRow
from relocbench.evaluation.tables.schema import STATUS
from relocbench.files import parse_timestamp, read_csv, read_rows

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
