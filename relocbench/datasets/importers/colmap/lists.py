"""The lists of visuallocalization.net and hloc: queries with intrinsics, poses, and pairs of images by name."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.importers.colmap.model import camera_of
from relocbench.errors import DatasetError, RelocbenchError, quoted
from relocbench.files import lines_of, parse_floats, read_text, whole_number
from relocbench.geometry import Camera, transform_from_tq

_POSE = "QW QX QY QZ TX TY TZ"


def listed_cameras(path: Path) -> dict[str, Camera]:
    """Cameras by image name, from lines ``name MODEL width height params...``.

    Raises:
        DatasetError: with file and line.
    """
    found: dict[str, Camera] = {}
    for line, fields in _rows(path, "queries with intrinsics (name MODEL width height params...)", DatasetError):
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


def listed_poses(path: Path, error: type[RelocbenchError] = DatasetError) -> dict[str, Array]:
    """``T_cam_world`` (4, 4) by image name, from lines ``name qw qx qy qz tx ty tz``, as hloc writes its results.

    Raises:
        RelocbenchError: (as ``error``) with file and line.
    """
    found: dict[str, Array] = {}
    for line, fields in _rows(path, "poses (name qw qx qy qz tx ty tz)", error):
        qw, qx, qy, qz, *translation = parse_floats(fields[1:], path, line, _POSE, error)
        norm = float(np.linalg.norm([qw, qx, qy, qz]))
        if not abs(norm - 1.0) <= 1e-3:
            raise error(f"the quaternion has norm {norm:.6g}, expected 1", path, line)
        if fields[0] in found:
            raise error(f"image {quoted(fields[0])} occurs again", path, line)
        found[fields[0]] = transform_from_tq(translation, (qx, qy, qz, qw))
    return found


def listed_pairs(path: Path) -> Iterator[tuple[int, tuple[str, str]]]:
    """Line number and the names of query and keyframe of each line. Raises DatasetError with file and line."""
    for line, fields in _rows(path, "pairs (query keyframe)", DatasetError):
        if len(fields) != 2:
            raise DatasetError(f"expected 2 names (query keyframe), found {len(fields)}", path, line)
        yield line, (fields[0], fields[1])


def _rows(path: Path, what: str, error: type[RelocbenchError]) -> Iterator[tuple[int, list[str]]]:
    """Line number and words of each line that is neither empty nor a comment. Names may hold commas."""
    for number, line in enumerate(lines_of(read_text(path, what, error)), start=1):
        if fields := line.split("#", 1)[0].split():
            yield number, fields
