"""Pairs, and pair files: the MLAD / 4Seasons relocalization file.

A line is ``ref_ts query_ts`` or ``ref_ts query_ts tx ty tz qx qy qz qw``, where the pose is
``T_query_ref``, camera to camera. ``#`` starts a comment. Columns are read with commas or spaces between them and
written with single spaces.
"""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.errors import DatasetError, RelocbenchError
from relocbench.files import (
    parse_floats,
    parse_timestamp,
    quick_counts,
    quick_floats,
    read_rows,
    write_text,
)
from relocbench.geometry import rotation_angle, transform_from_tq, transform_to_tq

PairKey = tuple[int, int]
"""(reference timestamp, query timestamp), nanoseconds"""

QUATERNION_TOLERANCE = 1e-3
TRUTH_DECIMALS = 9
"""Decimals of metres and quaternion components in files of true poses.

Matrix products and decompositions differ between processors by about 1e-16. Rounded, true poses are the same text on
all of them, except for the rare number that lies halfway between two roundings.
"""
_POSE_COLUMNS = "tx ty tz qx qy qz qw"
POSE_LINE = f"ref_ts query_ts [{_POSE_COLUMNS}]"
"""the columns of a line"""
UNCALIBRATED = "sigma not calibrated"
"""part of a pair's source where its sigmas are no standard deviations of the errors"""
ELSEWHERE = "elsewhere"
"""the group of pairs whose keyframe and query show different places; reserved for them"""


@dataclass(frozen=True, eq=False)
class PoseLine:
    """One line of a pair or prediction file."""

    ref_timestamp_ns: int
    query_timestamp_ns: int
    T_query_ref: Array | None
    """(4, 4), None if the pose is withheld or, in predictions, not finite"""
    line: int = 0
    """1-based line number in the file it was read from"""

    @property
    def key(self) -> PairKey:
        return self.ref_timestamp_ns, self.query_timestamp_ns


@dataclass(frozen=True, eq=False)
class Pair:
    """One pair of a reference keyframe and a query, with its ground truth."""

    ref_timestamp_ns: int
    query_timestamp_ns: int
    T_query_ref: Array | None
    """(4, 4) ground truth, None where it is withheld"""
    group: str = ""
    """part of the pair set that tables report separately, such as ``step_4``, or :data:`ELSEWHERE`"""
    overlap: float | None = None
    """share of the reference's pixels with depth that the query sees"""
    sigma_translation_m: float | None = None
    """one standard deviation of the true camera centre, per direction"""
    sigma_rotation_deg: float | None = None
    source: str = ""
    """how the truth was obtained"""
    accepted: bool = True
    reason: str = ""
    """why it was rejected"""
    sigma_along_m: float | None = None
    """one standard deviation of the true camera centre along the direction of travel"""
    sigma_across_m: float | None = None
    """the same to the side"""
    sigma_height_m: float | None = None
    scale_change: float | None = None
    """median change of scale of what the query sees of the reference, 1 or more"""
    overlap_query: float | None = None
    """share of the query's pixels with depth that the reference sees"""
    depth_error: float | None = None
    """median sigma of the reference's depths within the query's image, relative to the depth"""
    similarity: float | None = None
    """median correlation, -1 to 1, of patches of the reference with what the query shows there"""

    @property
    def axis_sigmas(self) -> tuple[float | None, float | None, float | None]:
        """The sigmas along the direction of travel, to the side, and of the height."""
        return self.sigma_along_m, self.sigma_across_m, self.sigma_height_m

    @property
    def has_calibrated_sigmas(self) -> bool:
        """Whether its sigmas, as far as it has any, are standard deviations of the errors."""
        return UNCALIBRATED not in self.source

    @property
    def calibrated_sigmas(self) -> tuple[float | None, float | None]:
        """The sigmas of position (metres) and rotation (degrees); None where unknown or :data:`UNCALIBRATED`."""
        return (self.sigma_translation_m, self.sigma_rotation_deg) if self.has_calibrated_sigmas else (None, None)

    @property
    def key(self) -> PairKey:
        return self.ref_timestamp_ns, self.query_timestamp_ns

    @property
    def is_negative(self) -> bool:
        """Whether keyframe and query show different places, so that no pose is right."""
        return self.group == ELSEWHERE

    @cached_property
    def distance_m(self) -> float | None:
        """Distance between the camera centres."""
        return None if self.T_query_ref is None else float(np.linalg.norm(self.T_query_ref[:3, 3]))

    @cached_property
    def angle_deg(self) -> float | None:
        """Angle of the relative rotation."""
        if self.T_query_ref is None:
            return None
        return float(np.degrees(rotation_angle(self.T_query_ref[:3, :3])))


