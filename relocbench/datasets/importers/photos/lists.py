"""Pairs of images by name, and which of a model's images are queries."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from relocbench.datasets.core.named_poses import read_words
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.importers.photos.collection import Photo
from relocbench.datasets.pairs.posed_frames import relative_pose
from relocbench.errors import DatasetError, quoted
from relocbench.geometry import invert

NamedPairs = Iterable[tuple[int, tuple[str, str]]]
"""line number, and the names of query and keyframe"""


def chosen_queries(names: Collection[str], patterns: Sequence[str], where: Path) -> set[str]:
    """The names that one of the patterns fits.

    Raises:
        DatasetError: there are patterns and none fits, or all names are chosen, so that none is left for the map.
    """
    chosen = {name for name in names if any(fnmatchcase(name, pattern) for pattern in patterns)}
    if patterns and not chosen:
        raise DatasetError(f"no image is named like {', '.join(map(quoted, patterns))}", where)
    if patterns and len(chosen) == len(names):
        raise DatasetError(f"all {len(names)} images are queries; none is left for the map", where)
    return chosen


def listed_pairs(path: Path) -> Iterator[tuple[int, tuple[str, str]]]:
    """Line number and the names of query and keyframe of each line. Raises DatasetError with file and line."""
    for line, fields in read_words(path, "pairs (query keyframe)", DatasetError):
        if len(fields) != 2:
            raise DatasetError(f"expected 2 names (query keyframe), found {len(fields)}", path, line)
        yield line, (fields[0], fields[1])


def pairs_by_name(
    path: Path, listed: NamedPairs, keyframes: Sequence[Photo], queries: Mapping[str, Sequence[Photo]], source: str
) -> dict[str, list[Pair]]:
    """Traversal of the queries -> the pairs of a list, with the truth of those whose query has a pose.

    Args:
        path: the list's file, for messages.
        listed: what it holds.
        keyframes: photos with poses.
        queries: traversal -> its photos.
        source: how the poses were obtained.

    Raises:
        DatasetError: with file and line: a name that no photo has, or that photos of two traversals have, a pair that
            occurs again; or a traversal without pairs.
    """
    references = {photo.name: photo for photo in keyframes}
    asked: dict[str, tuple[str, Photo]] = {}
    twice: set[str] = set()
    for traversal, photos in queries.items():
        twice.update(photo.name for photo in photos if photo.name in asked)
        asked.update((photo.name, (traversal, photo)) for photo in photos)
    pairs: dict[str, dict[tuple[int, int], Pair]] = {traversal: {} for traversal in queries}
    for line, (query_name, reference_name) in listed:
        reference, found = references.get(reference_name), asked.get(query_name)
        if reference is None or found is None:
            unknown, what = (reference_name, "keyframe") if reference is None else (query_name, "query")
            raise DatasetError(f"{quoted(unknown)} is not a {what} of this dataset", path, line)
        if query_name in twice:
            raise DatasetError(f"{quoted(query_name)} is a query of two traversals of this dataset", path, line)
        traversal, query = found
        assert reference.T_cam_world is not None
        truth = None
        if query.T_cam_world is not None:
            truth = relative_pose(invert(query.T_cam_world), invert(reference.T_cam_world))
        pair = Pair(reference.time, query.time, truth, source=source)
        if pair.key in pairs[traversal]:
            raise DatasetError(f"the pair {query_name} {reference_name} occurs again", path, line)
        pairs[traversal][pair.key] = pair
    for traversal, found_pairs in pairs.items():
        if not found_pairs:
            of = f" of {quoted(traversal)}" if len(pairs) > 1 else ""
            raise DatasetError(f"holds no pair{of}; expected lines 'query keyframe'", path)
    return {traversal: list(found_pairs.values()) for traversal, found_pairs in pairs.items()}
