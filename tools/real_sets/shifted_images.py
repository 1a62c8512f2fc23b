"""Pairs of images of one place through a year, with the shift between them in pixels: the layout of GRIEF's datasets.

FOLDER holds ``images/SSPP.jpg``, session SS at place PP, and ``ground_truth/location_P.txt``, a table of sessions by
sessions: how far, in pixels, a thing stands farther right in the session of the column than in that of the row, set by
hand. Every two sessions of a place are a pair, with the earlier one as keyframe.

How the camera moved is not known beyond that shift. The pose that is written moves the camera sideways in front of a
plane across its axis, 5 m away, by which every point of the plane shifts by the pixels of the table: with the focal
length of 800 pixels, which is made up like the plane, 40 pixels are 0.25 m. A tracker may explain the same shift by a
turn, so that metres and degrees do not tell whether it found it; ``benchmarks/publish/shifts.py`` judges the shift.
"""

from __future__ import annotations

import argparse
from itertools import combinations
from pathlib import Path

import numpy as np
from generic_folder import Keyframe, Query, centred, made_up_ns, plane_depth, read

from relocbench.arrays import Array
from relocbench.errors import DatasetError

FOCAL, PLANE_M = 800.0, 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER")


def made(options: argparse.Namespace) -> dict[str, list[Query]]:
    """The queries of all places in one folder. Raises DatasetError: tables or images that do not serve."""
    tables = sorted((options.folder / "ground_truth").glob("location_*.txt"))
    if not tables:
        raise DatasetError("no location_P.txt; expected a table of shifts a place", options.folder / "ground_truth")
    queries: list[Query] = []
    for table in tables:
        shifts = read_shifts(table)
        paths = [_image_of(options.folder, session, table) for session in range(len(shifts))]
        images = [read(path) for path in paths]
        for image, path in zip(images, paths, strict=True):
            if image.shape != images[0].shape:
                raise DatasetError(
                    f"{image.shape[1]} x {image.shape[0]} pixels; expected those of {paths[0].name}", path
                )
        camera = centred(images[0].shape[1::-1], FOCAL)
        depth = plane_depth(camera, np.array([0.0, 0.0, 1.0 / PLANE_M]))
        first = len(queries)
        keyframes = [
            Keyframe(made_up_ns(first + session), image, depth, camera) for session, image in enumerate(images)
        ]
        for a, b in combinations(range(len(images)), 2):
            queries.append(Query(keyframes[a], made_up_ns(len(queries)), images[b], camera, sideways(shifts[a, b])))
    return {"seasons": queries}


def sideways(shift: float) -> Array:
    """``T_query_ref`` (4, 4) by which points of the plane shift to the right by so many pixels."""
    T_query_ref = np.eye(4)
    T_query_ref[0, 3] = shift * PLANE_M / FOCAL
    return T_query_ref


def read_shifts(path: Path) -> Array:
    """A table (S, S) of shifts. Raises DatasetError: it is not square, or not the same from both ends."""
    try:
        shifts = np.loadtxt(path, ndmin=2)
    except ValueError as bad:
        raise DatasetError(f"expected a table of numbers: {bad}", path) from None
    if shifts.shape[0] != shifts.shape[1] or not np.array_equal(shifts, -shifts.T):
        raise DatasetError("expected as many rows as columns, and entry (b, a) to be that of (a, b) negated", path)
    return shifts


def _image_of(folder: Path, session: int, table: Path) -> Path:
    return folder / "images" / f"{session + 1:02d}{int(table.stem.removeprefix('location_')):02d}.jpg"
