"""Readers of cross-view sets: University-1652's folders, and sets that were rendered here."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from fuzz.asking import asks, write
from fuzz.parser import Parser, Place

_OFFICIAL = (
    "train/drone/0839/image-01.jpeg", "train/drone/0842/image-01.jpeg", "train/satellite/0839/0839.jpg",
    "train/satellite/0842/0842.jpg", "train/street/0839/1.jpg", "train/google/0842/web.JPG",
    "test/query_drone/0003/image-01.jpeg", "test/query_drone/0001/image-01.jpeg",
    "test/query_satellite/0001/0001.jpg", "test/gallery_satellite/0001/0001.jpg",
    "test/gallery_satellite/0003/0003.jpg", "test/gallery_drone/0001/image-01.jpeg", "test/gallery_street/0001/1.jpg",
    "test/4K_drone/0003/frame.png",
)  # fmt: skip


def write_university(root: Path) -> None:
    """A small set in the official layout."""
    _write_images(root / "university", _OFFICIAL)


def write_rendered(root: Path) -> None:
    """A set as ``build-dataset cross-view`` leaves it, its pictures made up."""
    from relocbench.datasets.core.manifest import write_manifest
    from relocbench.datasets.cross_view import content
    from relocbench.files import dump_yaml

    folder = root / "rendered"
    keys = [key for key in _OFFICIAL if "4K" not in key and "google" not in key]
    _write_images(folder, keys)
    rows = content.rows_of(folder, keys)
    write_manifest(folder / content.MANIFEST_FILE, rows)
    write(folder / content.POSES_FILE, "image,condition,x", *(f"{key},Rain,1.5" for key in keys))
    write(folder / content.BUILD_FILE, "command: made up")
    file = content.CrossViewFile(
        format_version=content.FORMAT_VERSION,
        kind="cross-view",
        name="rendered",
        licence="CC0-1.0",
        made_by={"seed": 0},
        made={"places": 2},
        fingerprint=content.fingerprint_of(rows),
    )
    (folder / content.DATASET_FILE).write_text(dump_yaml(file.model_dump(mode="json")))


def _write_images(root: Path, keys: Iterable[str]) -> None:
    for number, key in enumerate(keys):
        (root / key).parent.mkdir(parents=True, exist_ok=True)
        picture = np.random.default_rng(number).integers(0, 256, (8, 8, 3), dtype=np.uint8)
        assert cv2.imwrite(str(root / key), picture)


def _open(place: Place) -> Iterable[str]:
    from relocbench.datasets.cross_view import open_cross_view

    folder = next(p for p in (place.root / "university", place.root / "rendered") if p.is_dir())
    found = open_cross_view(folder)
    found.inventory()
    for task in found.tasks(by_condition=True):
        for view in (*task.queries, *task.gallery):
            view.read()
    for shown in found.training(google=True).images:
        shown.image.read()
    return found.notes


SEEDS = {"university": write_university, "rendered": write_rendered}
PARSERS = (
    Parser("university-folders", "university", ("university/**/*",), _open, names=True),
    Parser(
        "university-validate",
        "university",
        ("university/**/*",),
        asks("validate", "{root}/university"),
        names=True,
        brief=False,
    ),
    Parser("cross-view.yaml", "rendered", ("rendered/dataset.yaml", "rendered/build.yaml"), _open, text=True),
    Parser("cross-view-manifest", "rendered", ("rendered/manifest.csv",), _open, text=True),
    Parser("cross-view-poses", "rendered", ("rendered/poses.csv",), _open, text=True),
    Parser("cross-view-folders", "rendered", ("rendered/**/*",), _open, names=True),
    Parser(
        "cross-view-validate",
        "rendered",
        ("rendered/**/*",),
        asks("validate", "{root}/rendered"),
        names=True,
        brief=False,
    ),
)
