"""The folders of University-1652's layout and the files in them; images are not opened.

The layout is ``train/VIEW/CLASS/IMAGE``, ``test/query_VIEW/CLASS/IMAGE`` and ``test/gallery_VIEW/CLASS/IMAGE``. A class
is a building; its folder's name is its label.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from relocbench.datasets.core.layout import IMAGE_SUFFIXES
from relocbench.errors import DatasetError

VIEWS = ("drone", "satellite", "street")
TRAIN_FOLDERS = {"drone": "drone", "satellite": "satellite", "street": "street", "google": "street"}
"""folder of ``train`` -> view; ``google`` holds street images found by a search engine"""
QUERY_FOLDERS = {**{f"query_{view}": view for view in VIEWS}, "4K_drone": "drone"}
"""folder of ``test`` -> view; ``4K_drone`` holds the real drone images of the official set"""
GALLERY_FOLDERS = {f"gallery_{view}": view for view in VIEWS}
_MOST_NAMED = 5


@dataclass(frozen=True)
class ClassFolders:
    """The classes of one view folder."""

    folder: str
    """path relative to the root, such as ``test/query_drone``"""
    images: dict[str, tuple[str, ...]]
    """class -> keys of its images, which are their paths relative to the root, sorted"""
    empty: tuple[str, ...]
    """classes whose folder holds no image"""

    @property
    def count(self) -> int:
        """Number of images."""
        return sum(map(len, self.images.values()))


@dataclass(frozen=True)
class ViewFolders:
    """The view folders that a set has."""

    train: dict[str, ClassFolders]
    """by the folder's name, such as ``drone`` or ``google``"""
    queries: dict[str, ClassFolders]
    """by the folder's name, such as ``query_drone``"""
    galleries: dict[str, ClassFolders]

    @property
    def all(self) -> tuple[ClassFolders, ...]:
        return (*self.train.values(), *self.queries.values(), *self.galleries.values())

    @property
    def keys(self) -> Iterator[str]:
        """The keys of all images."""
        for folder in self.all:
            for images in folder.images.values():
                yield from images


def has_layout(root: Path) -> bool:
    """Whether a folder has at least one of the layout's view folders."""
    train = any((root / "train" / name).is_dir() for name in TRAIN_FOLDERS)
    return train or any((root / "test" / name).is_dir() for name in (*QUERY_FOLDERS, *GALLERY_FOLDERS))


def read_layout(root: Path) -> ViewFolders:
    """List the view folders of a set.

    Raises:
        DatasetError: a view folder has images outside of class folders, or a name has white space or is not UTF-8,
            which rankings on disk cannot hold.
    """
    return ViewFolders(
        _folders(root, "train", TRAIN_FOLDERS),
        _folders(root, "test", QUERY_FOLDERS),
        _folders(root, "test", GALLERY_FOLDERS),
    )


def empty_folders(layout: ViewFolders) -> str | None:
    """A note on class folders without an image; None if there are none."""
    found = [f"{folder.folder}/{name}" for folder in layout.all for name in folder.empty]
    if not found:
        return None
    total = sum(len(f.images) + len(f.empty) for f in layout.all)
    return f"{len(found)} of {total} class folders hold no image: {listed(found)}"


def listed(names: Sequence[str]) -> str:
    """The first few of some names and the number of the others."""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return ", ".join(names[:_MOST_NAMED]) + more


def _folders(root: Path, part: str, names: dict[str, str]) -> dict[str, ClassFolders]:
    return {name: _classes(root, f"{part}/{name}") for name in names if (root / part / name).is_dir()}


def _classes(root: Path, folder: str) -> ClassFolders:
    images: dict[str, tuple[str, ...]] = {}
    empty, stray = [], None
    for entry in sorted(os.scandir(root / folder), key=lambda e: e.name):
        if not entry.is_dir():
            stray = stray or (entry.name if _is_image(entry.name) else None)
            continue
        files = sorted(e.name for e in os.scandir(entry.path) if _is_image(e.name) and not e.is_dir())
        for name in (entry.name, *files):
            if not name.isprintable() and any("\udc80" <= character <= "\udcff" for character in name):
                raise DatasetError(f"'{name}' is not UTF-8, but rankings on disk hold only UTF-8 names", entry.path)
            if any(character.isspace() for character in name):
                raise DatasetError(f"'{name}' has white space, which rankings on disk cannot hold", entry.path)
        if files:
            images[entry.name] = tuple(f"{folder}/{entry.name}/{name}" for name in files)
        else:
            empty.append(entry.name)
    if stray and not images:
        raise DatasetError(f"holds images such as {stray} but no class folders; expected CLASS/IMAGE", root / folder)
    return ClassFolders(folder, images, tuple(empty))


def _is_image(name: str) -> bool:
    return not name.startswith(".") and name.lower().endswith(IMAGE_SUFFIXES)
