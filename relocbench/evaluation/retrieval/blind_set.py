"""A blind export of a retrieval set: images under keys, and which of them each task asks; no truth, no names, no order.

``blind.yaml`` describes it, ``images/KEY.png`` are the images, ``images.csv`` has their digests, and
``tasks/TASK.queries.txt`` and ``tasks/TASK.gallery.txt`` have the keys of a task, a line each.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Literal

from pydantic import Field

from relocbench.arrays import Image
from relocbench.datasets.core.images import as_rgb, read_image
from relocbench.datasets.core.schema import Fingerprint, FolderName, JoinedName, Strict
from relocbench.errors import DatasetError
from relocbench.files import lines_of, load_yaml, read_text, sha256_file
from relocbench.metrics import relevance_from_lists
from relocbench.retrieval import ImageView, RetrievalTask

FILE = "blind.yaml"
WITHHELD = "withheld: this is a blind export"
"""in place of words that say which images are right"""
HEADER = "image,sha256"


class BlindTask(Strict):
    """What a blind export tells of a task."""

    queries: int
    gallery: int
    view_query: str
    view_gallery: str
    condition_query: str = ""
    """empty, as the next: an export does not tell conditions"""
    condition_gallery: str = ""


class BlindSetFile(Strict):
    """``blind.yaml``."""

    format_version: Literal[1] = 1
    kind: Literal["images"] = "images"
    name: FolderName
    licence: str = ""
    """of the images"""
    fingerprint: Fingerprint
    """SHA-256 of the name, of ``images.csv`` and of the keys of all tasks"""
    tasks: dict[JoinedName, BlindTask] = Field(min_length=1)


def is_blind_set(folder: Path) -> bool:
    """Whether a folder is a blind export of a retrieval set."""
    return (folder / FILE).is_file()


def image_file(root: Path, key: str) -> Path:
    """The image of a key."""
    return root / "images" / f"{key}.png"


def keys_file(root: Path, task: str, side: Literal["queries", "gallery"]) -> Path:
    """The keys of one side of a task."""
    return root / "tasks" / f"{task}.{side}.txt"


def fingerprint_of(name: str, images: str, tasks: Mapping[str, tuple[Sequence[str], Sequence[str]]]) -> str:
    """The fingerprint of an export.

    Args:
        images: the text of ``images.csv``.
        tasks: keys of queries and gallery of each task.
    """
    digest = hashlib.sha256(f"{name}\n{images}".encode())
    for task, sides in sorted(tasks.items()):
        for side, keys in zip(("queries", "gallery"), sides, strict=True):
            digest.update("\n".join([f"{task} {side} {len(keys)}", *keys, ""]).encode())
    return digest.hexdigest()


def open_blind_set(root: Path) -> tuple[BlindSetFile, tuple[RetrievalTask, ...]]:
    """The description of a blind export and its tasks, in which no image is known to be right.

    Raises:
        DatasetError: with file and line: a file is missing or not what the fingerprint is of.
    """
    path = root / FILE
    file = load_yaml(path, BlindSetFile, "the description of a blind export of images", DatasetError)
    digests = _digests(root)
    keys = {name: (_keys(root, name, "queries", digests), _keys(root, name, "gallery", digests)) for name in file.tasks}
    images = "".join(f"{line}\n" for line in [HEADER, *(f"{key},{digest}" for key, digest in digests.items())])
    if fingerprint_of(file.name, images, keys) != file.fingerprint:
        raise DatasetError("the fingerprint is not that of images.csv and tasks/; make the export again", path)
    return file, tuple(_task(root, name, file.tasks[name], *keys[name], digests) for name in file.tasks)


def _digests(root: Path) -> dict[str, str]:
    """SHA-256 of each image by its key, as ``images.csv`` lists them."""
    path = root / "images.csv"
    header, *lines = lines_of(read_text(path, "the images of a blind export", DatasetError))
    if header != HEADER:
        raise DatasetError(f"expected the header '{HEADER}'", path, 1)
    out: dict[str, str] = {}
    for number, line in enumerate(lines, start=2):
        key, _, digest = line.partition(",")
        if not key.isalnum() or not digest.isalnum() or key in out:
            raise DatasetError("expected a key that did not occur before, and a digest", path, number)
        out[key] = digest
    return out


def _keys(root: Path, task: str, side: Literal["queries", "gallery"], known: Mapping[str, str]) -> list[str]:
    path = keys_file(root, task, side)
    keys = lines_of(read_text(path, "keys of images, a line each", DatasetError))
    for number, key in enumerate(keys, start=1):
        if key not in known:
            raise DatasetError(f"no image '{key[:60]}' in images.csv", path, number)
    return keys


def _task(
    root: Path, name: str, task: BlindTask, queries: Sequence[str], gallery: Sequence[str], digests: Mapping[str, str]
) -> RetrievalTask:
    def views(keys: Sequence[str], view: str) -> tuple[ImageView, ...]:
        return tuple(
            ImageView(key, view, partial(_read, image_file(root, key), digests[key]), digests[key]) for key in keys
        )

    return RetrievalTask(
        name=name,
        queries=views(queries, task.view_query),
        gallery=views(gallery, task.view_gallery),
        relevance=relevance_from_lists([[] for _ in queries], len(gallery)),
    )


def _read(path: Path, digest: str) -> Image:
    if not path.is_file():
        raise DatasetError("missing; make the blind export again", path)
    if sha256_file(path) != digest:
        raise DatasetError("is not the image that images.csv lists; make the blind export again", path)
    return as_rgb(read_image(path))
