"""``PAIRSET.errors.csv``: the errors of a tracker, a row for each pair. By column, 100,000 pairs take some 10 MB."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, overload

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Indices
from relocbench.datasets.core.pairfile import ELSEWHERE
from relocbench.evaluation.tables.schema import (
    ALL,
    ERROR,
    NUMBER,
    STATUS,
    STATUSES,
    TEXT,
    PairRecord,
    Schema,
    or_blank,
)
from relocbench.files import write_table
from relocbench.metrics import (
    CORRECT,
    DifferentPlaces,
    PairScores,
    PairSetSummary,
    PoseErrors,
    summarize_scores,
    within,
)
from relocbench.metrics.pose.scores import FLOATS


@dataclass(frozen=True)
class PairErrors(PairRecord):
    """One row of ``PAIRSET.errors.csv``."""

    group: Annotated[str, TEXT]
    status: Annotated[str, STATUS]
    rotation_error_deg: Annotated[float, ERROR]
    translation_error_m: Annotated[float, ERROR]
    mlad_translation_error_m: Annotated[float, ERROR]
    confidence: Annotated[float | None, NUMBER]
    seconds: Annotated[float | None, NUMBER]
    distance_m: Annotated[float | None, NUMBER]
    angle_deg: Annotated[float | None, NUMBER]
    sigma_translation_m: Annotated[float | None, NUMBER]
    sigma_rotation_deg: Annotated[float | None, NUMBER]
    vcre: Annotated[float | None, or_blank(ERROR)] = None
    """virtual correspondence reprojection error, as a share of the image's diagonal; unknown without a camera"""
    travelled_m: Annotated[float | None, NUMBER] = None
    """metres that the query's drive had travelled by then"""
    overlap: Annotated[float | None, NUMBER] = None
    """share of the keyframe's pixels with depth that the query sees"""
    scale_change: Annotated[float | None, NUMBER] = None
    """median change of scale of what it sees, 1 or more"""
    peak_memory_bytes: Annotated[float | None, NUMBER] = None
    """as in the table of answers"""
    overlap_query: Annotated[float | None, NUMBER] = None
    """share of the query's pixels with depth that the keyframe sees"""
    depth_error: Annotated[float | None, NUMBER] = None
    """what the map states of the keyframe's depths, relative to them"""
    similarity: Annotated[float | None, NUMBER] = None
    """correlation of patches of the two images, -1 to 1"""


ERRORS = Schema(PairErrors)
NUMBERS = ERRORS.columns[4:]
_ERRORS, _OPTIONAL = NUMBERS[:3], NUMBERS[3:]
_MAY_BE_INFINITE = [*range(len(_ERRORS)), NUMBERS.index("vcre")]


@dataclass(frozen=True, eq=False)
class ErrorTable(Sequence[PairErrors]):
    """The rows of ``PAIRSET.errors.csv``, held by column."""

    keys: Indices
    """(N, 2) reference and query timestamp, nanoseconds"""
    group_index: Indices
    """(N,) index into ``group_names``"""
    group_names: tuple[str, ...]
    """in order of appearance"""
    status_index: NDArray[np.int8]
    """(N,) index into :data:`STATUSES`"""
    numbers: Array
    """(len(NUMBERS), N) the columns :data:`NUMBERS`; NaN where there is no value"""

    @classmethod
    def of(cls, rows: Sequence[PairErrors]) -> ErrorTable:
        """The same rows by column."""
        if isinstance(rows, cls):
            return rows
        names: dict[str, int] = {}
        return cls(
            np.array([row.key for row in rows], dtype=np.int64).reshape(-1, 2),
            np.array([names.setdefault(row.group, len(names)) for row in rows], dtype=np.int64),
            tuple(names),
            np.array([STATUSES.index(row.status) for row in rows], dtype=np.int8),
            np.array(
                [[getattr(row, name) for row in rows] for name in NUMBERS],
                dtype=np.float64,  # None becomes NaN
            ).reshape(len(NUMBERS), len(rows)),
        )

    def __len__(self) -> int:
        return len(self.keys)

    @overload
    def __getitem__(self, index: int) -> PairErrors: ...
    @overload
    def __getitem__(self, index: slice) -> ErrorTable: ...
    def __getitem__(self, index: int | slice) -> PairErrors | ErrorTable:
        if isinstance(index, slice):
            return self.take(np.arange(len(self))[index])
        return next(iter(self.take(np.arange(len(self))[[index]])))

    def __iter__(self) -> Iterator[PairErrors]:
        columns = [self.numbers[i].tolist() for i in range(len(self.numbers))]
        optional = [[None if v != v else v for v in column] for column in columns[len(_ERRORS) :]]
        for row in zip(
            *self.keys.T.tolist(), self.groups, self.statuses, *columns[: len(_ERRORS)], *optional, strict=True
        ):
            yield PairErrors(*row)

    @property
    def groups(self) -> list[str]:
        """(N,) the group of each row."""
        return [self.group_names[i] for i in self.group_index.tolist()]

    @property
    def statuses(self) -> list[str]:
        """(N,) the status of each row."""
        return [STATUSES[i] for i in self.status_index.tolist()]

    @cached_property
    def errors(self) -> PoseErrors:
        """The three errors of each row."""
        return PoseErrors(*self.numbers[: len(_ERRORS)])

    def column(self, name: str) -> Array:
        """(N,) a column of numbers by name, NaN where a row has none."""
        out: Array = self.numbers[NUMBERS.index(name)]
        return out

    def with_status(self, status: str) -> int:
        """The number of rows with that status."""
        return int(np.count_nonzero(self.status_index == STATUSES.index(status)))

    def of_group(self, group: str) -> ErrorTable:
        """The rows of one group; those of all pairs of one place for the group ``all``."""
        if group == ALL and ELSEWHERE not in self.group_names:
            return self
        if group not in self._of_groups:
            wanted = [name != ELSEWHERE if group == ALL else name == group for name in self.group_names]
            self._of_groups[group] = self.take(np.flatnonzero(np.array(wanted, dtype=bool)[self.group_index]))
        return self._of_groups[group]

    @cached_property
    def _of_groups(self) -> dict[str, ErrorTable]:
        """The groups that were selected before."""
        return {}

    @cached_property
    def summary(self) -> PairSetSummary:
        """Every metric over the rows. Raises DatasetError where there is none."""
        return summarize_scores(self.scores)

    @cached_property
    def scores(self) -> PairScores:
        """What metrics are computed from."""
        columns: dict[str, Any] = {name: self.column(name) for name in FLOATS}
        return PairScores(self.errors, **columns, query_ns=self.keys[:, 1])

    @property
    def different_places(self) -> DifferentPlaces:
        """What the method did with the pairs of different places among the rows."""
        rows = self.of_group(ELSEWHERE)
        return DifferentPlaces.of(within(rows.errors, *CORRECT), rows.errors.answered, rows.column("confidence"))

    def take(self, rows: Indices) -> ErrorTable:
        """The rows at these indices, in this order."""
        return ErrorTable(
            self.keys[rows],
            self.group_index[rows],
            self.group_names,
            self.status_index[rows],
            np.take(self.numbers, rows, axis=1),
        )

    def by_time(self) -> ErrorTable:
        """The rows ordered by reference time, then query time."""
        order = np.lexsort((self.keys[:, 1], self.keys[:, 0]))
        return self if np.array_equal(order, np.arange(len(self))) else self.take(order)

    def texts(self) -> list[list[Any]]:
        """The columns as texts, in the order of the file; floats with all their digits."""
        values = [[repr(v) for v in column.tolist()] for column in self.numbers[: len(_ERRORS)]]
        optional = [["" if v != v else repr(v) for v in column.tolist()] for column in self.numbers[len(_ERRORS) :]]
        return [*self.keys.T.tolist(), self.groups, self.statuses, *values, *optional]


