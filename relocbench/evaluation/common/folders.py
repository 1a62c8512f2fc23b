"""The folders of results: one a set, ``NAME@FINGERPRINT``, with the record of the set, and in it one a method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from relocbench.errors import PredictionError
from relocbench.files import check_joined_name, check_label, load_yaml


@dataclass(frozen=True)
class AnswerFolder:
    """A folder with a file of predictions and a table of answers for each pair set or task."""

    root: Path

    @property
    def label(self) -> str:
        return self.root.name

    @property
    def run_yaml(self) -> Path:
        return self.root / "run.yaml"

    @property
    def scores_yaml(self) -> Path:
        return self.root / "scores.yaml"

    def predictions(self, asked: str) -> Path:
        return self.root / f"{checked_unit(asked)}.txt"

    def answers(self, asked: str) -> Path:
        return self.root / f"{checked_unit(asked)}.csv"


class SetLike(Protocol):
    """What a leaderboard must know of a set when the dataset is not available."""

    @property
    def name(self) -> str: ...

    @property
    def fingerprint(self) -> str: ...

    @property
    def compared_by(self) -> str:
        """Results with the same value are compared."""
        ...

    @property
    def splits(self) -> Mapping[str, tuple[str, ...]]:
        """Split -> its pair sets or tasks."""
        ...

    @property
    def names(self) -> tuple[str, ...]:
        """Of the pair sets or tasks."""
        ...


S = TypeVar("S", bound=SetLike)
F = TypeVar("F", bound=AnswerFolder)


@dataclass(frozen=True)
class SetFolder(Generic[S, F]):
    """The folder of one set of tasks."""

    root: Path

    FILE: ClassVar[str]
    """name of the record"""
    WHAT: ClassVar[str]
    """what it is, in words"""
    UNIT: ClassVar[str] = "task"
    """what it describes, one by one"""
    RECORD: ClassVar[Any]
    METHOD: ClassVar[Any]

    @property
    def record_file(self) -> Path:
        return self.root / self.FILE

    @property
    def record(self) -> S:
        """The content of the record as it is now. Raises PredictionError with file and line."""
        record: S = load_yaml(self.record_file, self.RECORD, self.WHAT, PredictionError)
        return record

    def method(self, label: str) -> F:
        folder: F = self.METHOD(self.root / label)
        return folder

    def methods(self) -> list[F]:
        """Every method that has a run record, sorted by name. Raises PredictionError for an invalid label."""
        return [self.method(path.parent.name) for path in method_folders(self.root)]


A = TypeVar("A", bound=SetFolder[Any, Any])


def sets_in(results: Path, kind: type[A]) -> list[A]:
    """Every folder of that kind below a results folder; empty where there is none."""
    return [kind(folder) for folder in folders_with(kind.FILE, results)]


def method_folders(root: Path) -> list[Path]:
    """The ``run.yaml`` of every method below a folder, sorted by name. Raises PredictionError for an invalid label."""
    records = sorted(root.glob("*/run.yaml"))
    for path in records:
        try:
            check_label(path.parent.name, "method label")
        except ValueError as bad:
            raise PredictionError(f"the folder's name is not a valid label: {bad}", path.parent) from None
    return records


def result_folders(results: Path) -> list[Path]:
    """The folders of datasets in one of results, of whatever task, as far as there are any yet."""
    return sorted(path for path in results.glob("*@*") if path.is_dir())


def folders_with(record: str, results: Path) -> list[Path]:
    """The results folder itself if it holds that record, else every ``NAME@FINGERPRINT`` folder in it that does."""
    if (results / record).exists():
        return [results]
    return [path.parent for path in sorted(results.glob(f"*@*/{record}"))]


def checked_unit(asked: str) -> str:
    """The checked name of a pair set or task. Raises PredictionError for one that would leave the folder."""
    try:
        return check_joined_name(asked, "name of a pair set or task")
    except ValueError as bad:
        raise PredictionError(str(bad)) from None
