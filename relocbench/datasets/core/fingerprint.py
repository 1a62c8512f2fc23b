"""The fingerprint of a dataset: one hash over everything that can change a score."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from relocbench.datasets.core import manifest
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.schema import DatasetFile
from relocbench.errors import MOST_QUOTED, DatasetError, cut
from relocbench.files import read_bytes, sha256_file

_TEXT = (".yaml", ".csv", ".txt")
SHORT = 12
"""hex digits of a fingerprint that folder names and tables show"""


def content_files(layout: DatasetLayout) -> list[Path]:
    """Every file that can change a score, sorted by its path in the dataset."""
    folders = (layout.traversals, layout.pairs, layout.correspondences)
    found = (p for folder in folders if folder.is_dir() for p in folder.rglob("*") if not p.is_dir())
    return sorted(found, key=lambda p: p.relative_to(layout.root).as_posix())


def write_manifest(layout: DatasetLayout) -> None:
    """Hash all content into ``manifest.csv``."""
    keys = [path.relative_to(layout.root).as_posix() for path in content_files(layout)]
    manifest.write_manifest(layout.manifest, manifest.manifest_rows(layout.root, keys))


def compute(layout: DatasetLayout, format_version: int, splits: dict[str, tuple[str, ...]]) -> str:
    """The fingerprint: SHA-256 of the manifest, the splits and the format's version."""
    head = json.dumps({"format_version": format_version, "splits": splits}, sort_keys=True)
    return hashlib.sha256(head.encode() + b"\n" + read_bytes(layout.manifest, "the manifest", DatasetError)).hexdigest()


def read_manifest(layout: DatasetLayout) -> dict[str, tuple[int, str]]:
    """The manifest as path -> (bytes, sha256). Raises DatasetError with file and line."""
    return {key: (size, digest) for key, size, digest in manifest.read_manifest(layout.manifest)}


def check_manifest(layout: DatasetLayout, file: DatasetFile) -> None:
    """Raise DatasetError unless the manifest is the one that was fingerprinted. The listed files are not read."""
    if not layout.manifest.exists():
        raise DatasetError("missing; expected the dataset's manifest", layout.manifest)
    if compute(layout, file.format_version, file.splits) != file.fingerprint:
        raise DatasetError(
            "manifest.csv or the splits were changed after the dataset was made: the fingerprint does not match",
            layout.dataset_yaml,
        )


def faults(layout: DatasetLayout, content: Literal["text", "all"] = "all") -> Iterator[DatasetError]:
    """Files that are missing, unlisted, or differ from the manifest in size or content.

    Args:
        content: hash ``all`` files, or only the ``text`` files, which are few and small (poses, pairs, rigs).
    """
    listed = read_manifest(layout)
    present = {p.relative_to(layout.root).as_posix(): p for p in content_files(layout)}
    for name, (size, digest) in listed.items():
        path = present.get(name)
        if path is None:
            shown = cut(name, MOST_QUOTED)  # messages show paths in full, and this one may be of any length
            yield DatasetError("missing; it is listed in manifest.csv", layout.root / shown)
        elif not path.exists():
            yield DatasetError("is a link to a file that does not exist", path)
        elif path.stat().st_size != size:
            yield DatasetError(f"has {path.stat().st_size} bytes, manifest.csv says {size}", path)
        elif (content == "all" or path.suffix in _TEXT) and sha256_file(path) != digest:
            yield DatasetError("content was changed after the dataset was made", path)
    for name in sorted(present.keys() - listed.keys()):
        yield DatasetError("is not listed in manifest.csv; it was added after the dataset was made", present[name])
