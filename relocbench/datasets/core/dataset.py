"""A dataset in memory: traversals, keyframes and pairs, read from disk on demand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path

from relocbench.datasets.core import content_id, fingerprint
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.schema import DatasetFile
from relocbench.datasets.core.traversal import Traversal
from relocbench.errors import DatasetError, available
from relocbench.files import did_you_mean, load_yaml
from relocbench.tracking import Query, Reference


class Dataset:
    """A dataset folder.

    Raises:
        DatasetError: the folder is not a dataset, its build was not finished, or its manifest does not match its
            fingerprint.
    """

    def __init__(self, root: Path | str) -> None:
        self.root = Path(root)
        self.layout = DatasetLayout(self.root)
        if not self.root.is_dir():
            raise DatasetError("no such folder; expected a dataset", self.root)
        if not self.layout.dataset_yaml.exists():
            if self.layout.build_yaml.exists():
                raise DatasetError("the build was not finished; run it again", self.root)
            other = did_you_mean(self.root, lambda folder: DatasetLayout(folder).manifest.exists())
            raise DatasetError(f"expected a dataset with dataset.yaml{other}", self.root)
        self.file = load_yaml(self.layout.dataset_yaml, DatasetFile, "a dataset description", DatasetError)
        fingerprint.check_manifest(self.layout, self.file)
        self._pair_sets: dict[str, PairSet] = {}
        self._traversals: dict[str, Traversal] = {}

    @property
    def name(self) -> str:
        return self.file.name

    @property
    def fingerprint(self) -> str:
        return self.file.fingerprint

    @cached_property
    def content_id(self) -> str:
        """SHA-256 of the recipe, rigs, poses and pairs, the same on every processor; see ``content_id_of``.

        Raises:
            DatasetError: a file of the dataset is bad.
        """
        traversals = {name: self.traversal(name) for name in self.traversal_names}
        pair_sets = {name: self.pair_set(name) for name in self.pair_set_names}
        return content_id.content_id_of(self.file, traversals, pair_sets)

    @property
    def splits(self) -> Mapping[str, tuple[str, ...]]:
        return self.file.splits

    @cached_property
    def traversal_names(self) -> list[str]:
        folder = self.layout.traversals
        return sorted(p.name for p in folder.iterdir() if p.is_dir()) if folder.is_dir() else []

    @cached_property
    def pair_set_names(self) -> list[str]:
        return sorted(p.stem for p in self.layout.pairs.glob("*.txt"))

    def traversal(self, name: str) -> Traversal:
        """One traversal, read on demand. Raises DatasetError on an unknown name."""
        if name not in self._traversals:
            if name not in self.traversal_names:
                raise DatasetError(f"no traversal '{name}'{available(name, self.traversal_names)}", self.root)
            self._traversals[name] = Traversal(self.layout.traversal(name))
        return self._traversals[name]

    def pair_set(self, name: str) -> PairSet:
        """One pair set, read on demand. Raises DatasetError on an unknown name."""
        if name not in self.pair_set_names:
            raise DatasetError(f"no pair set '{name}'{available(name, self.pair_set_names)}", self.root)
        if name not in self._pair_sets:
            self._pair_sets[name] = PairSet(self.layout, name)
        return self._pair_sets[name]

    def pair_sets(self, split: str | None = None) -> list[PairSet]:
        """All pair sets in the order of the splits, or those of one split. Raises DatasetError on an unknown split."""
        if split is None:
            of_splits = [name for names in self.splits.values() for name in names if name in self.pair_set_names]
            return [self.pair_set(name) for name in dict.fromkeys([*of_splits, *self.pair_set_names])]
        if split not in self.splits:
            raise DatasetError(f"no split '{split}'{available(split, self.splits)}", self.layout.dataset_yaml)
        return [self.pair_set(name) for name in self.splits[split]]

    def has_images(self, pair_set: PairSet) -> bool:
        """Whether the pairs of a set are of images, and not of poses alone.

        Raises:
            DatasetError: the description of a traversal is bad or missing.
        """
        drives = self.traversal(pair_set.reference), self.traversal(pair_set.query)
        return not any(camera in drive.frames for camera, drive in zip(pair_set.cameras, drives, strict=True))

    def require_images(self, pair_sets: Iterable[PairSet], instead: str) -> None:
        """Check that pairs are of images, for what cannot be done without.

        Args:
            instead: what cannot be done, and what can.

        Raises:
            DatasetError: a pair set is of poses alone.
        """
        bare = [pair_set.name for pair_set in pair_sets if not self.has_images(pair_set)]
        if bare:
            whole = len(bare) == len(self.pair_set_names)
            message = "this dataset has no images" if whole else f"there are no images of {', '.join(bare)}"
            raise DatasetError(f"{message}: {instead}", self.root)

    def reference(self, pair_set: PairSet, pair: Pair, neighbours: int = 0) -> Reference:
        """The tracker's view of a pair's keyframe."""
        traversal = self.traversal(pair_set.reference)
        return traversal.reference(pair_set.reference_camera, pair.ref_timestamp_ns, neighbours)

    def query(self, pair_set: PairSet, pair: Pair) -> Query:
        """The tracker's view of a pair's query."""
        return self.traversal(pair_set.query).query(pair_set.query_camera, pair.query_timestamp_ns)