def distances_and_angles(pairs: Sequence[Pair]) -> list[tuple[float | None, float | None]]:
    """``distance_m`` and ``angle_deg`` of many pairs, computed together, which is much faster than one by one."""
    known = [p.T_query_ref for p in pairs if p.T_query_ref is not None]
    T = np.array(known, dtype=np.float64).reshape(-1, 4, 4)
    distances = np.linalg.norm(T[:, :3, 3], axis=1).tolist()
    angles = np.degrees(rotation_angle(T[:, :3, :3])).tolist()
    values = iter(zip(distances, angles, strict=True))
    return [(None, None) if p.T_query_ref is None else next(values) for p in pairs]


def read_pose_lines(
    path: Path,
    error: type[RelocbenchError] = DatasetError,
    *,
    allow_non_finite: bool = False,
    only: Container[PairKey] | None = None,
) -> list[PoseLine]:
    """Parse a pair or prediction file.

    Args:
        error: the error class to raise.
        allow_non_finite: treat a pose that is not finite as missing, as the failure policy does with predictions.
        only: the pairs whose lines are parsed and checked, if not all are; much faster where they are few.

    Raises:
        RelocbenchError: (as ``error``) with file and line: a wrong number of columns, a value that is not a finite
            number, a quaternion whose norm is not 1, or a pair that occurs twice.
    """
    rows = list(read_rows(path, f"a relocalization file ({POSE_LINE})", error))
    if only is not None:
        rows = [(number, fields) for number, fields in rows if may_be_among(only, fields)]
    usual = _fast(rows)
    return usual if usual is not None else _one_by_one(rows, path, error, allow_non_finite)


def may_be_among(keys: Container[PairKey], fields: Sequence[str]) -> bool:
    """Whether a line that begins with the timestamps of a pair is one of these, or no such line."""
    try:
        return (int(fields[0]), int(fields[1])) in keys
    except (ValueError, IndexError):
        return True


def _fast(rows: Sequence[tuple[int, list[str]]]) -> list[PoseLine] | None:
    """The lines of whole columns; None where a field needs a closer look."""
    posed = [fields for _, fields in rows if len(fields) != 2]
    if not rows or any(len(fields) != 9 for fields in posed):
        return None
    reference_ns = quick_counts([fields[0] for _, fields in rows])
    query_ns = quick_counts([fields[1] for _, fields in rows])
    numbers = quick_floats([text for fields in posed for text in fields[2:]])
    if reference_ns is None or query_ns is None or numbers is None:
        return None
    keys = list(zip(reference_ns, query_ns, strict=True))
    if len(set(keys)) < len(keys):
        return None
    values = np.array(numbers, dtype=np.float64).reshape(-1, 7)
    if (np.abs(np.linalg.norm(values[:, 3:], axis=1) - 1.0) > QUATERNION_TOLERANCE).any():
        return None
    transforms = iter(transform_from_tq(values[:, :3], values[:, 3:]))
    return [
        PoseLine(key[0], key[1], None if len(fields) == 2 else next(transforms), number)
        for key, (number, fields) in zip(keys, rows, strict=True)
    ]


