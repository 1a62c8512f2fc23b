"""Training pairs: all pairs of a split of one or several datasets that have correspondences, or a true pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.arrays import Image
from relocbench.datasets.core import fingerprint
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.images import as_rgb
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.pairs.correspondence_file import CorrespondenceIndex
from relocbench.errors import ConfigError, DatasetError
from relocbench.tracking import KeyframePoints
from relocbench.training import PairLabel, PosedPair, TrainingPair, TrainingView

TEST_SPLIT = "test"
VALIDATION_SPLIT = "validation"


@dataclass(frozen=True, eq=False)
class _Source:
    """One pair set."""

    root: Path
    cameras: tuple[str, str]
    """of keyframes and queries"""
    label: PairLabel
    index: CorrespondenceIndex | None
    """None where poses alone are learnt from"""


class DatasetPairs:
    """``relocbench.training.PosedTrainingData`` from dataset folders.

    Args:
        datasets: dataset folders.
        split: the split to learn from.
        correspondences: whether only pairs that have some are learnt from; otherwise all that have a pose are, and none
            is read.

    Raises:
        ConfigError: a dataset is given twice, the split is or shares a traversal with the test split, or it has no
            such pairs.
        DatasetError: a dataset is bad, or has no such split or no correspondences.
    """

    def __init__(self, datasets: Sequence[Path], split: str = "train", *, correspondences: bool = True) -> None:
        self._correspondences = correspondences
        self._fingerprints: dict[str, str] = {}
        self._sources: list[_Source] = []
        self._entries: list[tuple[int, Pair]] = []
        self._images: dict[str, tuple[int, str, str, int]] = {}
        self._open: dict[tuple[Path, str], Traversal] = {}
        for root in datasets:
            dataset = Dataset(root.resolve())
            dataset.require_images(dataset.pair_sets(), "there is nothing to learn from")
            self._add(dataset, split)
        if not self._entries:
            lacking = "correspondences" if correspondences else "a true pose"
            raise ConfigError(f"split '{split}' has no pair with {lacking} to learn from", datasets[0])

    def __len__(self) -> int:
        return len(self._entries)

    def label(self, index: int) -> PairLabel:
        """See ``TrainingData``."""
        return self._sources[self._entries[index][0]].label

    def describe(self) -> Mapping[str, str]:
        """Fingerprints of the datasets by name and short fingerprint."""
        return dict(self._fingerprints)

    def load(self, index: int) -> TrainingPair:
        """See ``TrainingData``."""
        number, pair = self._entries[index]
        source, key = self._sources[number], pair.key
        none = np.zeros((0, 2), dtype=np.float32)
        u_ref, u_query, sigma = source.index.read_visible(key) if source.index else (none, none, None)
        return TrainingPair(
            label=source.label,
            image_ref=self._image(source, source.label.traversal_ref, source.cameras[0], key[0]),
            image_query=self._image(source, source.label.traversal_query, source.cameras[1], key[1]),
            u_ref=u_ref,
            u_query=u_query,
            sigma_px=sigma,
        )

    def posed(self, index: int) -> PosedPair:
        """See ``PosedTrainingData``."""
        number, pair = self._entries[index]
        source = self._sources[number]
        if pair.T_query_ref is None:
            raise DatasetError(
                "the poses of its pairs are withheld, and are what this trainer learns from", source.root
            )
        ref, query = (_name(source.label.dataset, *side) for side in _sides(source, pair))
        return PosedPair(ref, query, pair.T_query_ref)

    def view(self, name: str, *, depth: bool) -> TrainingView:
        """See ``PosedTrainingData``."""
        number, traversal, camera, time = self._images[name]
        source = self._sources[number]
        drive = self._traversal(source, traversal)
        points = drive.reference(camera, time).points if depth else KeyframePoints(np.zeros((0, 2)), *np.zeros((2, 0)))
        return TrainingView(self._image(source, traversal, camera, time), drive.camera(camera, time), points)

    def _add(self, dataset: Dataset, split: str) -> None:
        refuse_test_split(dataset, split)
        for fault in fingerprint.faults(dataset.layout, content="text"):
            raise fault
        name = f"{dataset.name}@{dataset.fingerprint[: fingerprint.SHORT]}"
        if name in self._fingerprints:
            raise ConfigError("this dataset is given twice", dataset.root)
        self._fingerprints[name] = dataset.fingerprint
        for pair_set in dataset.pair_sets(split):
            index = None
            if self._correspondences:
                index = CorrespondenceIndex(dataset.layout.correspondence_file(pair_set.name))
            label = PairLabel(
                dataset=name,
                traversal_ref=pair_set.reference,
                traversal_query=pair_set.query,
                camera=pair_set.query_camera,
                condition_ref=str(dataset.traversal(pair_set.reference).condition),
                condition_query=str(dataset.traversal(pair_set.query).condition),
                camera_ref=pair_set.reference_camera if pair_set.reference_camera != pair_set.query_camera else "",
            )
            source = _Source(dataset.root, pair_set.cameras, label, index)
            kept = [
                pair
                for pair in pair_set.pairs
                if (pair.T_query_ref is not None if index is None else pair.key in index)
            ]
            self._entries += [(len(self._sources), pair) for pair in kept]
            for pair in kept:
                for side in _sides(source, pair):
                    self._images[_name(name, *side)] = len(self._sources), *side
            self._sources.append(source)

    def _image(self, source: _Source, traversal: str, camera: str, timestamp_ns: int) -> Image:
        return as_rgb(self._traversal(source, traversal).image(camera, timestamp_ns))

    def _traversal(self, source: _Source, name: str) -> Traversal:
        at = (source.root, name)
        if at not in self._open:
            self._open[at] = Traversal(DatasetLayout(source.root).traversal(name))
        return self._open[at]


def _sides(source: _Source, pair: Pair) -> tuple[tuple[str, str, int], tuple[str, str, int]]:
    """Traversal, camera and time of a pair's keyframe and of its query."""
    of_keyframes, of_queries = source.cameras
    return (
        (source.label.traversal_ref, of_keyframes, pair.ref_timestamp_ns),
        (source.label.traversal_query, of_queries, pair.query_timestamp_ns),
    )


