"""The folder of one set of tasks below a results folder, ``NAME@FINGERPRINT``: its record, and a folder a method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import AnswerFolder, folders_with, method_folders
from relocbench.files import load_yaml


class TaskLike(Protocol):
    """What a leaderboard must know of a task when the images are not available."""

    @property
    def queries(self) -> int: ...


class SetLike(Protocol):
    """What a leaderboard must know of a set of tasks."""

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
        """Split -> tasks."""
        ...

    @property
    def tasks(self) -> Mapping[str, TaskLike]: ...


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
