"""Opening a cross-view set, rendered or from elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from relocbench.datasets.core.manifest import read_manifest
from relocbench.datasets.cross_view import content, sample
from relocbench.datasets.cross_view.cross_view_set import CrossViewSet, Shot, shots_of
from relocbench.datasets.cross_view.layout import (
    GALLERY_FOLDERS,
    QUERY_FOLDERS,
    TRAIN_FOLDERS,
    ClassFolders,
    ViewFolders,
    empty_folders,
    has_layout,
    listed,
    read_layout,
)
from relocbench.errors import DatasetError
from relocbench.files import load_yaml, plain_name
from relocbench.progress import Reporter, Silent

_EXPECTED = (
    "expected University-1652's layout: train/{drone,satellite,street,google}/CLASS/IMAGE or "
    "test/{query,gallery}_{drone,satellite,street}/CLASS/IMAGE. University-1652 itself is available from its authors "
    "by e-mail; 'relocbench build-dataset cross-view --out DIR' renders a set without it"
)


def is_cross_view(path: Path) -> bool:
    """Whether a folder has a layout that :func:`open_cross_view` can open."""
    return path.is_dir() and (has_layout(path) or sample.is_sample(path))


def open_cross_view(path: Path, reporter: Reporter | None = None) -> CrossViewSet:
    """Open the set in a folder: University-1652, a rendered set, or University-1652's two contact sheets.

    Empty class folders and labels that are in both train and test are reported and kept as ``notes``.

    Raises:
        DatasetError: the folder is missing, has another layout or no images, or is a rendered set that was changed or
            is unfinished.
    """
    if not path.is_dir():
        raise DatasetError(f"{'is a file' if path.exists() else 'no such folder'}; {_EXPECTED}", path)
    if sample.is_sample(path):
        return sample.open_sample(path)
    if not has_layout(path):
        _refuse(path)
    layout = read_layout(path)
    if not any(folder.images for folder in layout.all):
        raise DatasetError(f"none of its {sum(len(f.empty) for f in layout.all)} class folders holds an image", path)
    if (path / content.BUILD_FILE).exists():
        opened = _made_here(path, layout)
    else:
        opened = _set(path, _plain(path), layout, lambda: content.fingerprint_of(content.rows_of(path, layout.keys)))
    for note in opened.notes:
        (reporter or Silent()).note(f"{path}: {note}")
    return opened


def _refuse(path: Path) -> None:
    above = path.resolve().parent
    if has_layout(above) and path.resolve().name in ("train", "test"):
        raise DatasetError(f"is the '{path.resolve().name}' folder of a cross-view set; name {above}", path)
    if (path / content.BUILD_FILE).exists() and not (path / content.DATASET_FILE).exists():
        raise DatasetError("is an unfinished build; run its command again to continue it", path)
    raise DatasetError(_EXPECTED, path)


def _plain(path: Path) -> str:
    """A name for the set, made from its folder's."""
    try:
        return plain_name(path.resolve().name, "name of a set")
    except ValueError:
        raise DatasetError("the folder's name cannot name a set; rename or link it", path) from None


def _made_here(path: Path, layout: ViewFolders) -> CrossViewSet:
    if not (path / content.DATASET_FILE).exists():
        raise DatasetError("is an unfinished build; run its command again to continue it", path)
    file = load_yaml(path / content.DATASET_FILE, content.CrossViewFile, "a cross-view set's description", DatasetError)
    if file.format_version != content.FORMAT_VERSION:
        raise DatasetError(
            f"key 'format_version' is {file.format_version}, but this relocbench reads {content.FORMAT_VERSION}",
            path / content.DATASET_FILE,
        )
    rows = read_manifest(path / content.MANIFEST_FILE)
    if content.fingerprint_of(rows) != file.fingerprint:
        raise DatasetError(
            f"{content.MANIFEST_FILE} was changed after the set was made: the fingerprint does not match",
            path / content.DATASET_FILE,
        )
    content.check_against(path, rows, layout.keys)
    digests = {key: sha256 for key, _, sha256 in rows}
    found = _set(path, file.name, layout, partial(str, file.fingerprint), content.read_conditions(path), digests)
    stored = content.content_id_of(file, digests)
    return replace(found, stored_content_id=stored, made_by=file.made_by, licence=file.licence)


def _set(
    path: Path,
    name: str,
    layout: ViewFolders,
    fingerprinted: Callable[[], str],
    conditions: dict[str, str] | None = None,
    digests: dict[str, str] | None = None,
) -> CrossViewSet:
    def shots(folders: dict[str, ClassFolders], views: dict[str, str], prefix: str) -> dict[str, tuple[Shot, ...]]:
        return {
            folder.removeprefix(prefix): shots_of(path, found.images, views[folder], conditions, digests)
            for folder, found in folders.items()
            if found.images
        }

    opened = CrossViewSet(
        path,
        name,
        shots(layout.train, TRAIN_FOLDERS, ""),
        shots(layout.queries, QUERY_FOLDERS, "query_"),
        shots(layout.galleries, GALLERY_FOLDERS, "gallery_"),
        fingerprinted,
    )
    notes = [empty_folders(layout)]
    if opened.overlap:
        notes.append(f"{len(opened.overlap)} classes are in both train and test: {listed(opened.overlap)}")
    return replace(opened, notes=tuple(note for note in notes if note))
