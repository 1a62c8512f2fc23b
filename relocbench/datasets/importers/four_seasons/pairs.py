"""Pairs from relocalization files: the recordings that each line refers to, and its true pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.pairfile import Pair, PairKey, PoseLine, read_pose_lines
from relocbench.datasets.importers.four_seasons.recording import CAMERAS, Recording
from relocbench.datasets.pairs.posed_frames import relative_pose
from relocbench.errors import DatasetError
from relocbench.geometry import invert, rotation_angle
from relocbench.progress import Reporter

SetKey = tuple[str, str]
"""(reference traversal, query traversal)"""
DIFFICULTIES = ("easy", "moderate", "hard")


@dataclass(frozen=True, eq=False)
class ListedPair:
    """One line of a relocalization file."""

    reference: Recording
    query: Recording
    line: PoseLine
    file: Path

    @property
    def group(self) -> str:
        """``easy``, ``moderate`` or ``hard`` if the file's name ends with it, else empty."""
        ending = self.file.stem.rpartition("_")[2]
        return ending if ending in DIFFICULTIES else ""


def read_relocalization_files(paths: Sequence[Path], recordings: Sequence[Recording]) -> list[ListedPair]:
    """All lines of the files, or of the ``*.txt`` in folders, each with the recordings that its timestamps belong to.

    Raises:
        DatasetError: with file and line: no recording has a timestamp, or a pair occurs twice.
    """
    listed: list[ListedPair] = []
    first: dict[PairKey, ListedPair] = {}
    for file in _expand(paths):
        for line in read_pose_lines(file, allow_non_finite=True):
            reference = _owner(line.ref_timestamp_ns, "reference", recordings, file, line.line)
            query = _owner(line.query_timestamp_ns, "query", recordings, file, line.line)
            pair = ListedPair(reference, query, line, file)
            if line.key in first:
                before = first[line.key]
                where = f"{before.file.name}:{before.line.line}"
                raise DatasetError(f"pair {line.key[0]} {line.key[1]} is already listed in {where}", file, line.line)
            first[line.key] = pair
            listed.append(pair)
    return listed


def pairs_of_files(
    listed: Sequence[ListedPair], frames: Mapping[str, Array], from_poses: bool, reporter: Reporter
) -> dict[SetKey, list[Pair]]:
    """Pair sets from the lines of relocalization files.

    Args:
        frames: traversal name -> (4, 4) transform from its frame to the common one; see ``common_frames``.
        from_poses: compute missing true poses from the two recordings' poses, if these share a frame.

    Raises:
        DatasetError: with file and line: an image of a recording with images is missing.
    """
    sets: dict[SetKey, list[Pair]] = {}
    for pair in listed:
        if pair.reference.has_images and pair.query.has_images:
            _check_images(pair)
            key = pair.reference.name, pair.query.name
            sets.setdefault(key, []).append(_with_truth(pair, frames, from_poses))
    left_out = sum(not (p.reference.has_images and p.query.has_images) for p in listed)
    if left_out:
        reporter.note(f"{left_out} listed pairs are left out: a recording has no undistorted_images/{CAMERAS[0]}")
    bare = {p.line.ref_timestamp_ns for p in listed if p.line.ref_timestamp_ns not in p.reference.keyframes}
    if bare:
        reporter.note(f"{len(bare)} listed references have no keyframe file; methods that need points will fail there")
    _compare_with_poses(listed, frames, reporter)
    for key, pairs in sets.items():
        withheld = sum(p.T_query_ref is None for p in pairs)
        if withheld:
            reporter.note(f"{withheld} of {len(pairs)} pairs of {' and '.join(key)} have no true pose: it is withheld")
    return sets


def _with_truth(pair: ListedPair, frames: Mapping[str, Array], from_poses: bool) -> Pair:
    T_query_ref, source = pair.line.T_query_ref, pair.file.name
    if T_query_ref is None and from_poses:
        T_query_ref = pose_between(pair, frames)
        source += f", pose from {pair.reference.pose_source}" if T_query_ref is not None else ""
    return Pair(*pair.line.key, T_query_ref, group=pair.group, source=source)


def pose_between(pair: ListedPair, frames: Mapping[str, Array]) -> Array | None:
    """(4, 4) ``T_query_ref`` from the recordings' own poses; None if it cannot be computed from them."""
    reference, query = pair.reference, pair.query
    T_wr_ref = reference.T_w_cam.get(pair.line.ref_timestamp_ns)
    T_wq_query = query.T_w_cam.get(pair.line.query_timestamp_ns)
    if T_wr_ref is None or T_wq_query is None:
        return None
    if reference is query:
        return relative_pose(T_wq_query, T_wr_ref)
    if reference.name not in frames or query.name not in frames:
        return None
    return relative_pose(frames[query.name] @ T_wq_query, frames[reference.name] @ T_wr_ref)


def _compare_with_poses(listed: Sequence[ListedPair], frames: Mapping[str, Array], reporter: Reporter) -> None:
    """Report how listed poses differ from the recordings' own, which reveals a swapped or misread file."""
    differences = []
    for pair in listed:
        given, own = pair.line.T_query_ref, pose_between(pair, frames)
        if given is not None and own is not None:
            differences.append(invert(given) @ own)
    if differences:
        stack = np.array(differences)
        metres = np.median(np.linalg.norm(stack[:, :3, 3], axis=1))
        degrees = np.degrees(np.median(np.asarray(rotation_angle(stack[:, :3, :3]))))
        reporter.note(
            f"{len(stack)} listed poses differ from the recordings' own by {metres:.3g} m and {degrees:.3g} deg "
            "(median)"
        )


def _check_images(pair: ListedPair) -> None:
    for recording, time in (
        (pair.reference, pair.line.ref_timestamp_ns),
        (pair.query, pair.line.query_timestamp_ns),
    ):
        if time not in recording.images[CAMERAS[0]]:
            folder = f"undistorted_images/{CAMERAS[0]}"
            raise DatasetError(f"{recording.name}/{folder} has no image {time}", pair.file, pair.line.line)


def _owner(time: int, what: str, recordings: Sequence[Recording], file: Path, line: int) -> Recording:
    for recording in recordings:
        if time in recording.times:
            return recording
    names = ", ".join(r.name for r in recordings)
    raise DatasetError(f"{what} {time} is not a frame of any of the recordings ({names})", file, line)


def _expand(paths: Sequence[Path]) -> list[Path]:
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(path.glob("*.txt"))
            if not inside:
                raise DatasetError("holds no relocalization file (*.txt)", path)
            files.extend(inside)
        else:
            files.append(path)
    return files
