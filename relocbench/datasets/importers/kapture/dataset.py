"""Build a dataset from kapture folders, the form in which Naver Labs Europe publishes Aachen, CMU, RobotCar Seasons,
7-Scenes, Cambridge, 4Seasons and others.

The first folder is the map, further ones hold queries; of a single folder, names may tell queries from keyframes. All
images of a folder are one collection, whatever sensor took them: photo collections have a sensor for each image, and
lists of pairs ask an image of one camera of a rig about a keyframe of another.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import Field

from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.named_poses import read_named_poses
from relocbench.datasets.importers.assembly import check_folder, open_writer, write_pairs
from relocbench.datasets.importers.kapture.depth import Depth
from relocbench.datasets.importers.kapture.folder import KaptureFolder, is_kapture, read_folder
from relocbench.datasets.importers.kapture.tables import Record, read_fields
from relocbench.datasets.importers.photos.collection import (
    CAMERA,
    MAP,
    QUERY,
    STEP_NS,
    ModelPoints,
    Photo,
    in_metres,
    without_far,
    write_traversal,
)
from relocbench.datasets.importers.photos.lists import chosen_queries, listed_pairs, pairs_by_name
from relocbench.datasets.importers.photos.options import PhotoOptions
from relocbench.datasets.importers.photos.points import Observations
from relocbench.datasets.pairs.writing import write_pair_set
from relocbench.datasets.sensors.plausible_poses import plausible
from relocbench.datasets.sensors.pose_tables import PoseTable
from relocbench.datasets.sensors.times import unit_of_dates
from relocbench.datasets.sensors.trajectories import traversal_names
from relocbench.errors import ConfigError, DatasetError, quoted
from relocbench.execution import Run
from relocbench.files import fitting_name, lines_of, read_text
from relocbench.geometry import invert
from relocbench.progress import Reporter

_SOURCE = "kapture"
_PARTS = ("mapping", "query")
"""folders of a data set that is given as one"""


class Options(PhotoOptions):
    """Options of ``relocbench build-dataset kapture``."""

    PATHS: ClassVar[tuple[str, ...]] = ("query_poses", "pairs")

    cameras: tuple[str, ...] = Field(
        (), description="identifiers of the cameras to import, with * and ? as in file names; default: all"
    )
    queries: tuple[str, ...] = Field(
        (),
        description="names of the images of a single folder that are queries and no keyframes, with * and ? as in file "
        "names, such as 'query/*'; default: every image is both",
    )
    query_poses: Path | None = Field(
        None,
        description="true poses of queries that have none, camera from world: lines 'name qw qx qy qz tx ty tz'; "
        "default: withheld",
    )
    pairs: Path | None = Field(
        None,
        description="pairs of image names: lines 'query, keyframe, score', as kapture has them, or 'query keyframe', "
        "as hloc writes them; default: by --pair-rule",
    )
    metres_per_unit: float = Field(
        1.0, gt=0, description="length of the unit of poses and points; depth maps are in metres"
    )
    noise_px: float = Field(0.5, gt=0, description="standard deviation of a keypoint in pixels")


@dataclass(frozen=True, eq=False)
class _Part:
    """The images of a folder that make a traversal."""

    name: str
    folder: KaptureFolder
    images: list[tuple[int, Record]]
    """number in the folder, and record"""


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from kapture folders. Raises as :class:`Importer`.

    Args:
        sources: the map and any number of folders of queries, or one folder, or one that holds ``mapping`` and
            ``query``.
    """
    assert isinstance(options, Options)
    options.check_pairs()
    roots = _roots(sources)
    if len(roots) > 1 and options.queries:
        raise ConfigError("--queries names images of a single folder; of several, the first is the map")
    names = traversal_names(roots) if len(roots) > 1 else [MAP, QUERY] if options.queries else [MAP]
    options.check_conditions(names)
    folders = []
    with reporter.stage("tables", len(roots)) as advance:
        for root in roots:
            folders.append(read_folder(root))
            advance(1)
    judged = [_on_their_way(folder, _of_cameras(folder, options.cameras), options, reporter) for folder in folders]
    reference, *others = parts = _parts(folders, [images for images, _ in judged], names, options)
    keyframes = without_far(_keyframes(reference, options, reporter), reference.folder.root, reporter)
    queries = {part.name: without_far(_photos(part, options), part.folder.root, reporter) for part in others}
    if options.query_poses is not None:
        queries = _with_poses(queries, options.query_poses, options.metres_per_unit, reporter)
    _check_truth(queries, options, reporter)
    called = sources[0].resolve().name if len(sources) == 1 else "-".join(names)
    writer = open_writer("kapture", [*sources, *options.paths], options, out, fitting_name(f"kapture_{called}"))
    job = Build(writer, options, reporter, run)
    for part, photos in zip(parts, (keyframes, *queries.values()), strict=True):
        write_traversal(job, part.name, photos, _depth(part, options, reporter), _SOURCE)
    asked = queries or {MAP: keyframes}
    taken = {record.name: record.timestamp for _, record in reference.images}
    after = [[photo.time for photo in keyframes if taken[photo.name] >= start] for start in judged[0][1]]
    starts = {min(times) for times in after if times}
    if options.pairs is None:
        for query in asked:
            write_pairs(job, reference.name, query, CAMERA, source=_SOURCE, where=roots[0], starts=starts)
    else:
        chosen = pairs_by_name(options.pairs, _listed(options.pairs), keyframes, asked, _SOURCE)
        for query, pairs in chosen.items():
            write_pair_set(job, reference.name, query, CAMERA, pairs)
    return writer.finish()


