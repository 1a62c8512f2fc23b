"""What a task brings to a submission: its datasets, the answers to one of them, and the row that they become.

``tracked.py`` is the task of trackers, ``ranked.py`` that of retrievers; checking and adding know only what is here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from relocbench.datasets.checks.faults import Findings
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.salt import Salt
from relocbench.errors import ConfigError, PredictionError, available
from relocbench.evaluation.common.blind_names import BlindName
from relocbench.evaluation.common.results import MethodResults, RunRecord
from relocbench.evaluation.retrieval.opening import SetOptions
from relocbench.evaluation.submission.card import Answered
from relocbench.evaluation.submission.folder import RUN, answer_files
from relocbench.evaluation.submission.resolving import ResolvedDataset, ResolvedRetrievalSet
from relocbench.files import load_yaml
from relocbench.progress import Reporter

Record = TypeVar("Record", bound=RunRecord)


@dataclass(frozen=True)
class SubmissionOptions:
    """What a submission is checked against."""

    datasets: tuple[Path, ...]
    blind_only: bool = False
    """whether only answers to blind exports are taken"""
    retrieval: SetOptions = field(default_factory=SetOptions)
    """which images are right, for lists of images along drives"""
    salt: Salt | None = None
    """of answered blind exports, where the datasets are those that they were made of"""


@dataclass(kw_only=True)
class UnitAnswers(ABC):
    """What was submitted for a pair set or a task, in numbers."""

    given: bool = False
    """whether there is a file of answers"""
    unknown: int = 0
    duplicate: int = 0
    invalid: int = 0
    """lines that cannot be read, or do not hold a valid answer"""

    @property
    @abstractmethod
    def name(self) -> str:
        """Of the pair set or task."""

    @property
    @abstractmethod
    def asked(self) -> int:
        """Number of pairs or queries."""

    @property
    @abstractmethod
    def answered(self) -> int:
        """Number of those that have an answer."""

    @property
    def missing(self) -> int:
        return self.asked - self.answered

    @abstractmethod
    def oddities(self) -> Iterator[str]:
        """What is odd about the answers, one sentence each."""


@dataclass(frozen=True, eq=False)
class AnsweredDataset(ABC):
    """The answers to one dataset."""

    record_file: ClassVar[str]
    """name of the file of a results folder that describes a dataset"""
    folder: Path
    """of the submission"""
    units: Sequence[UnitAnswers]
    """every pair set or task, whether it is answered or not"""
    resolved: ResolvedDataset | ResolvedRetrievalSet

    @property
    def blind_export(self) -> BlindName | None:
        """The blind export that was answered; None for the dataset itself."""
        return None if self.resolved.blind is None else self.resolved.blind.name

    @abstractmethod
    def home(self, results: Path) -> Path:
        """The dataset's folder in a results folder. Raises ConfigError where its truth is withheld."""

    @abstractmethod
    def write_row(self, home: Path, made: Path, label: str) -> MethodResults:
        """Write the record of the dataset and the answers to a folder that becomes, or joins, the dataset's home."""

    @abstractmethod
    def run_record(self, fields: dict[str, Any]) -> RunRecord:
        """The record of the row; ``fields`` are those of all tasks."""

    @abstractmethod
    def score(self, row: MethodResults) -> None:
        """Score a row that was written."""

    def same_as_others(self, home: Path, label: str) -> Iterator[str]:
        """Sentences on the other rows of a dataset's folder that gave most of the same answers."""
        return iter(())


class SubmissionTask(ABC):
    """The datasets that were named, opened for a task.

    Args:
        root: the submission.

    Raises:
        DatasetError, ConfigError: a dataset is bad, or an option does not fit.
    """

    @abstractmethod
    def __init__(self, root: Path, options: SubmissionOptions, reporter: Reporter) -> None: ...

    @abstractmethod
    def read(self, folder: Path, answered: Answered, findings: Findings) -> AnsweredDataset:
        """Read the answers to the dataset whose name the folder has.

        Args:
            answered: what the card says of it.

        Raises:
            PredictionError: that none of the datasets is answered, without a path; or a fault of the whole folder.
        """


def files_of_units(folder: Path, unit: str, names: Sequence[str], what: str, findings: Findings) -> dict[str, Path]:
    """The files of answers, by pair set or task; faults where there is none, or one of another name."""
    files = {path.stem: path for path in answer_files(folder)}
    for stem, path in files.items():
        if stem not in names:
            findings.fault(f"no {unit} '{stem}' in {folder.name}{available(stem, names)}", path)
    if files.keys().isdisjoint(names):
        findings.fault(f"holds no {what}", folder)
    return files


def run_beside(folder: Path, of: type[Record], name: str, fingerprint: str, findings: Findings) -> Record | None:
    """The record that a run wrote beside the answers; None where there is none that can be read."""
    path = folder / RUN
    run = None
    with findings.catching():
        if path.exists():
            run = load_yaml(path, of, "the record of a run", PredictionError)
    if run is not None and run.fingerprint != fingerprint:
        findings.fault(f"is of {run.dataset}@{run.fingerprint[:SHORT]}, expected {name}@{fingerprint[:SHORT]}", path)
    return run


def check_blind_only(folder: Path, options: SubmissionOptions, *, is_blind: bool) -> None:
    """Raise PredictionError where only answers to blind exports are taken, and these are to something else."""
    if options.blind_only and not is_blind:
        visible = "where names, times or truth are visible"
        message = f"answers '{folder.name}', {visible}; expected answers to a blind export of it"
        raise PredictionError(message, folder)


def withheld(name: str, place: Path) -> ConfigError:
    """The error of scoring answers whose truth is not available."""
    message = f"the truth of '{name}' is withheld; to score, name the dataset that the export was made of"
    return ConfigError(message, place)
