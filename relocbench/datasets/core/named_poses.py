"""Poses of images by name, camera from world: the results of hloc and the submissions of visuallocalization.net."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.pairfile import missing
from relocbench.errors import DatasetError, RelocbenchError, quoted
from relocbench.files import lines_of, parse_floats, read_text, write_text
from relocbench.geometry import transform_from_tq, transform_to_tq
from relocbench.progress import Reporter

POSE_NUMBERS = "QW QX QY QZ TX TY TZ"


def read_named_poses(
    path: Path, error: type[RelocbenchError] = DatasetError, reporter: Reporter | None = None
) -> dict[str, Array]:
    """``T_cam_world`` (4, 4) by image name, from lines ``name qw qx qy qz tx ty tz``, as hloc writes its results.

    Args:
        error: the error class to raise.
        reporter: is told how many poses are not finite and are left out; None: they are refused.

    Raises:
        RelocbenchError: (as ``error``) with file and line.
    """
    poses: dict[str, Array] = {}
    without: list[int] = []
    for line, fields in read_words(path, "poses (name qw qx qy qz tx ty tz)", error):
        if reporter is not None and missing(fields[1:]):
            without.append(line)
            continue
        numbers = parse_floats(fields[1:], path, line, POSE_NUMBERS, error)
        if fields[0] in poses:
            raise error(f"image {quoted(fields[0])} occurs again", path, line)
        try:
            poses[fields[0]] = pose_of_numbers(numbers)
        except ValueError as bad:
            raise error(str(bad), path, line) from None
    if reporter is not None and without:
        reporter.note(f"{path.name}: {len(without)} images have no pose (NaN), the first on line {without[0]}")
    return poses


def pose_of_numbers(numbers: Sequence[float]) -> Array:
    """The pose (4, 4) of ``qw qx qy qz tx ty tz``. Raises ValueError if the quaternion's norm is not 1."""
    qw, qx, qy, qz, *translation = numbers
    norm = float(np.linalg.norm([qw, qx, qy, qz]))
    if not abs(norm - 1.0) <= 1e-3:
        raise ValueError(f"the quaternion has norm {norm:.6g}, expected 1")
    return transform_from_tq(translation, (qx, qy, qz, qw))


def numbers_of_pose(transform: Array) -> list[float]:
    """``qw qx qy qz tx ty tz`` of a pose (4, 4)."""
    translation, (qx, qy, qz, qw) = transform_to_tq(transform)
    return [float(value) for value in (qw, qx, qy, qz, *translation)]


def write_named_poses(path: Path, poses: Mapping[str, Array]) -> None:
    """Write ``T_cam_world`` (4, 4) by image name, in the order of the names."""
    lines = []
    for name, T_cam_world in sorted(poses.items()):
        numbers = " ".join(map(repr, numbers_of_pose(T_cam_world)))
        lines.append(f"{name} {numbers}\n")
    write_text(path, "".join(lines))


def read_words(path: Path, what: str, error: type[RelocbenchError]) -> Iterator[tuple[int, list[str]]]:
    """Line number and words of each line that is neither empty nor a comment. Names may hold commas."""
    for number, line in enumerate(lines_of(read_text(path, what, error)), start=1):
        if fields := line.split("#", 1)[0].split():
            yield number, fields
