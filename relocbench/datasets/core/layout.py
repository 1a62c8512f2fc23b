"""The path of each file of a dataset. No other module composes such paths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from relocbench.errors import DatasetError
from relocbench.files import check_joined_name, check_name, whole_number

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class DatasetLayout:
    """Paths below the root of a dataset."""

    root: Path

    @property
    def dataset_yaml(self) -> Path:
        return self.root / "dataset.yaml"

    @property
    def build_yaml(self) -> Path:
        """The build's configuration, written first: it marks a folder as one that the build may write to."""
        return self.root / "build.yaml"

    @property
    def manifest(self) -> Path:
        """Table of path, bytes and sha256 of every file that can change a score."""
        return self.root / "manifest.csv"

    @property
    def traversals(self) -> Path:
        return self.root / "traversals"

    @property
    def pairs(self) -> Path:
        return self.root / "pairs"

    @property
    def correspondences(self) -> Path:
        return self.root / "correspondences"

    def traversal(self, name: str) -> TraversalLayout:
        return TraversalLayout(self.traversals / _checked(check_name, name, "traversal name"))

    def pair_file(self, pair_set: str) -> Path:
        return self.pairs / f"{_of_pair_set(pair_set)}.txt"

    def pair_table(self, pair_set: str) -> Path:
        return self.pairs / f"{_of_pair_set(pair_set)}.csv"

    def correspondence_file(self, pair_set: str) -> Path:
        return self.correspondences / f"{_of_pair_set(pair_set)}.parquet"


@dataclass(frozen=True)
class TraversalLayout:
    """Paths below the folder of a traversal."""

    root: Path

    @property
    def traversal_yaml(self) -> Path:
        return self.root / "traversal.yaml"

    @property
    def poses(self) -> Path:
        return self.root / "poses.csv"

    @property
    def names(self) -> Path:
        """Table of the names that images had where they were imported from."""
        return self.root / "names.csv"

    def image(self, camera: str, timestamp_ns: int, suffix: str = ".png") -> Path:
        return self.root / "images" / camera / f"{timestamp_ns}{suffix}"

    def find_image(self, camera: str, timestamp_ns: int) -> Path | None:
        """The path of an image that exists with any of the known suffixes, or None."""
        for suffix in IMAGE_SUFFIXES:
            path = self.image(camera, timestamp_ns, suffix)
            if path.exists() or path.is_symlink():
                return path
        return None

    def depth(self, camera: str, timestamp_ns: int) -> Path:
        return self.root / "depth" / camera / f"{timestamp_ns}.png"

    def points(self, camera: str, timestamp_ns: int) -> Path:
        return self.root / "points" / camera / f"{timestamp_ns}.csv"

    def intrinsics(self, camera: str) -> Path:
        """Table of the cameras of single images, where they differ from that of ``traversal.yaml``."""
        return self.root / "intrinsics" / f"{camera}.csv"

    def timestamps(self, kind: str, camera: str) -> list[int]:
        """Sorted timestamps of the files in a camera's ``images``, ``depth`` or ``points`` folder."""
        folder = self.root / kind / camera
        if not folder.is_dir():
            return []
        suffixes = IMAGE_SUFFIXES if kind == "images" else (".png", ".csv")
        times = (whole_number(p.stem) for p in folder.iterdir() if p.suffix.lower() in suffixes)
        return sorted(time for time in times if time is not None)


def pair_set_name(reference: str, query: str, camera: str, query_camera: str = "") -> str:
    """``REF__QUERY__CAM``, or ``REF__QUERY__REFCAM__QUERYCAM`` where queries are from another camera."""
    of_another = [query_camera] if query_camera not in ("", camera) else []
    return "__".join([reference, query, camera, *of_another])


def pair_set_parts(name: str) -> tuple[str, str, str, str]:
    """Reference traversal, query traversal, keyframes' camera and queries' camera, by the name of a pair set.

    Raises:
        ValueError: it is not a name that :func:`pair_set_name` makes.
    """
    parts = name.split("__")
    if len(parts) == 3:
        parts.append(parts[2])
    elif len(parts) != 4 or parts[2] == parts[3]:
        raise ValueError("a pair file is named REF__QUERY__CAM.txt, or REF__QUERY__REFCAM__QUERYCAM.txt")
    return parts[0], parts[1], parts[2], parts[3]


def _of_pair_set(name: str) -> str:
    return _checked(check_joined_name, name, "name of a pair set")


def _checked(check: Callable[[str, str], str], name: str, what: str) -> str:
    try:
        return check(name, what)
    except ValueError as bad:
        raise DatasetError(str(bad)) from None
