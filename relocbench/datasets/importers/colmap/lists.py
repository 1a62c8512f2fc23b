"""The lists of queries with intrinsics of visuallocalization.net and hloc."""

from __future__ import annotations

from pathlib import Path

from relocbench.datasets.core.named_poses import read_words
from relocbench.datasets.importers.photos.cameras import camera_of
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
