"""A cross-view set as it is asked and learned from: tasks in every direction, and places to train on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from relocbench.datasets.core import images
from relocbench.datasets.cross_view.layout import TRAIN_FOLDERS
from relocbench.errors import DatasetError
from relocbench.metrics.retrieval.relevance import relevance_from_labels
from relocbench.retrieval import Image, ImageView, PlaceData, PlaceImage, RetrievalTask


@dataclass(frozen=True, eq=False)
class Shot:
    """One image and the building it shows."""

    view: ImageView
    label: str
    """its class: the folder's name"""
    condition: str = ""


@dataclass(frozen=True)
class FolderInventory:
    """What one folder of a set holds."""

    folder: str
    classes: int
    images: int
    conditions: str
    """joined by +, where they are known"""


@dataclass(frozen=True, eq=False)
class CrossViewSet:
    """Images of buildings from several views, as a :class:`~relocbench.retrieval.RetrievalSet` and as training data.

    Galleries may hold classes that nobody asks for: these are distractors.
    """

    root: Path
    name: str
    train: Mapping[str, tuple[Shot, ...]]
    """by folder, as ``drone`` or ``google``"""
    queries: Mapping[str, tuple[Shot, ...]]
    """by the first word of a task's name, as ``drone`` or ``4K_drone``"""
    galleries: Mapping[str, tuple[Shot, ...]]
    """by view"""
    fingerprinted: Callable[[], str]
    notes: tuple[str, ...] = field(default=())
    """what a user should know: empty folders, classes both in train and in test"""
    asks: str = ""
    """digest of the recipe of a set that was rendered; empty for others, whose images are what they are"""

    @cached_property
    def fingerprint(self) -> str:
        """A hash of all images and their labels. A set from elsewhere is hashed once, which reads every file."""
        return self.fingerprinted()

    @property
    def question(self) -> str:
        """The same for every copy of a rendered set, whose images differ in last digits from processor to processor."""
        return self.asks or self.fingerprint

    @property
    def train_labels(self) -> tuple[str, ...]:
        """Classes of the train folders, ``google`` included, sorted."""
        return _labels(self.train.values())

    @property
    def test_labels(self) -> tuple[str, ...]:
        """Classes of the test folders, distractors included, sorted."""
        return _labels([*self.queries.values(), *self.galleries.values()])

    @property
    def overlap(self) -> tuple[str, ...]:
        """Classes that are both learned from and tested on: none, in a set that says anything."""
        return tuple(sorted({*self.train_labels} & {*self.test_labels}))

    def inventory(self) -> list[FolderInventory]:
        """Folder by folder."""
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
        """Every direction for which there are queries and a gallery of another view, as ``drone-satellite``.

        Args:
            by_condition: where queries are of several conditions, a task for each as well, ``drone-satellite__Rain``.

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
                "nothing to ask: no test/query_VIEW with a test/gallery_ of another view"
                + ("; it is a set to train on" if self.train else ""),
                self.root,
            )
        return tuple(found)

    def training(self, *, google: bool = False) -> PlaceData:
        """The train folders as places to learn from.

        Args:
            google: let the images of ``train/google`` join those of the street.

        Raises:
            DatasetError: there are no train folders.
        """
        folders = [name for name in self.train if google or name != "google"]
        places = {label: k for k, label in enumerate(_labels(self.train[name] for name in folders))}
        if not places:
            raise DatasetError(
                f"nothing to learn from: no images in train/{{{','.join(n for n in TRAIN_FOLDERS)}}}; "
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
    """Images by the keys of each class, in order of the classes' names."""
    known, contents = conditions or {}, digests or {}
    return tuple(
        Shot(ImageView(key, view, partial(read_rgb, root / key), contents.get(key, "")), label, known.get(key, ""))
        for label, keys in sorted(classes.items())
        for key in keys
    )


def read_rgb(path: Path) -> Image:
    """(H, W, 3). Raises DatasetError naming the file."""
    image = images.read_image(path)
    return image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)


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
