"""The datasets whose truth is at hand when results are read: those that were named, and those beside the results.

A dataset is that of the results if it has their fingerprint. One with the same question is a copy, from another
processor: its poses are equal to a millionth.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.errors import ConfigError, DatasetError, PredictionError, RelocbenchError
from relocbench.evaluation.common.opening import check_whole
from relocbench.evaluation.common.results import DatasetRecord, dataset_record
from relocbench.progress import Reporter, Silent

_MEDIANS = (
    "median_distance_m",
    "median_angle_deg",
    "median_sigma_translation_m",
    "median_sigma_rotation_deg",
)


@dataclass(frozen=True, eq=False)
class Truth:
    """A dataset that was checked, and what it is to the results."""

    dataset: Dataset
    copy: bool
    """whether it only asks the same question, with another fingerprint"""


class DatasetsAtHand:
    """The datasets of a results folder, each opened and checked when it is first asked for."""

    def __init__(self, results: Path, given: Sequence[Path] = (), reporter: Reporter | None = None) -> None:
        """Look for datasets.

        Args:
            results: the results folder, or one of its ``DATASET@FINGERPRINT`` folders. Datasets among the folders
                beside the results folder are used without being named.
            given: datasets, or folders with datasets in them.
            reporter: receives a note where a dataset beside the results is damaged and not used.

        Raises:
            DatasetError: a folder of ``given`` neither is a dataset nor holds one.
        """
        self._reporter = reporter or Silent()
        self._named: list[Dataset] = []
        self._given: list[Dataset] = []
        for folder in given:
            alone = not folder.is_dir() or _looks_like_dataset(folder)
            found = [Dataset(folder)] if alone else _inside(folder)
            self._given += found
            self._named += found if alone else []
        self._beside = list(_beside(results))
        self._used: set[Dataset] = set()

    def of(self, record: DatasetRecord, path: Path) -> Truth | None:
        """The dataset that results belong to; None where it is not at hand.

        Args:
            record: what the results folder says of the dataset.
            path: the file of that record, for messages.

        Raises:
            DatasetError: a dataset that was named is damaged.
            PredictionError: the record is not what the dataset says.
        """
        for copy in (False, True):
            for dataset in (*self._given, *self._beside):
                if dataset.name == record.name and self._is(dataset, record, copy=copy):
                    check_record(record, dataset, path, copy=copy)
                    self._used.add(dataset)
                    return Truth(dataset, copy)
        return None

    def with_fingerprint(self, name: str, fingerprint: str) -> Dataset | None:
        """The whole dataset of that name and fingerprint; None where it is not at hand.

        Raises:
            DatasetError: a dataset that was named is damaged.
        """
        for dataset in (*self._given, *self._beside):
            if (dataset.name, dataset.fingerprint) == (name, fingerprint) and self._is_whole(dataset):
                self._used.add(dataset)
                return dataset
        return None

    def check_used(self) -> None:
        """Raise ConfigError for a dataset that was named although nothing in the results belongs to it."""
        for dataset in self._named:
            if dataset not in self._used:
                told = f"is {dataset.name}@{dataset.fingerprint[:SHORT]}, of which the results hold nothing"
                raise ConfigError(f"{told}; expected the dataset of results of `relocbench evaluate`", dataset.root)

    def _is(self, dataset: Dataset, record: DatasetRecord, *, copy: bool) -> bool:
        try:
            if copy:
                if not record.question or dataset.question != record.question:
                    return False
            elif dataset.fingerprint != record.fingerprint:
                return False
        except RelocbenchError as bad:
            return self._damaged(dataset, bad)
        return self._is_whole(dataset)

    def _is_whole(self, dataset: Dataset) -> bool:
        try:
            check_whole(dataset)
        except RelocbenchError as bad:
            return self._damaged(dataset, bad)
        return True

    def _damaged(self, dataset: Dataset, bad: RelocbenchError) -> bool:
        """Raise the error if the dataset was named; otherwise note it, and return False."""
        if dataset in self._given:
            raise bad
        self._reporter.note(f"not scored again with {dataset.root}: {bad}")
        return False


def _inside(folder: Path) -> list[Dataset]:
    """The datasets in a folder. Raises DatasetError where there is none."""
    found = [Dataset(path) for path in sorted(folder.iterdir()) if _looks_like_dataset(path)]
    if not found:
        raise DatasetError("expected a dataset, or a folder with datasets in it", folder)
    return found


def _beside(results: Path) -> Iterator[Dataset]:
    """The datasets beside the results folder that can be opened."""
    root = Path(os.path.normpath(results.absolute()))  # where it was named, be it by a link
    if (root / "dataset.yaml").exists():
        root = root.parent
    try:
        folders = sorted(path for path in root.parent.iterdir() if path != root and _looks_like_dataset(path))
    except OSError:
        return
    for folder in folders:
        try:
            yield Dataset(folder)
        except RelocbenchError:  # whatever it is, nobody asked for it
            continue


def _looks_like_dataset(folder: Path) -> bool:
    layout = DatasetLayout(folder)
    try:
        return layout.manifest.is_file() and layout.dataset_yaml.is_file()
    except OSError:
        return False


def check_record(record: DatasetRecord, dataset: Dataset, path: Path, *, copy: bool = False) -> None:
    """Raise PredictionError unless a results folder says of a dataset what the dataset says of itself.

    Args:
        path: the file of that record, for the message.
        copy: whether the dataset only asks the same question; medians may then differ in their last digits.
    """
    expected = dataset_record(dataset)
    told = _first_difference(record, expected, copy=copy)
    if told is not None:
        raise PredictionError(
            f"{told} is not that of the dataset {dataset.name}@{dataset.fingerprint[:SHORT]}; "
            "`relocbench evaluate` writes it again",
            path,
        )


def _first_difference(record: DatasetRecord, expected: DatasetRecord, *, copy: bool) -> str | None:
    """The first entry of a record that differs, in words."""
    for name in ("licence", "splits") if not copy else ("splits",):
        if getattr(record, name) != getattr(expected, name):
            return f"the entry '{name}'"
    if record.question not in ("", expected.question):
        return "the entry 'question'"
    if record.pair_sets.keys() != expected.pair_sets.keys():
        return "the list of pair sets"
    for name, claimed in record.pair_sets.items():
        blank = dict.fromkeys(_MEDIANS)
        true = expected.pair_sets[name]
        if claimed.model_copy(update=blank) != true.model_copy(update=blank):
            return f"the entry of the pair set '{name}'"
        here, there = (np.array([getattr(r, m) for m in _MEDIANS], dtype=np.float64) for r in (claimed, true))
        if not np.allclose(here, there, rtol=0.0, atol=1e-3 if copy else 2e-6, equal_nan=True):
            return f"a median of the pair set '{name}'"
    return None
