"""A cross-view set: retrieval tasks in every direction, and places to train on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from relocbench.arrays import Image
from relocbench.datasets.core import images
from relocbench.datasets.cross_view.layout import TRAIN_FOLDERS
from relocbench.errors import DatasetError
from relocbench.metrics.retrieval.relevance import relevance_from_labels
from relocbench.retrieval import ImageView, PlaceData, PlaceImage, RetrievalTask


@dataclass(frozen=True, eq=False)
class Shot:
    """One image and the building it shows."""

    view: ImageView
    label: str
    """its class, the folder's name"""
    condition: str = ""


@dataclass(frozen=True)
class FolderInventory:
    """The content of one folder of a set."""

    folder: str
    classes: int
    images: int
    conditions: str
    """known conditions, joined by +"""


@dataclass(frozen=True, eq=False)
class CrossViewSet:
    """Images of buildings from several views, as a :class:`~relocbench.retrieval.RetrievalSet` and as training data.

    Galleries may contain classes without queries, so-called distractors.
    """

    root: Path
    name: str
    train: Mapping[str, tuple[Shot, ...]]
    """by folder, such as ``drone`` or ``google``"""
    queries: Mapping[str, tuple[Shot, ...]]
    """by the first word of a task's name, such as ``drone`` or ``4K_drone``"""
    galleries: Mapping[str, tuple[Shot, ...]]
    """by view"""
    fingerprinted: Callable[[], str]
    notes: tuple[str, ...] = field(default=())
    """notes for the user on empty folders and on classes that are in both train and test"""
    stored_content_id: str = ""
    """content id of a rendered set; empty for other sets, whose images are the same everywhere"""
    made_by: Mapping[str, Any] = field(default_factory=dict)
    """how a rendered set was made, as its ``dataset.yaml`` says; empty for other sets"""
    licence: str = ""
    """of a rendered set"""

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of all images and their labels. For a set from elsewhere this reads every file, once."""
        return self.fingerprinted()

    @property
    def content_id(self) -> str:
        """Digest that is the same for every copy of a rendered set, whose images differ slightly between processors."""
        return self.stored_content_id or self.fingerprint

    @property
    def is_plain(self) -> bool:
        """Whether the set was not rendered here: its name is that of its folder, and it has no copies."""
        return not self.stored_content_id

    @property
    def positives(self) -> str:
        """The relevance rule in words."""
        return "images of the query's place"

    @property
    def options(self) -> dict[str, float | str]:
        """The command-line options that select this set: none."""
        return {}

    @property
    def train_labels(self) -> tuple[str, ...]:
        """Classes of the train folders, including ``google``, sorted."""
        return _labels(self.train.values())

    @property
    def test_labels(self) -> tuple[str, ...]:
        """Classes of the test folders, including distractors, sorted."""
        return _labels([*self.queries.values(), *self.galleries.values()])

    @property
    def overlap(self) -> tuple[str, ...]:
        """Classes that are in both train and test. In a meaningful set there are none."""
        return tuple(sorted({*self.train_labels} & {*self.test_labels}))

    def inventory(self) -> list[FolderInventory]:
        """The content of each folder."""
        folders = {
            **{f"train/{name}": shots for name, shots in self.train.items()},
            **{f"test/query_{name}": shots for name, shots in self.queries.items()},
            **{f"test/gallery_{name}": shots for name, shots in self.galleries.items()},
        }
        return [
            FolderInventory(name, len({s.label for s in shots}), len(shots), _conditions(shots))
            for name, shots in folders.items()
        ]

    def tasks(self, *, by_condition: bool = False) -> Sequence[RetrievalTask]:
        """A task for each direction with queries and a gallery of another view, such as ``drone-satellite``.

        Args:
            by_condition: if queries have several conditions, add a task for each, such as ``drone-satellite__Rain``.

        Raises:
            DatasetError: there is no such direction.
        """
        found = []
        for asked, queries in self.queries.items():
            for view, gallery in self.galleries.items():
                if queries[0].view.view == view:
                    continue
                name = f"{asked}-{view}"
                found.append(_task(name, queries, gallery))
                conditions = sorted({q.condition for q in queries})
                if by_condition and len(conditions) > 1:
                    for one in conditions:
                        found.append(_task(f"{name}__{one}", [q for q in queries if q.condition == one], gallery))
        if not found:
            raise DatasetError(
                "has no task: no test/query_VIEW with a test/gallery_ of another view"
                + ("; it is for training only" if self.train else ""),
                self.root,
            )
        return tuple(found)

    def training(self, *, google: bool = False) -> PlaceData:
        """The images of the train folders as training data.

        Args:
            google: include the images of ``train/google`` as street images.

        Raises:
            DatasetError: there are no training images.
        """
        folders = [name for name in self.train if google or name != "google"]
        places = {label: k for k, label in enumerate(_labels(self.train[name] for name in folders))}
        if not places:
            raise DatasetError(
                f"has nothing to learn from: no images in train/{{{','.join(n for n in TRAIN_FOLDERS)}}}; "
                "relocbench build-dataset cross-view --split train renders some",
                self.root,
            )
        shown = tuple(
            PlaceImage(shot.view, places[shot.label], shot.condition) for name in folders for shot in self.train[name]
        )
        return PlaceData(len(places), shown, ((self.name, self.fingerprint),))


def shots_of(
    root: Path,
    classes: Mapping[str, Iterable[str]],
    view: str,
    conditions: Mapping[str, str] | None = None,
    digests: Mapping[str, str] | None = None,
) -> tuple[Shot, ...]:
    """Shots of the images whose keys are given by class, in order of the classes' names."""
    known, contents = conditions or {}, digests or {}
    return tuple(
        Shot(ImageView(key, view, partial(read_rgb, root / key), contents.get(key, "")), label, known.get(key, ""))
        for label, keys in sorted(classes.items())
        for key in keys
    )


def read_rgb(path: Path) -> Image:
    """Read an image as RGB (H, W, 3). Raises DatasetError naming the file."""
    return images.as_rgb(images.read_image(path))


def _task(name: str, queries: Sequence[Shot], gallery: Sequence[Shot]) -> RetrievalTask:
    number = {label: k for k, label in enumerate(sorted({s.label for s in (*queries, *gallery)}))}
    return RetrievalTask(
        name=name,
        queries=tuple(s.view for s in queries),
        gallery=tuple(s.view for s in gallery),
        relevance=relevance_from_labels([number[s.label] for s in queries], [number[s.label] for s in gallery]),
        condition_query=_conditions(queries),
        condition_gallery=_conditions(gallery),
        groups=tuple(s.label for s in queries),
    )


def _conditions(shots: Sequence[Shot]) -> str:
    return "+".join(sorted({s.condition for s in shots if s.condition}))


def _labels(folders: Iterable[Sequence[Shot]]) -> tuple[str, ...]:
    return tuple(sorted({shot.label for folder in folders for shot in folder}))
