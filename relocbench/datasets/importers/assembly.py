"""Steps that importers share: the build's configuration, checks of folders, images, and pair sets."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.datasets.core import images
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import DatasetOptions, RuleOptions
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.motion.worlds import doubt_of_world
from relocbench.datasets.pairs.depth_scale import DepthFrame, depth_scale
from relocbench.datasets.pairs.pairing import make_pairs, steps_left_out
from relocbench.datasets.pairs.posed_frames import posed_frames
from relocbench.datasets.pairs.writing import write_pair_set
from relocbench.datasets.sensors.undistortion import undistort
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import Camera
from relocbench.progress import Reporter


def configuration(kind: str, sources: Sequence[Path], options: DatasetOptions) -> dict[str, Any]:
    """Everything that determines the build, in the form that ``build.yaml`` has."""
    return {
        "kind": kind,
        "sources": [str(source.resolve()) for source in sources],
        "options": options.recorded(),
    }


def open_writer(
    kind: str, sources: Sequence[Path], options: DatasetOptions, out: Path, default_name: str
) -> DatasetWriter:
    """The writer of a build. Raises DatasetError or ConfigError like :class:`DatasetWriter`."""
    name = options.name or default_name
    return DatasetWriter(out, name, configuration(kind, sources, options), options.licence)


def check_folder(path: Path, expected: str) -> None:
    """Raise DatasetError if ``path`` is not a folder."""
    if not path.is_dir():
        raise DatasetError(f"{'is a file' if path.exists() else 'no such folder'}; expected {expected}", path)


def check_several(drives: Sequence[object]) -> None:
    """Raise ConfigError unless there is a reference and a query."""
    if len(drives) < 2:
        raise ConfigError(f"ground truth across drives needs a reference and at least one query, got {len(drives)}")


def import_image(
    writer: DatasetWriter, frame: tuple[str, str, int], path: Path, camera: Camera, size_from: str, *, copy: bool
) -> None:
    """Link or copy an image of a pinhole camera, and undistort that of another.

    Args:
        frame: traversal, camera and timestamp_ns.
        size_from: where the camera's size is from, for messages.

    Raises:
        DatasetError: the image is missing, damaged or not of the camera's size.
    """
    size = images.ExpectedSize(camera.size, size_from)
    if camera.model == "pinhole":
        images.read_image(path, size)
        writer.link_image(*frame, path, copy=copy)
    elif writer.needs_image(*frame):
        writer.image(*frame, undistort(images.read_image(path, size), camera))


def note_depth_scale(
    frames: Sequence[DepthFrame], what: str, metres_per_unit: float, name: str, reporter: Reporter
) -> None:
    """Note that depth contradicts the poses, or has values that a dataset cannot hold.

    Args:
        what: what says the unit of depth, in words.
        metres_per_unit: the unit that it says.
        name: the traversal.

    Raises:
        DatasetError: a depth image is damaged.
    """
    found = depth_scale(frames)
    if found is not None and found.contradicts:
        reporter.note(f"{name}: {found.words(what, metres_per_unit)}")
        return
    for frame in frames[:1]:
        known = frame.read()
        known = known[known > 0]
        typical = float(np.median(known)) if known.size else images.DEPTH_STEP_M
        if not images.DEPTH_STEP_M <= typical <= images.MOST_DEPTH_M:
            limits = f"{images.DEPTH_STEP_M:g} to {images.MOST_DEPTH_M:g} m"
            reporter.note(f"{name}: the median depth is {typical:g} m by {what}, and a dataset holds {limits}")


def write_pairs(
    job: Build[RuleOptions],
    reference: str,
    query: str,
    camera: str,
    *,
    source: str,
    where: Path,
    numbers: dict[int, int] | None = None,
    starts: Collection[int] = (),
) -> None:
    """Write a pair set by the pairing rule of the options, with its correspondences.

    The traversals must have been written before, with images and depth.

    Args:
        source: how the poses were obtained.
        where: the recording's folder, for messages.
        numbers, starts: as of :func:`posed_frames`.
    """
    drives = {name: Traversal(job.writer.layout.traversal(name)) for name in (reference, query)}
    same = query == reference
    frames = (
        posed_frames(drives[reference], camera, numbers, starts),
        posed_frames(drives[query], camera, numbers if same else None, starts if same else ()),
    )
    pairs = make_pairs(*frames, job.options, same_traversal=same, source=source, where=where)
    ordered = not drives[query].names
    if same and ordered and (missing := steps_left_out(frames[0], job.options)):
        job.reporter.note(f"{reference}: {missing}")
    if not same and ordered and (doubt := doubt_of_world(drives[reference].poses, drives[query].poses)):
        job.reporter.note(f"{reference} and {query} {doubt}")
    _note_unpaired(drives[query], camera, {p.query_timestamp_ns for p in pairs}, job, same)
    write_pair_set(job, reference, query, camera, pairs)


def _note_unpaired(
    query: Traversal, camera: str, paired: set[int], job: Build[RuleOptions], same_traversal: bool
) -> None:
    """Report query frames without a pair. Under the nearest rule, each should have a keyframe."""
    options = job.options
    if options.pair_rule == "step" or (same_traversal and options.pair_rule is None):
        return
    frames = [t for t in query.timestamps(camera) if t in query.poses]
    left_out = sum(t not in paired for t in frames)
    if left_out:
        job.reporter.note(
            f"{query.name}: {left_out} of {len(frames)} query frames are in no pair: no keyframe is within "
            f"--max-distance {options.max_distance:g} m and --max-angle {options.max_angle:g} deg"
        )