def _one_by_one(
    rows: Sequence[tuple[int, list[str]]], path: Path, error: type[RelocbenchError], allow_non_finite: bool
) -> list[PoseLine]:
    """The lines field by field. Raises ``error`` with file and line."""
    keys: dict[PairKey, int] = {}
    poses: dict[int, list[float]] = {}
    for number, fields in rows:
        if len(fields) not in (2, 9):
            raise error(f"expected 2 or 9 columns ({POSE_LINE}), found {len(fields)}", path, number)
        key = parse_timestamp(fields[0], path, number, error), parse_timestamp(fields[1], path, number, error)
        if key in keys:
            raise error(f"pair {key[0]} {key[1]} occurs again (first on line {keys[key]})", path, number)
        keys[key] = number
        withheld = len(fields) == 2 or (allow_non_finite and any_non_finite(fields[2:]))
        if not withheld:
            poses[number] = parse_pose_numbers(fields[2:], path, number, error)
    values = np.array(list(poses.values()), dtype=np.float64).reshape(-1, 7)
    transforms = dict(zip(poses, transform_from_tq(values[:, :3], values[:, 3:]), strict=True))
    return [PoseLine(*key, transforms.get(number), number) for key, number in keys.items()]


def parse_pose_numbers(
    fields: list[str], path: Path, line: int, error: type[RelocbenchError] = DatasetError
) -> list[float]:
    """Parse ``tx ty tz qx qy qz qw``: seven finite numbers with a unit quaternion. Raises ``error`` with the line."""
    values = parse_floats(fields, path, line, _POSE_COLUMNS, error)
    norm = math.hypot(*values[3:])
    if abs(norm - 1.0) > QUATERNION_TOLERANCE:
        raise error(f"quaternion qx qy qz qw has norm {norm:.6g}, expected 1", path, line)
    return values


def parse_pose(fields: list[str], path: Path, line: int, error: type[RelocbenchError] = DatasetError) -> Array:
    """Parse ``tx ty tz qx qy qz qw`` as a (4, 4) transform. Raises ``error`` with file and line."""
    values = parse_pose_numbers(fields, path, line, error)
    return transform_from_tq(values[:3], values[3:])


def pose_fields(transform: Array, decimals: int | None = None) -> list[str]:
    """``tx ty tz qx qy qz qw`` as text, by ``number_fields``."""
    translation, quaternion = transform_to_tq(transform)
    return number_fields([*translation.tolist(), *quaternion.tolist()], decimals)


def number_fields(pose: Sequence[float], decimals: int | None = None) -> list[str]:
    """Numbers as text, rounded to ``decimals`` or in the fewest digits that read back; -0 is written as 0."""
    return [repr((value if decimals is None else round(value, decimals)) + 0.0) for value in pose]


def write_pose_lines(path: Path, lines: Sequence[PoseLine]) -> None:
    """Write a pair or prediction file in the given order."""
    write_text(path, pose_text(lines))


def pose_numbers(transforms: Sequence[Array | None]) -> Array:
    """``tx ty tz qx qy qz qw`` (M, 7) of the M known poses, computed together, which is much faster."""
    known = [T for T in transforms if T is not None]
    return np.concatenate(transform_to_tq(np.array(known, dtype=np.float64).reshape(-1, 4, 4)), axis=1)


def pose_text(pairs: Sequence[PoseLine | Pair], decimals: int | None = None) -> str:
    """Lines of two or nine columns, with numbers by ``number_fields``."""
    poses = iter(pose_numbers([pair.T_query_ref for pair in pairs]).tolist())
    numbers = [() if pair.T_query_ref is None else next(poses) for pair in pairs]
    return "".join(
        " ".join([*map(str, pair.key), *number_fields(pose, decimals)]) + "\n"
        for pair, pose in zip(pairs, numbers, strict=True)
    )


def any_non_finite(fields: Sequence[str]) -> bool:
    """Whether one of the fields is NaN or infinite."""
    # All three words contain an n, which no number does: hardly any line needs a look at each field.
    return "n" in "".join(fields).lower() and any(f.lower().lstrip("+-") in ("nan", "inf", "infinity") for f in fields)


def missing(fields: Sequence[str]) -> bool:
    """Whether the numbers of a pose say that there is none: one of them is blank, NaN or infinite."""
    return "" in fields or any_non_finite(fields)
