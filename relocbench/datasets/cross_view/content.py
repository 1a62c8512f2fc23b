"""The fingerprint, manifest and description files of a cross-view set."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

from relocbench.datasets.core import manifest
from relocbench.datasets.core.content_id import recipe
from relocbench.datasets.core.manifest import Row
from relocbench.datasets.core.schema import Strict
from relocbench.errors import DatasetError
from relocbench.files import check_name, read_csv

DATASET_FILE, BUILD_FILE, MANIFEST_FILE, POSES_FILE = "dataset.yaml", "build.yaml", "manifest.csv", "poses.csv"
FORMAT_VERSION = 1


class CrossViewFile(Strict):
    """The content of ``dataset.yaml`` in a rendered set."""

    format_version: int
    kind: Literal["cross-view"]
    name: str
    licence: str
    made_by: dict[str, Any]
    """command, options, seed and versions"""
    made: dict[str, Any]
    """what the set contains: towns, places, images, cameras"""
    fingerprint: str


def rows_of(root: Path, keys: Iterable[str]) -> list[Row]:
    """Manifest rows of images, sorted by path. Raises DatasetError naming a file that cannot be read."""
    return manifest.manifest_rows(root, sorted(keys))


def fingerprint_of(rows: Sequence[Row]) -> str:
    """SHA-256 of the paths, which contain the labels, and the contents of all images."""
    text = "".join(f"{key},{size},{digest}\n" for key, size, digest in rows)
    return hashlib.sha256(f"cross-view {FORMAT_VERSION}\n{text}".encode()).hexdigest()


def content_id_of(file: CrossViewFile, keys: Iterable[str]) -> str:
    """SHA-256 of what a rendered set asks, the same on every processor: its recipe and the paths of its images."""
    asked = {"format_version": FORMAT_VERSION, "recipe": recipe(file.made_by), "images": sorted(keys)}
    return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()


def check_against(root: Path, rows: Sequence[Row], present: Iterable[str]) -> None:
    """Raise DatasetError unless every image is listed and exists with its size. Contents are not read."""
    listed = {key: size for key, size, _ in rows}
    for key in present:
        if key not in listed:
            raise DatasetError(f"is not listed in {MANIFEST_FILE}; it was added after the set was made", root / key)
    for key, size in listed.items():
        path = root / key
        if not path.is_file():
            raise DatasetError(f"missing; it is listed in {MANIFEST_FILE}", path)
        if path.stat().st_size != size:
            raise DatasetError(f"has {path.stat().st_size} bytes, {MANIFEST_FILE} says {size}", path)


def read_conditions(root: Path) -> dict[str, str]:
    """Conditions of the images by key, from ``poses.csv``. Raises DatasetError where it is missing or bad."""
    path = root / POSES_FILE
    table = read_csv(path, "poses of the images", DatasetError)
    header = next(table, (1, []))[1]
    if "image" not in header or "condition" not in header:
        raise DatasetError("expected a header with image and condition", path, 1)
    image, condition = header.index("image"), header.index("condition")
    found = {}
    for number, row in table:
        if len(row) != len(header):
            raise DatasetError(f"expected {len(header)} columns, got {len(row)}", path, number)
        if row[condition]:
            try:
                check_name(row[condition], "condition")  # it becomes part of the names of tasks
            except ValueError as bad:
                raise DatasetError(str(bad), path, number) from None
        found[row[image]] = row[condition]
    return found