def groups_in(group_names: Sequence[str]) -> list[str]:
    """The groups whose errors are scored: ``all``, then the named groups unless there is only one, which would be all.

    Pairs of different places are not among them.
    """
    named = [name for name in group_names if name and name != ELSEWHERE]
    return [ALL, *named] if len(named) > 1 else [ALL]


def write_errors(path: Path, rows: Sequence[PairErrors]) -> None:
    """Write ``PAIRSET.errors.csv``: one row for each pair of the set; the errors of a failed pair are ``inf``."""
    write_table(path, ERRORS.columns, zip(*ErrorTable.of(rows).texts(), strict=True))


def read_errors(path: Path) -> ErrorTable:
    """Read ``PAIRSET.errors.csv``.

    Raises:
        PredictionError: with file and line: a wrong column, a number or status that is not valid.
    """
    parts = []
    for lines, rows in ERRORS.chunks(path):
        part = _fast(list(zip(*rows, strict=True)))
        if part is None:
            part = ErrorTable.of([ERRORS.row(path, line, texts) for line, texts in zip(lines, rows, strict=True)])
        parts.append(part)
    return _joined(parts)


def _joined(parts: Sequence[ErrorTable]) -> ErrorTable:
    """The rows of all parts, one after the other."""
    if len(parts) < 2:
        return parts[0] if parts else ErrorTable.of([])
    names: dict[str, int] = {}
    groups = []
    for part in parts:
        of_part = [names.setdefault(name, len(names)) for name in part.group_names]
        groups.append(np.array(of_part, dtype=np.int64)[part.group_index])
    return ErrorTable(
        np.concatenate([part.keys for part in parts]),
        np.concatenate(groups),
        tuple(names),
        np.concatenate([part.status_index for part in parts]),
        np.concatenate([part.numbers for part in parts], axis=1),
    )


def _fast(columns: Sequence[Sequence[str]]) -> ErrorTable | None:
    """The table of whole columns; None where a field needs a closer look."""
    times = "".join(columns[0]) + "".join(columns[1])
    if not (times.isascii() and times.isdecimal()) or not set(columns[3]) <= set(STATUSES):
        return None
    try:
        keys = np.array([list(map(int, texts)) for texts in columns[:2]], dtype=np.int64).T
        numbers = np.array(
            [
                [float(text) if text else math.nan for text in texts] if "" in texts else list(map(float, texts))
                for texts in columns[4:]
            ],
            dtype=np.float64,
        )
    except (ValueError, OverflowError):
        return None
    blanks = sum(texts.count("") for texts in columns[7:])
    infinite = sum(columns[4 + index].count("inf") for index in _MAY_BE_INFINITE)
    odd = np.count_nonzero(~np.isfinite(numbers))
    if odd != blanks + infinite or np.isnan(numbers[:3]).any() or (numbers[_MAY_BE_INFINITE] < 0).any():
        return None
    names: dict[str, int] = {}
    groups = np.array([names.setdefault(name, len(names)) for name in columns[2]], dtype=np.int64)
    statuses = np.array(list(map(STATUSES.index, columns[3])), dtype=np.int8)
    return ErrorTable(keys, groups, tuple(names), statuses, numbers)
