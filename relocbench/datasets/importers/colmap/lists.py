"""The lists of visuallocalization.net and hloc: queries with intrinsics, and pairs of images, by name."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from relocbench.datasets.core.named_poses import read_words
from relocbench.datasets.importers.colmap.model import camera_of
from relocbench.errors import DatasetError, quoted
from relocbench.files import parse_floats, whole_number
from relocbench.geometry import Camera


def listed_cameras(path: Path) -> dict[str, Camera]:
    """Cameras by image name, from lines ``name MODEL width height params...``.

    Raises:
        DatasetError: with file and line.
    """
    found: dict[str, Camera] = {}
    for line, fields in read_words(path, "queries with intrinsics (name MODEL width height params...)", DatasetError):
        sizes = [whole_number(text) for text in fields[2:4]]
        if len(fields) < 5 or None in sizes:
            raise DatasetError("expected name MODEL width height params...", path, line)
        numbers = parse_floats(fields[4:], path, line, " ".join(["parameter"] * len(fields[4:])), DatasetError)
        if fields[0] in found:
            raise DatasetError(f"image {quoted(fields[0])} occurs again", path, line)
        try:
            found[fields[0]] = camera_of(fields[1], sizes[0] or 0, sizes[1] or 0, numbers)
        except ValueError as bad:
            raise DatasetError(str(bad), path, line) from None
    if not found:
        raise DatasetError("holds no image; expected lines 'name MODEL width height params...'", path)
    return found


def listed_pairs(path: Path) -> Iterator[tuple[int, tuple[str, str]]]:
    """Line number and the names of query and keyframe of each line. Raises DatasetError with file and line."""
    for line, fields in read_words(path, "pairs (query keyframe)", DatasetError):
        if len(fields) != 2:
            raise DatasetError(f"expected 2 names (query keyframe), found {len(fields)}", path, line)
        yield line, (fields[0], fields[1])
