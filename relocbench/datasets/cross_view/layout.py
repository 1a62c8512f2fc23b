"""University-1652's folders: which there are, what each holds, and nothing of what is in the images.

``train/VIEW/CLASS/IMAGE`` and ``test/query_VIEW/CLASS/IMAGE``, ``test/gallery_VIEW/CLASS/IMAGE``. A class is a
building; its folder's name is its label.
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
"""folder of ``train`` -> view; ``google`` are street images that a search engine found"""
QUERY_FOLDERS = {**{f"query_{view}": view for view in VIEWS}, "4K_drone": "drone"}
"""folder of ``test`` -> view; ``4K_drone`` are real drone images that come with the official set"""
GALLERY_FOLDERS = {f"gallery_{view}": view for view in VIEWS}
_MOST_NAMED = 5


@dataclass(frozen=True)
class ClassFolders:
    """The classes of one view folder."""

    folder: str
    """from the root on, as ``test/query_drone``"""
    images: dict[str, tuple[str, ...]]
    """class -> keys of its images: their paths from the root on, sorted"""
    empty: tuple[str, ...]
    """classes whose folder holds no image"""

    @property
    def count(self) -> int:
        """Images."""
        return sum(map(len, self.images.values()))


@dataclass(frozen=True)
class Layout:
    """All view folders of a set that there are."""

    train: dict[str, ClassFolders]
    """by the folder's name, as ``drone`` or ``google``"""
    queries: dict[str, ClassFolders]
    """as ``query_drone``"""
    galleries: dict[str, ClassFolders]

    @property
    def all(self) -> tuple[ClassFolders, ...]:
        return (*self.train.values(), *self.queries.values(), *self.galleries.values())

    @property
    def keys(self) -> Iterator[str]:
        """The key of every image."""
        for folder in self.all:
            for images in folder.images.values():
                yield from images


def has_layout(root: Path) -> bool:
    """Whether a folder has at least one of the layout's view folders."""
    train = any((root / "train" / name).is_dir() for name in TRAIN_FOLDERS)
    return train or any((root / "test" / name).is_dir() for name in (*QUERY_FOLDERS, *GALLERY_FOLDERS))


def read_layout(root: Path) -> Layout:
    """What lies in the view folders.

    Raises:
        DatasetError: a view folder whose images lie in no class folder, or a name with white space or of other bytes
            than UTF-8, which answers on disk cannot hold.
    """
    return Layout(
        _folders(root, "train", TRAIN_FOLDERS),
        _folders(root, "test", QUERY_FOLDERS),
        _folders(root, "test", GALLERY_FOLDERS),
    )


def empty_folders(layout: Layout) -> str | None:
    """One line on class folders without an image; None where there are none."""
    found = [f"{folder.folder}/{name}" for folder in layout.all for name in folder.empty]
    if not found:
        return None
    total = sum(len(f.images) + len(f.empty) for f in layout.all)
    return f"{len(found)} of {total} class folders hold no image: {listed(found)}"


def listed(names: Sequence[str]) -> str:
    """The first few of many names."""
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
                raise DatasetError(f"'{name}' is no UTF-8, which rankings on disk cannot hold", entry.path)
            if any(character.isspace() for character in name):
                raise DatasetError(f"'{name}' has white space, which rankings on disk cannot hold", entry.path)
        if files:
            images[entry.name] = tuple(f"{folder}/{entry.name}/{name}" for name in files)
        else:
            empty.append(entry.name)
    if stray and not images:
        raise DatasetError(f"holds images such as {stray}, but no class folders; expected CLASS/IMAGE", root / folder)
    return ClassFolders(folder, images, tuple(empty))


def _is_image(name: str) -> bool:
    return not name.startswith(".") and name.lower().endswith(IMAGE_SUFFIXES)
