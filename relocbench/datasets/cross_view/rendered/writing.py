"""Writing the tables and descriptions of a rendered set: poses, places, manifest and ``dataset.yaml``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from relocbench.datasets.core.manifest import write_manifest
from relocbench.datasets.core.pairfile import TRUTH_DECIMALS, pose_fields
from relocbench.datasets.core.writer import versions
from relocbench.datasets.cross_view import content
from relocbench.datasets.cross_view.rendered.places import PlaceOfTown
from relocbench.datasets.cross_view.rendered.plan import Photo
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.errors import DatasetError
from relocbench.files import atomic_write, dump_yaml, remove_parts, write_table, write_text

_POSES = ("image", "class", "view", "condition", "town", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
_PLACES = ("class", "split", "role", "town", "instance", "x_m", "y_m", "height_m")


def link_other_names(root: Path, photos: Sequence[Photo]) -> None:
    """Add the second names of images that are both query and gallery, as hard links or, if impossible, copies."""
    for photo in photos:
        source = root / photo.keys[0]
        for key in photo.keys[1:]:
            path = root / key
            if path.exists() and os.path.samestat(path.stat(), source.stat()):
                continue
            path.unlink(missing_ok=True)
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                path.hardlink_to(source)
            except OSError:
                with atomic_write(path, "wb") as stream:
                    stream.write(source.read_bytes())


def refuse_other_files(root: Path, photos: Sequence[Photo]) -> None:
    """Raise DatasetError if the set's folders hold a file that is not one of the build's images."""
    own = {root / key for photo in photos for key in photo.keys}
    for part in ("train", "test"):
        for path in sorted((root / part).rglob("*")):
            if path.is_file() and not path.name.startswith(".") and path not in own:
                raise DatasetError("is not an image of this build; remove it or choose another --out", path)


def write_poses(root: Path, photos: Sequence[Photo]) -> None:
    """Write ``poses.csv``: T_world_cam of each image, in the frame of its town."""
    rows = (
        [key, p.label, p.view, p.condition, _name(p.town), *pose_fields(p.T_world_cam, TRUTH_DECIMALS)]
        for key, p in sorted(((k, p) for p in photos for k in p.keys), key=lambda row: row[0])
    )
    write_table(root / content.POSES_FILE, _POSES, rows)


def write_places(root: Path, places: Sequence[PlaceOfTown]) -> None:
    """Write ``places.csv``: the town and building of each class."""
    rows = []
    for p in places:
        role = "learned" if p.town.split == "train" else "distractor" if p.distractor else "asked"
        metres = (f"{value:.3f}" for value in (*p.building.centre.tolist(), p.building.height_m))
        rows.append([p.label, p.town.split, role, _name(p.town), p.building.instance, *metres])
    write_table(root / "places.csv", _PLACES, rows)


def _name(town: DistrictSpec) -> str:
    return f"{town.split}-{town.named_seed}"


def finish(
    root: Path, name: str, licence: str, configuration: dict[str, Any], made: dict[str, Any], photos: Sequence[Photo]
) -> None:
    """Hash all images and write the manifest and, last, ``dataset.yaml`` with the fingerprint."""
    remove_parts(root)
    rows = content.rows_of(root, [key for photo in photos for key in photo.keys])
    write_manifest(root / content.MANIFEST_FILE, rows)
    file = content.CrossViewFile(
        format_version=content.FORMAT_VERSION,
        kind="cross-view",
        name=name,
        licence=licence,
        made_by={**configuration, "versions": versions()},
        made=made,
        fingerprint=content.fingerprint_of(rows),
    )
    write_text(root / content.DATASET_FILE, dump_yaml(file.model_dump(mode="json")))
