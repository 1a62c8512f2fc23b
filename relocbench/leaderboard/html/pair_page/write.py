"""Writing the page of a pair: the poses of all methods on the pairs of a pair set, and the pictures of some pairs.

The page takes errors, seconds and confidences from the payload that the page of the set has too; what is written here
lies beside it. ``data/pairs/SET/PAIRSET.js`` holds answers and truth, ``data/images`` and ``data/depths`` one file for
each image that a chosen pair shows, whichever pairs show it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey, read_pose_lines
from relocbench.datasets.core.upright import R_frame_camera
from relocbench.errors import PredictionError
from relocbench.evaluation.tables.answers import read_answers
from relocbench.execution import run_units
from relocbench.geometry import Camera, invert, make_transform
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.chosen import kept_rows, worst_and_drawn
from relocbench.leaderboard.html.data import floats, write_data
from relocbench.leaderboard.html.pair_page.pictures import depth_payload, image_payload, shown_matches
from relocbench.leaderboard.tracking.method import Method
from relocbench.leaderboard.tracking.model import Board, DatasetBoard
from relocbench.metrics import CORRECT
from relocbench.progress import Reporter, Silent

USUAL_PAIRS = 6
"""pairs with pictures: so many worst ones of each method, and so many drawn at random, in each pair set"""


@dataclass(frozen=True, order=True)
class _Picture:
    """One image to be written, with or without the depth of a keyframe."""

    traversal: str
    camera: str
    timestamp_ns: int
    is_keyframe: bool


@dataclass(frozen=True)
class _Job:
    """A picture, with where it comes from and goes to."""

    dataset: Dataset = field(repr=False)
    site: Path
    of_set: str
    picture: _Picture


def write_pair_pages(
    board: Board, site: Path, *, pairs: int = USUAL_PAIRS, reporter: Reporter | None = None
) -> set[Path]:
    """Write what the page of a pair loads; returns the paths of all files.

    Truth and pictures are there only for datasets that are available.

    Args:
        site: the folder of the site.
        pairs: in each pair set, pictures are made of so many worst pairs of each method that is no trivial baseline,
            of as many pairs drawn at random, and of the one in the middle.
        reporter: receives the number of pictures that are done.

    Raises:
        PredictionError: a file of predictions is bad.
        DatasetError: an image of a dataset cannot be read.
    """
    asked = [(dataset, name) for dataset in board.datasets for name in dataset.entry.pair_sets]
    rows = sum(len(m.errors[name]) for dataset, name in asked for m in _methods(dataset, name))
    written: set[Path] = set()
    jobs: dict[Path, _Job] = {}
    for dataset, name in asked:
        methods = _methods(dataset, name)
        if not methods:
            continue
        chosen = chosen_pairs(methods, name, pairs)
        kept = kept_rows(chosen, len(methods[0].errors[name]), rows)
        payload = _answers_payload(dataset, name, methods, kept, chosen)
        written.add(write_data(site, links.unit_key("pairs", dataset.entry.record, name), payload))
        if dataset.entry.dataset is not None and _has_images(dataset.entry.dataset, name):
            keys = methods[0].errors[name].keys
            jobs |= _jobs(
                dataset, dataset.entry.dataset, name, [(int(keys[i, 0]), int(keys[i, 1])) for i in chosen], site
            )
    return written | _write_pictures(list(jobs.values()), reporter or Silent())


def chosen_pairs(methods: Sequence[Method], pair_set: str, count: int) -> list[int]:
    """The rows of the pairs that are shown with pictures, in ascending order.

    They are the ``count`` worst of each method that is no trivial baseline, by the larger of both errors in units of
    what counts as correct, ``count`` drawn at random, and the one in the middle, which stands for the set at the head
    of columns; none where ``count`` is 0.
    """
    pairs = len(methods[0].errors[pair_set])
    worst = [m.errors[pair_set].errors.joint_error(*CORRECT) for m in methods if not m.is_baseline]
    return sorted({*worst_and_drawn(worst, pairs, count), *([pairs // 2] if count and pairs else [])})


def middle_picture(dataset: DatasetBoard, pair_set: str) -> str | None:
    """The key of the picture of the query in the middle of a pair set; None where there is none."""
    known, methods = dataset.entry.dataset, _methods(dataset, pair_set)
    if known is None or not methods or not _has_images(known, pair_set):
        return None
    keys = methods[0].errors[pair_set].keys
    folder = _folders(known.pair_set(pair_set))["query"]
    return f"images/{links.set_id(dataset.entry.record)}/{folder}/{int(keys[len(keys) // 2, 1])}"


def _methods(dataset: DatasetBoard, pair_set: str) -> list[Method]:
    return [method for method in dataset.entry.methods if pair_set in method.errors]


def _answers_payload(
    dataset: DatasetBoard, name: str, methods: Sequence[Method], kept: Sequence[int], chosen: Sequence[int]
) -> dict[str, Any]:
    """The poses of the rows that are kept, (3, 4) each and NaN where there is none, and what methods said."""
    keys = [(int(ref), int(query)) for ref, query in methods[0].errors[name].keys[list(kept)].tolist()]
    known = dataset.entry.dataset
    pair_set = None if known is None else known.pair_set(name)
    only = None if len(keys) == len(methods[0].errors[name]) else frozenset(keys)
    places = {row: place for place, row in enumerate(kept)}
    pictured = known is not None and _has_images(known, name)
    shown = [places[row] for row in chosen] if pictured else []
    cameras = {} if known is None or pair_set is None else _cameras(known, pair_set, keys, shown)
    alone = known is not None and pair_set is not None and not pictured
    axes = _camera_axes(known, pair_set) if known is not None and pair_set is not None and alone else None
    truth = None if pair_set is None else _poses([pair_set.by_key[key].T_query_ref for key in keys], axes)
    return {
        "rows": None if only is None else list(kept),
        "truth": truth,
        "methods": {method.label: _answers(method, name, keys, only, cameras, axes) for method in methods},
        **({"alone": True} if alone else {}),
        "pictured": shown,
        "images": _folders(pair_set) if pair_set is not None and pictured else {},
        "set": links.set_id(dataset.entry.record),
    }


def _has_images(known: Dataset, name: str) -> bool:
    return known.has_images(known.pair_set(name))


def _answers(
    method: Method,
    name: str,
    keys: Sequence[PairKey],
    only: frozenset[PairKey] | None,
    cameras: Mapping[int, tuple[Camera, Camera]],
    axes: Array | None,
) -> dict[str, Any]:
    """The poses of a method, its messages, and the matches that it tells of pairs with pictures, by their places."""
    if method.results is None:
        return {"poses": _poses([None] * len(keys), axes), "messages": {}, "matches": {}}
    path = method.results.predictions(name)
    lines = read_pose_lines(path, PredictionError, allow_non_finite=True, only=only)
    poses = {line.key: line.T_query_ref for line in lines}
    table = method.results.answers(name)
    answers = read_answers(table, only) if table.exists() else {}
    messages = {place: answers[key].message for place, key in enumerate(keys) if key in answers}
    matches = {
        place: shown_matches(answers[keys[place]].info, *both)
        for place, both in cameras.items()
        if keys[place] in answers
    }
    return {
        "poses": _poses([poses.get(key) for key in keys], axes),
        "messages": {place: message for place, message in messages.items() if message},
        "matches": {place: some for place, some in matches.items() if some},
    }


def _cameras(
    known: Dataset, pair_set: PairSet, keys: Sequence[PairKey], shown: Sequence[int]
) -> dict[int, tuple[Camera, Camera]]:
    """The cameras of the keyframe and the query of pairs with pictures, by their places."""
    reference, query = known.traversal(pair_set.reference), known.traversal(pair_set.query)
    cameras = pair_set.cameras
    return {p: (reference.camera(cameras[0], keys[p][0]), query.camera(cameras[1], keys[p][1])) for p in shown}


def _camera_axes(known: Dataset, pair_set: PairSet) -> Array:
    """(4, 4) from the axes of a camera, in which the page draws poses from above, to those of a frame."""
    reference = known.traversal(pair_set.reference)
    poses = np.array(list(reference.poses.values())).reshape(-1, 4, 4) @ reference.T_rig_cam(pair_set.reference_camera)
    return make_transform(R_frame_camera(poses), np.zeros(3))


def _poses(poses: Sequence[Array | None], axes: Array | None) -> dict[str, str]:
    """The upper three rows of each ``T_query_ref``, in other axes (4, 4) if they are given, one after the other."""
    out = np.full((len(poses), 3, 4), np.nan)
    for place, pose in enumerate(poses):
        if pose is not None:
            out[place] = (pose if axes is None else invert(axes) @ pose @ axes)[:3]
    return floats(out)


def _folders(pair_set: PairSet) -> dict[str, str]:
    """The part of the keys of pictures that is the same for all keyframes, and for all queries."""
    return {
        "reference": links.file_id(f"{pair_set.reference}__{pair_set.reference_camera}"),
        "query": links.file_id(f"{pair_set.query}__{pair_set.query_camera}"),
    }


def _jobs(dataset: DatasetBoard, known: Dataset, name: str, keys: Iterable[PairKey], site: Path) -> dict[Path, _Job]:
    """The pictures of some pairs, by the first file that each writes; one that is also a keyframe has its depth."""
    of_set, pair_set = links.set_id(dataset.entry.record), known.pair_set(name)
    wanted: set[_Picture] = set()
    for reference_ns, query_ns in keys:
        wanted.add(_Picture(pair_set.reference, pair_set.reference_camera, reference_ns, True))
        wanted.add(_Picture(pair_set.query, pair_set.query_camera, query_ns, False))
    jobs = [_Job(known, site, of_set, picture) for picture in sorted(wanted)]
    return {site / links.data_file(_key(job, "depths" if job.picture.is_keyframe else "images")): job for job in jobs}


def _key(job: _Job, kind: str) -> str:
    picture = job.picture
    folder = links.file_id(f"{picture.traversal}__{picture.camera}")
    return f"{kind}/{job.of_set}/{folder}/{picture.timestamp_ns}"


def _write_pictures(jobs: list[_Job], reporter: Reporter) -> set[Path]:
    written: set[Path] = set()
    keyframes = {_key(job, "images") for job in jobs if job.picture.is_keyframe}
    own = [job for job in jobs if job.picture.is_keyframe or _key(job, "images") not in keyframes]
    with reporter.stage("pictures of pairs", len(own)) as advance:
        for _, paths in run_units(_write_picture, own):
            written |= paths
            advance(1)
    return written


def _write_picture(job: _Job) -> set[Path]:
    picture = job.picture
    traversal = job.dataset.traversal(picture.traversal)
    if not picture.is_keyframe:
        query = traversal.query(picture.camera, picture.timestamp_ns)
        payload = image_payload(query.image, query.camera) | _file_of(job)
        return {write_data(job.site, _key(job, "images"), payload)}
    keyframe = traversal.reference(picture.camera, picture.timestamp_ns)
    return {
        write_data(job.site, _key(job, "images"), image_payload(keyframe.image, keyframe.camera) | _file_of(job)),
        write_data(job.site, _key(job, "depths"), depth_payload(keyframe)),
    }


def _file_of(job: _Job) -> dict[str, str]:
    """Where the image itself is in the dataset. It is named and not linked: a site may be moved, and its bytes are
    the same wherever it is written."""
    picture, layout = job.picture, job.dataset.traversal(job.picture.traversal).layout
    path = layout.find_image(picture.camera, picture.timestamp_ns)
    return {} if path is None else {"file": path.relative_to(job.dataset.root).as_posix()}
