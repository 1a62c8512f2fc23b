"""The datasets whose truth is available when results are read: those that were named, and those beside the results.

A dataset is that of the results if it has their fingerprint. One with the same content id is a copy, from another
processor: its poses are equal to a millionth. Cross-view sets are found in the same way.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.edition_folder import datasets_of
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.cross_view import CrossViewSet, is_cross_view, open_cross_view
from relocbench.errors import ConfigError, DatasetError, PredictionError, RelocbenchError
from relocbench.evaluation.common.opening import check_whole
from relocbench.evaluation.common.results import DatasetRecord, dataset_record
from relocbench.progress import Reporter, Silent

Opened = TypeVar("Opened")

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
    """whether it only has the same content id, with another fingerprint"""


class DatasetLookup:
    """The datasets of a results folder, each opened and checked when it is first asked for.

    One object serves all boards of a results folder, so that a dataset is checked once, and one that none of them used
    is found out (:meth:`check_used`).
    """

    def __init__(self, results: Path, given: Sequence[Path] = (), reporter: Reporter | None = None) -> None:
        """Look for datasets.

        Args:
            results: the results folder, or one of its ``DATASET@FINGERPRINT`` folders. Datasets and cross-view sets
                among the folders beside the results folder are used without being named.
            given: datasets or cross-view sets, or folders with such in them.
            reporter: receives a note where a dataset beside the results is damaged and not used.

        Raises:
            DatasetError: a folder of ``given`` neither is a dataset nor holds one.
        """
        self._reporter = reporter or Silent()
        self._given: list[Dataset | CrossViewSet] = []
        self._named: list[Dataset | CrossViewSet] = []
        for folder in {path.resolve(): path for path in given}.values():
            alone = not folder.is_dir() or _looks_like_set(folder)
            opened = [_opened(folder)] if alone else _inside(folder)
            self._given += opened
            self._named += opened if alone else []
        beside = _beside(results)
        plain = (_openable(folder, Dataset) for folder in beside if not is_cross_view(folder))
        self._beside = [dataset for dataset in plain if dataset is not None]
        self._folders_of_places = [folder for folder in beside if is_cross_view(folder)]
        """cross-view sets beside the results; listing their images takes a while"""
        self._used: list[Dataset | CrossViewSet] = []
        self._whole: dict[Path, RelocbenchError | None] = {}
        """what is wrong with each dataset that was checked"""
        self._noted: set[Path] = set()

    def of(self, record: DatasetRecord, path: Path) -> Truth | None:
        """The dataset that results belong to; None where it is not available.

        Args:
            record: what the results folder says of the dataset.
            path: the file of that record, for messages.

        Raises:
            DatasetError: a dataset that was named is damaged.
            PredictionError: the record is not what the dataset says.
        """
        name, question = record.name, record.question
        dataset = self.find(lambda one: one.name == name and one.fingerprint == record.fingerprint)
        copy = dataset is None
        if copy and question:
            dataset = self.find(lambda one: one.name == name and one.content_id == question)
        if dataset is None:
            return None
        check_record(record, dataset, path, copy=copy)
        return Truth(dataset, copy)

    def find(self, wanted: Callable[[Dataset], bool]) -> Dataset | None:
        """The first whole dataset that is wanted, which is then used; None where there is none.

        Raises:
            DatasetError: a dataset that was named is damaged.
        """
        given = [one for one in self._given if isinstance(one, Dataset)]
        for dataset in (*given, *self._beside):
            if self._is_wanted(dataset, wanted):
                self._used.append(dataset)
                return dataset
        return None

    def find_cross_view(self, wanted: Callable[[CrossViewSet], bool]) -> CrossViewSet | None:
        """The first cross-view set that is wanted, which is then used; None where there is none.

        Raises:
            DatasetError: a set that was named is damaged.
        """
        given = [one for one in self._given if isinstance(one, CrossViewSet)]
        for places in (*given, *self._cross_view_beside):
            try:
                if wanted(places):
                    self._used.append(places)
                    return places
            except RelocbenchError as bad:
                self._damaged(places, bad)
        return None

    def mark_used(self, is_of: Callable[[Dataset | CrossViewSet], bool]) -> None:
        """Count the named datasets as used that results belong to, although others may be the ones looked at."""
        self._used += [one for one in self._named if is_of(one)]

    @cached_property
    def _cross_view_beside(self) -> list[CrossViewSet]:
        """The cross-view sets beside the results that can be opened; they are when one is first needed."""
        opened = []
        for folder in self._folders_of_places:
            try:
                opened.append(open_cross_view(folder))
            except RelocbenchError as bad:
                self._reporter.note(f"not scored again with {folder}: {bad}")
        return opened

    def check_used(self) -> None:
        """Raise ConfigError for a dataset that was named although nothing in the results belongs to it."""
        for dataset in self._named:
            if not any(dataset is one for one in self._used):
                message = f"is {dataset.name}@{dataset.fingerprint[:SHORT]}, of which the results hold nothing"
                raise ConfigError(f"{message}; expected the dataset that methods were evaluated on", dataset.root)

    def _is_wanted(self, dataset: Dataset, wanted: Callable[[Dataset], bool]) -> bool:
        try:
            return wanted(dataset) and self._is_whole(dataset)
        except RelocbenchError as bad:
            return self._damaged(dataset, bad)

    def _is_whole(self, dataset: Dataset) -> bool:
        if dataset.root not in self._whole:
            try:
                check_whole(dataset)
                self._whole[dataset.root] = None
            except RelocbenchError as bad:
                self._whole[dataset.root] = bad
                return self._damaged(dataset, bad)
        return self._whole[dataset.root] is None

    def _damaged(self, dataset: Dataset | CrossViewSet, bad: RelocbenchError) -> bool:
        """Raise the error if the dataset was named; otherwise note it, and return False."""
        if any(dataset is one for one in self._given):
            raise bad
        if dataset.root not in self._noted:
            self._noted.add(dataset.root)
            self._reporter.note(f"not scored again with {dataset.root}: {bad}")
        return False


def _opened(folder: Path) -> Dataset | CrossViewSet:
    return open_cross_view(folder) if is_cross_view(folder) else Dataset(folder)


def _inside(folder: Path) -> list[Dataset | CrossViewSet]:
    """The datasets in a folder, or of an edition. Raises DatasetError where there is none."""
    inside = [path for path in datasets_of(folder) if path != folder] or sorted(folder.iterdir())
    opened = [_opened(path) for path in inside if _looks_like_set(path)]
    if not opened:
        raise DatasetError("expected a dataset, or a folder with datasets in it", folder)
    return opened


def _beside(results: Path) -> list[Path]:
    """The folders beside the results folder that look like datasets."""
    root = Path(os.path.normpath(results.absolute()))  # the path as given; symlinks are not resolved
    if (root / "dataset.yaml").exists():
        root = root.parent
    try:
        return sorted(path for path in root.parent.iterdir() if path != root and _looks_like_set(path))
    except OSError:
        return []


def _openable(folder: Path, opened: Callable[[Path], Opened]) -> Opened | None:
    """What a folder holds; None where it cannot be opened, for nobody asked for it."""
    try:
        return opened(folder)
    except RelocbenchError:
        return None


def _looks_like_set(folder: Path) -> bool:
    layout = DatasetLayout(folder)
    try:
        return (layout.manifest.is_file() and layout.dataset_yaml.is_file()) or is_cross_view(folder)
    except OSError:
        return False


def check_record(record: DatasetRecord, dataset: Dataset, path: Path, *, copy: bool = False) -> None:
    """Raise PredictionError unless a results folder says of a dataset what the dataset says of itself.

    Args:
        path: the file of that record, for the message.
        copy: whether the dataset only has the same content id; medians may then differ in their last digits.
    """
    expected = dataset_record(dataset)
    difference = _first_difference(record, expected, copy=copy)
    if difference is not None:
        raise PredictionError(
            f"{difference} is not that of the dataset {dataset.name}@{dataset.fingerprint[:SHORT]}; "
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
        recorded_medians, expected_medians = (
            np.array([getattr(r, m) for m in _MEDIANS], dtype=np.float64) for r in (claimed, true)
        )
        if not np.allclose(recorded_medians, expected_medians, rtol=0.0, atol=1e-3 if copy else 2e-6, equal_nan=True):
            return f"a median of the pair set '{name}'"
    return None