def _name(dataset: str, traversal: str, camera: str, timestamp_ns: int) -> str:
    """The name of an image of all datasets."""
    return f"{dataset}/{traversal}/{camera}/{timestamp_ns}"


def without_only_validation(datasets: Sequence[Path], split: str) -> list[Path]:
    """The datasets to learn from, without those that have only a validation split (unless none would be left).

    Raises:
        DatasetError: a dataset is bad.
    """
    splits = {root: Dataset(root.resolve()).splits for root in datasets}
    learnt = [root for root in datasets if split in splits[root] or VALIDATION_SPLIT not in splits[root]]
    return learnt or list(datasets)


def refuse_test_split(dataset: Dataset, split: str) -> None:
    """Check that a split may be learnt from: it must not be the test split or contain drives of it.

    Raises:
        ConfigError: the split is the test split or shares a traversal with it.
        DatasetError: there is no such split.
    """
    if split == TEST_SPLIT:
        raise ConfigError("the test split must not be learnt from; build a dataset with --split train", dataset.root)
    chosen = dataset.pair_sets(split)
    if TEST_SPLIT in dataset.splits:
        shared = _traversals(chosen) & _traversals(dataset.pair_sets(TEST_SPLIT))
        if shared:
            raise ConfigError(f"split '{split}' shares traversal '{min(shared)}' with the test split", dataset.root)


def _traversals(pair_sets: Sequence[PairSet]) -> set[str]:
    return {name for pair_set in pair_sets for name in (pair_set.reference, pair_set.query)}