def _roots(sources: Sequence[Path]) -> list[Path]:
    """The kapture folders of what was given: itself, or ``mapping`` and ``query`` of a folder that holds both."""
    for source in sources:
        check_folder(source, "a kapture folder")
    if len(sources) == 1 and not is_kapture(sources[0]):
        parts = [sources[0] / name for name in _PARTS]
        if all(map(is_kapture, parts)):
            return parts
    for source in sources:
        if not is_kapture(source):
            raise DatasetError("holds no kapture data; expected sensors/sensors.txt", source)
    return list(sources)


def _parts(
    folders: Sequence[KaptureFolder],
    chosen: Sequence[list[tuple[int, Record]]],
    names: Sequence[str],
    options: Options,
) -> list[_Part]:
    """The traversals, the map first."""
    if len(folders) == len(names):
        return [_Part(*part) for part in zip(names, folders, chosen, strict=True)]
    (folder,), (images,) = folders, chosen
    asked = chosen_queries([record.name for _, record in images], options.queries, folder.root)
    return [
        _Part(names[0], folder, [(number, record) for number, record in images if record.name not in asked]),
        _Part(names[1], folder, [(number, record) for number, record in images if record.name in asked]),
    ]


def _of_cameras(folder: KaptureFolder, cameras: Sequence[str]) -> list[tuple[int, Record]]:
    """The images of the chosen cameras, with their numbers."""
    known = {record.device for record in folder.images}
    chosen = {name for name in known if not cameras or any(fnmatchcase(name, pattern) for pattern in cameras)}
    if not chosen:
        message = f"no camera matches {', '.join(map(quoted, cameras))}; available: {', '.join(sorted(known))}"
        raise DatasetError(message, folder.root)
    return [(number, record) for number, record in enumerate(folder.images) if record.device in chosen]


