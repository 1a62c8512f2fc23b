"""The results folder: predictions, run records and scores of one or more datasets.

For each pair set, ``RESULTS/DATASET@FINGERPRINT/METHOD/`` holds the predictions (``PAIRSET.txt``), a table of how each
answer came about (``PAIRSET.csv``), the matching quality where that was requested (``PAIRSET.matching.csv``) and, once
scored, a table of each pair's errors (``PAIRSET.errors.csv``). ``run.yaml`` and ``scores.yaml`` describe the method;
``dataset.yaml`` beside the methods describes the dataset's pair sets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import distances_and_angles
from relocbench.datasets.core.schema import Fingerprint, FolderName, JoinedName, Label, Name, Strict
from relocbench.errors import PredictionError
from relocbench.evaluation.common.folders import AnswerFolder, SetFolder, checked_unit, folders_with
from relocbench.files import (
    did_you_mean,
    dump_yaml,
    load_yaml,
    read_bytes,
    remove_parts,
    write_text,
)
from relocbench.methods.specs import MOST_ASSUMED
from relocbench.retrieval import RetrievalSet

PREDICTIONS = "predictions:"
"""prefix of the target of predictions that were made elsewhere"""

Count = Annotated[int, Field(ge=0, le=10**15)]
"""a number of things"""


class PairSetRecord(Strict):
    """What a leaderboard must know about a pair set when the dataset is not available."""

    reference: Name
    query: Name
    camera: Name
    """of the queries"""
    reference_camera: Name | None = None
    """of the keyframes; None where it is the queries'"""
    reference_condition: str
    query_condition: str
    pairs: Count
    """of one place"""
    elsewhere: Count = 0
    """pairs of different places"""
    rejected: Count
    has_truth: bool
    groups: tuple[str, ...] = ()
    median_distance_m: float | None = None
    median_angle_deg: float | None = None
    median_sigma_translation_m: float | None = None
    median_sigma_rotation_deg: float | None = None

    @model_serializer(mode="wrap")
    def _without_usual_camera(self, usual: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Records of sets of one camera are written as earlier versions did."""
        values: dict[str, Any] = usual(self)
        if self.reference_camera is None:
            values.pop("reference_camera", None)
        return values

    @property
    def asked(self) -> int:
        """The number of pairs that methods answer."""
        return self.pairs + self.elsewhere


class DatasetRecord(Strict):
    """``RESULTS/DATASET@FINGERPRINT/dataset.yaml``."""

    name: FolderName
    fingerprint: Fingerprint
    question: str = ""
    """the content id, equal on all processors; empty in results of versions that did not record it"""
    licence: str
    splits: dict[Name, tuple[JoinedName, ...]] = Field(default_factory=dict)
    pair_sets: dict[JoinedName, PairSetRecord]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the pair sets."""
        return tuple(self.pair_sets)

    @property
    def compared_by(self) -> str:
        """The content id, or the fingerprint where none is recorded: results with the same value are compared."""
        return self.question or self.fingerprint


class RunRecord(Strict):
    """``run.yaml``: how the predictions of one method were made."""

    method: Label
    target: str
    parameters: dict[str, Any] = Field(default_factory=dict)
    files: dict[str, str] = Field(default_factory=dict)
    """SHA-256 of the files that affect the answers, such as weights, by parameter"""
    assumes: str = Field(default="", max_length=MOST_ASSUMED)
    """what the method says that it assumes of how cameras move, in a few words"""
    seed: int | None = None
    dataset: FolderName
    fingerprint: Fingerprint
    question: str = ""
    """of the dataset: a digest of what it asks, equal on all processors"""
    answered_on: str = ""
    """of predictions made elsewhere on another copy of the dataset: the fingerprint of that copy"""
    versions: dict[str, str] = Field(default_factory=dict)
    machine: dict[str, Any] = Field(default_factory=dict)
    workers: int | None = None
    isolated: bool | None = None
    """whether the method ran in a process without dataset and truth; None where that is not known"""
    sandbox: str = ""
    """what kept its process from the rest of the system: namespaces, bubblewrap or none; empty if that is not known"""
    one_core: bool = False
    """whether all of it ran on a single core, one pair at a time"""
    uses_times: bool = False
    """whether the method was shown the times of images, as it declared to need"""
    made_elsewhere: bool = False
    """whether the predictions were made elsewhere and imported; nothing in the record was verified"""
    answered_blind: str = ""
    """of submitted predictions: the blind export of the dataset that was answered; empty where times were visible"""
    submitted: dict[str, str] = Field(default_factory=dict)
    """of submitted predictions: SHA-256 of the files as they were handed in, ``card.yaml`` among them"""
    remarks: tuple[str, ...] = ()
    """of submitted predictions: what is odd about them, for a reader to judge"""
    start: str = ""
    end: str = ""

    @classmethod
    def on(cls, asked: Dataset | RetrievalSet, **fields: Any) -> Self:
        """The record of a run on a dataset or a retrieval set, with the other fields as given."""
        question = getattr(asked, "content_id", "")
        return cls(dataset=asked.name, fingerprint=asked.fingerprint, question=question, **fields)


class ScoreRecord(Strict):
    """``scores.yaml``: the summary of each pair set (and group), and digests of all that it was computed from."""

    relocbench: str
    formulas: Count = 0
    """version of the formulas of the scores; 0 where an earlier version did not record it"""
    fingerprint: str = ""
    """of the dataset whose truth the predictions were compared with"""
    question: str = ""
    """of the same dataset: a digest of what it asks, equal on all processors"""
    run: str = ""
    """SHA-256 of ``run.yaml``"""
    predictions: dict[JoinedName, str]
    """pair set -> SHA-256 of the prediction file and its table"""
    errors: dict[JoinedName, str] = Field(default_factory=dict)
    """pair set -> SHA-256 of ``PAIRSET.errors.csv``"""
    truth: dict[JoinedName, str] = Field(default_factory=dict)
    """pair set -> SHA-256 of the dataset's pair file and its table"""
    pair_sets: dict[JoinedName, dict[str, dict[str, float | int | None]]]
    """pair set -> group ('all' for the whole) -> metric -> value"""
    elsewhere: dict[JoinedName, dict[str, float | int | None]] = Field(default_factory=dict)
    """of pair sets with pairs of different places: how many there are, and how many are answered, and confidently"""
    matching: dict[JoinedName, dict[str, dict[str, dict[str, float | int | None]]]] = Field(default_factory=dict)
    """where it was measured, pair set -> group -> start offset ('all', '1px', ...) -> matching quality"""
    matching_tables: dict[JoinedName, str] = Field(default_factory=dict)
    """where it was measured, pair set -> SHA-256 of ``PAIRSET.matching.csv``"""


@dataclass(frozen=True)
class MethodResults(AnswerFolder):
    """The folder of one method."""

    def errors(self, pair_set: str) -> Path:
        return self.root / f"{checked_unit(pair_set)}.errors.csv"

    def matching(self, pair_set: str) -> Path:
        """The table of matching quality, which exists only where that was requested."""
        return self.root / f"{checked_unit(pair_set)}.matching.csv"

    def matching_journal(self, pair_set: str) -> Path:
        """The journal of matching quality, as :meth:`journal`."""
        return self.root / ".journal-matching" / checked_unit(pair_set)

    def journal(self, pair_set: str) -> Path:
        """The folder that workers append to while they run; it is removed when the pair set is complete."""
        return self.root / ".journal" / checked_unit(pair_set)

    def complete(self, pair_set: str) -> bool:
        """Whether the run of a pair set is complete."""
        return self.predictions(pair_set).exists() and self.answers(pair_set).exists()

    def run_record(self) -> RunRecord:
        """Read ``run.yaml``. Raises PredictionError with file and line."""
        return load_yaml(self.run_yaml, RunRecord, "the record of a run", PredictionError)

    def score_record(self) -> ScoreRecord:
        """Read ``scores.yaml``. Raises PredictionError with file and line."""
        return load_yaml(self.scores_yaml, ScoreRecord, "the scores of a method", PredictionError)


@dataclass(frozen=True)
class DatasetResults(SetFolder[DatasetRecord, MethodResults]):
    """The folder of one dataset: ``NAME@FINGERPRINT``."""

    FILE = "dataset.yaml"
    WHAT = "the record of a dataset"
    UNIT = "pair set"
    RECORD = DatasetRecord
    METHOD = MethodResults

    @property
    def record(self) -> DatasetRecord:
        """The content of ``dataset.yaml``. Raises PredictionError with file and line."""
        if (self.root / "manifest.csv").exists():
            raise PredictionError("is a dataset; expected a results folder of the evaluate commands", self.root)
        record = super().record
        unknown = [name for names in record.splits.values() for name in names if name not in record.pair_sets]
        if unknown:
            raise PredictionError(f"a split names the pair set '{unknown[0]}', which is not there", self.record_file)
        return record


def dataset_results(results: Path, dataset: Dataset) -> DatasetResults:
    """The folder for a dataset's results; nothing is created."""
    return DatasetResults(results / f"{dataset.name}@{dataset.fingerprint[:SHORT]}")


def write_dataset_record(folder: DatasetResults, dataset: Dataset) -> None:
    """Write ``dataset.yaml``, which describes the dataset to leaderboards."""
    write_record(folder.root / "dataset.yaml", dataset_record(dataset))


def write_record(path: Path, record: Strict) -> None:
    """Write a record whole or not at all, unless the file has the same content already.

    Unfinished files that killed runs left in its folder are removed.
    """
    remove_parts(path.parent, deep=False)
    text = dump_yaml(record.model_dump(mode="json"))
    if not path.exists() or read_bytes(path, "a record", PredictionError) != text.encode():
        write_text(path, text)


def first_crash(label: str, what: str, crashed: Sequence[tuple[object, str]]) -> list[tuple[str, str]]:
    """The label and a message on what broke a method, with the first case; nothing where nothing broke it.

    Args:
        what: how it crashed, and on how many cases.
        crashed: each case with the method's message.
    """
    if not crashed:
        return []
    place, message = crashed[0]
    return [(label, f"{what}; first on {place}: {message}")]


def check_made_for(run: RunRecord, dataset: str, fingerprint: str, path: Path) -> None:
    """Raise PredictionError unless a run was made for the dataset with that fingerprint."""
    if run.fingerprint != fingerprint:
        raise PredictionError(
            f"predictions are for {run.dataset}@{run.fingerprint[:SHORT]}, "
            f"the dataset is {dataset}@{fingerprint[:SHORT]}",
            path,
        )


def all_results(results: Path) -> list[DatasetResults]:
    """Every dataset's folder below a results folder. Raises PredictionError where there is none."""
    if not results.is_dir():
        raise PredictionError("no such folder; expected results of the evaluate commands", results)
    folders = list(map(DatasetResults, folders_with("dataset.yaml", results)))
    if not folders:
        other = did_you_mean(results, lambda folder: any(folder.glob("*@*/dataset.yaml")))
        raise PredictionError(f"holds no results (expected DATASET@FINGERPRINT folders){other}", results)
    return folders


def dataset_record(dataset: Dataset) -> DatasetRecord:
    """What leaderboards know of a dataset. Raises DatasetError for a bad file of it."""
    return DatasetRecord(
        name=dataset.name,
        fingerprint=dataset.fingerprint,
        question=dataset.content_id,
        licence=dataset.file.licence,
        splits=dict(dataset.splits),
        pair_sets={s.name: _pair_set_record(dataset, s) for s in dataset.pair_sets()},
    )


def _pair_set_record(dataset: Dataset, pair_set: PairSet) -> PairSetRecord:
    pairs = pair_set.pairs
    between = distances_and_angles(pairs)
    return PairSetRecord(
        reference=pair_set.reference,
        query=pair_set.query,
        camera=pair_set.query_camera,
        reference_camera=pair_set.reference_camera if pair_set.reference_camera != pair_set.query_camera else None,
        reference_condition=str(dataset.traversal(pair_set.reference).condition),
        query_condition=str(dataset.traversal(pair_set.query).condition),
        pairs=len(pairs),
        elsewhere=len(pair_set.negative_pairs),
        rejected=len(pair_set.rejected),
        has_truth=pair_set.has_truth,
        groups=tuple(dict.fromkeys(p.group for p in pairs if p.group)),
        median_distance_m=rounded_median([distance for distance, _ in between]),
        median_angle_deg=rounded_median([angle for _, angle in between]),
        median_sigma_translation_m=rounded_median([p.calibrated_sigmas[0] for p in pairs]),
        median_sigma_rotation_deg=rounded_median([p.calibrated_sigmas[1] for p in pairs]),
    )


def rounded_median(values: Sequence[float | None] | Array) -> float | None:
    """The median of the finite values, to six decimals; None counts as NaN, and without a value it is None."""
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    return round(float(np.median(known)), 6) if known.size else None
