"""Training pairs: all pairs with correspondences in a split of one or several datasets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.core import fingerprint
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.images import as_rgb
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.pairs.correspondence_index import CorrespondenceIndex
from relocbench.errors import ConfigError
from relocbench.training import PairLabel, TrainingPair

TEST_SPLIT = "test"
VALIDATION_SPLIT = "validation"


@dataclass(frozen=True, eq=False)
class _Source:
    """One pair set."""

    root: Path
    camera: str
    label: PairLabel
    index: CorrespondenceIndex


class DatasetPairs:
    """``relocbench.training.TrainingData`` from dataset folders.

    Args:
        datasets: dataset folders.
        split: the split to learn from.

    Raises:
        ConfigError: a dataset is given twice, the split is or shares a traversal with the test split, or it has no
            pairs with correspondences.
        DatasetError: a dataset is bad, or has no such split or no correspondences.
    """

    def __init__(self, datasets: Sequence[Path], split: str = "train") -> None:
        self._fingerprints: dict[str, str] = {}
        self._sources: list[_Source] = []
        self._entries: list[tuple[int, PairKey]] = []
        self._open: dict[tuple[Path, str], Traversal] = {}
        for root in datasets:
            self._add(Dataset(root.resolve()), split)
        if not self._entries:
            raise ConfigError(f"split '{split}' has no pair with correspondences to learn from", datasets[0])

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
        number, key = self._entries[index]
        source = self._sources[number]
        u_ref, u_query, sigma = source.index.read_visible(key)
        return TrainingPair(
            label=source.label,
            image_ref=self._image(source, source.label.traversal_ref, key[0]),
            image_query=self._image(source, source.label.traversal_query, key[1]),
            u_ref=u_ref,
            u_query=u_query,
            sigma_px=sigma,
        )

    def _add(self, dataset: Dataset, split: str) -> None:
        refuse_test_split(dataset, split)
        for fault in fingerprint.faults(dataset.layout, content="text"):
            raise fault
        name = f"{dataset.name}@{dataset.fingerprint[: fingerprint.SHORT]}"
        if name in self._fingerprints:
            raise ConfigError("this dataset is given twice", dataset.root)
        self._fingerprints[name] = dataset.fingerprint
        for pair_set in dataset.pair_sets(split):
            index = CorrespondenceIndex(dataset.layout.correspondence_file(pair_set.name))
            label = PairLabel(
                dataset=name,
                traversal_ref=pair_set.reference,
                traversal_query=pair_set.query,
                camera=pair_set.camera,
                condition_ref=str(dataset.traversal(pair_set.reference).condition),
                condition_query=str(dataset.traversal(pair_set.query).condition),
            )
            self._entries += [(len(self._sources), pair.key) for pair in pair_set.pairs if pair.key in index]
            self._sources.append(_Source(dataset.root, pair_set.camera, label, index))

    def _image(self, source: _Source, traversal: str, timestamp_ns: int) -> NDArray[np.uint8]:
        at = (source.root, traversal)
        if at not in self._open:
            self._open[at] = Traversal(DatasetLayout(source.root).traversal(traversal))
        return as_rgb(self._open[at].image(source.camera, timestamp_ns))


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