def _on_their_way(
    folder: KaptureFolder, images: list[tuple[int, Record]], options: Options, reporter: Reporter
) -> tuple[list[tuple[int, Record]], list[int]]:
    """The images without those whose poses no drive can have had, and timestamps before which nobody knows the way.

    Each sensor is judged by its own times, if they are dates. Others may be mere numbers: nothing follows from them.

    Raises:
        DatasetError: the poses of a sensor cannot be those of one drive.
    """
    unit_ns = unit_of_dates({record.timestamp for _, record in images})
    if unit_ns is None:
        return images, []
    left_out: set[Record] = set()
    starts: set[int] = set()
    for device in sorted({record.device for _, record in images}):
        posed = {
            record: in_metres(T_cam_world, options.metres_per_unit)
            for _, record in images
            if record.device == device and (T_cam_world := folder.T_device_world(device, record.timestamp)) is not None
        }
        table = PoseTable(
            folder.root / "sensors" / "records_camera.txt",
            np.array([record.timestamp for record in posed], dtype=np.int64) * unit_ns,
            invert(np.array(list(posed.values())).reshape(-1, 4, 4)),
            [record.line for record in posed],
        )
        found = plausible(table, reporter)
        kept = set(found.lines)
        left_out |= {record for record in posed if record.line not in kept}
        starts |= {int(found.times_ns[row]) // unit_ns for row in found.breaks}
    return [(number, record) for number, record in images if record not in left_out], sorted(starts)


def _photos(part: _Part, options: Options) -> list[Photo]:
    """The photos of a traversal, in the order of their times and sensors."""
    folder = part.folder
    photos = []
    for index, (number, record) in enumerate(part.images, start=1):
        path = folder.path(record)
        if not path.exists():
            table = folder.root / "sensors" / "records_camera.txt"
            raise DatasetError(f"no image {quoted(record.name)} in sensors/records_data", table, record.line)
        T_cam_world = folder.T_device_world(record.device, record.timestamp)
        pose = None if T_cam_world is None else in_metres(T_cam_world, options.metres_per_unit)
        in_model = number if number in folder.model.images else None
        photos.append(Photo(record.name, STEP_NS * index, path, folder.camera(record.device), pose, in_model))
    return photos


def _keyframes(part: _Part, options: Options, reporter: Reporter) -> list[Photo]:
    """The photos of the map: images without pose are left out."""
    folder = part.folder
    posed = [(n, r) for n, r in part.images if folder.T_device_world(r.device, r.timestamp) is not None]
    if not posed:
        table = folder.root / "sensors" / "trajectories.txt"
        raise DatasetError("no image of the map has a pose; expected one of its sensor or rig at its time", table)
    if len(posed) < len(part.images):
        reporter.note(
            f"{part.name}: {len(part.images) - len(posed)} of {len(part.images)} images have no pose and are left out"
        )
    return _photos(_Part(part.name, folder, posed), options)


def _with_poses(
    queries: dict[str, list[Photo]], path: Path, metres_per_unit: float, reporter: Reporter
) -> dict[str, list[Photo]]:
    """The queries, with the poses of a file for those that have none."""
    poses = read_named_poses(path, reporter=reporter)
    known = {photo.name: photo for photos in queries.values() for photo in photos}
    for name in poses:
        if name not in known:
            raise DatasetError(f"has a pose of {quoted(name)}, which is not a query", path)
        if known[name].T_cam_world is not None:
            raise DatasetError(f"has a pose of {quoted(name)}, which trajectories.txt has too", path)
    return {
        name: [
            replace(photo, T_cam_world=in_metres(poses[photo.name], metres_per_unit)) if photo.name in poses else photo
            for photo in photos
        ]
        for name, photos in queries.items()
    }


def _check_truth(queries: Mapping[str, Sequence[Photo]], options: Options, reporter: Reporter) -> None:
    """Tell how many queries have no pose. Raises ConfigError where all have none and no list tells their keyframes."""
    for name, photos in queries.items():
        withheld = sum(photo.T_cam_world is None for photo in photos)
        if withheld == len(photos) and options.pairs is None:
            raise ConfigError(
                f"queries without poses, as those of {name}, have no nearest keyframe; name their keyframes by --pairs"
            )
        if withheld:
            without = "their truth is withheld" if options.pairs is not None else "they are in no pair"
            reporter.note(f"{name}: {withheld} of {len(photos)} images have no pose: {without}")


def _depth(part: _Part, options: Options, reporter: Reporter) -> Depth:
    """Where the depth of a traversal's photos comes from."""
    folder = part.folder
    maps = {record.name: depth for _, record in part.images if (depth := folder.depth_of(record)) is not None}
    if folder.depths and not maps:
        reporter.note(
            f"{part.name}: no depth map is used: none is of the time of an image, from where its camera stands"
        )
    return Depth(folder, maps, ModelPoints(folder.model, Observations.of(folder.model), options))


def _listed(path: Path) -> Iterator[tuple[int, tuple[str, str]]]:
    """Line number and the names of query and keyframe of each line, parted by commas or else by spaces."""
    if not any("," in line for line in lines_of(read_text(path, "pairs (query, keyframe)", DatasetError))):
        yield from listed_pairs(path)
        return
    for line, fields in read_fields(path, "query_image, mapping_image, [score]", 2, 3):
        yield line, (fields[0], fields[1])
