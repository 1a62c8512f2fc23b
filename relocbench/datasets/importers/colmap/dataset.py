"""Build a dataset from a sparse model of COLMAP: Aachen, RobotCar Seasons, CMU, Cambridge and 7-Scenes come as one.

Keyframes are images of the model, with its points as their depth. Queries are images of the model too, or those of a
list with their intrinsics, as on visuallocalization.net (``name MODEL width height params...``); their true poses come
from the model or from a file (``name qw qx qy qz tx ty tz``, camera from world), or are withheld.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import Field

from relocbench.arrays import Array
from relocbench.datasets.core import images
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import ImportOptions, PosedRecordingOptions
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.named_poses import read_named_poses
from relocbench.datasets.core.names import write_names
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.schema import CameraEntry, TraversalFile
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.importers.assembly import check_folder, open_writer, write_pairs
from relocbench.datasets.importers.colmap.lists import listed_cameras, listed_pairs
from relocbench.datasets.importers.colmap.model import ColmapModel, read_model
from relocbench.datasets.importers.colmap.points import Observations, keyframe_points
from relocbench.datasets.pairs.posed_frames import relative_pose
from relocbench.datasets.pairs.writing import write_pair_set
from relocbench.datasets.sensors.undistortion import undistort
from relocbench.errors import ConfigError, DatasetError, quoted
from relocbench.execution import Run
from relocbench.files import fitting_name
from relocbench.geometry import Camera, invert
from relocbench.progress import Reporter

CAMERA = "photo"
MAP, QUERY = "map", "query"
STEP_NS = 1_000_000_000
"""images have no times in a model: the N-th by name is given that of N seconds"""
_PATHS = ("images", "depth", "query_list", "query_poses", "pairs")
_SOURCE = "COLMAP model"


class Options(PosedRecordingOptions):
    """Options of ``relocbench build-dataset colmap``."""

    images: Path | None = Field(
        None, description="folder below which the model's image names lie; default: images beside the model"
    )
    queries: tuple[str, ...] = Field(
        (),
        description="names of the model's images that are queries and no keyframes, with * and ? as in file names, "
        "such as 'night/*'; default: every image is both",
    )
    query_list: Path | None = Field(
        None, description="queries that the model does not hold: lines 'name MODEL width height params...'"
    )
    query_poses: Path | None = Field(
        None,
        description="true poses of these, camera from world: lines 'name qw qx qy qz tx ty tz'; default: withheld",
    )
    pairs: Path | None = Field(
        None, description="pairs: lines 'query keyframe' of image names, as hloc writes them; default: by --pair-rule"
    )
    depth: Path | None = Field(
        None, description="folder of depth images, PNG of 16 bits named like the images; default: the model's points"
    )
    depth_scale: float = Field(1000.0, gt=0, description="stored depth value of one unit of the model")
    metres_per_unit: float = Field(1.0, gt=0, description="length of the model's unit; a model knows it up to scale")
    min_track: int = Field(2, ge=1, description="points that fewer images observe are left out")
    noise_px: float = Field(0.5, gt=0, description="least standard deviation of a keypoint in pixels")

    def recorded(self) -> dict[str, Any]:
        """The options without folders and files, which are sources; what they hold is in the dataset."""
        return {key: value for key, value in super().recorded().items() if key not in _PATHS}


@dataclass(frozen=True, eq=False)
class _Photo:
    """An image to import."""

    name: str
    time: int
    path: Path
    camera: Camera
    T_cam_world: Array | None
    """(4, 4) in metres; None if withheld"""
    number: int | None
    """the image's number in the model; None for images of the list"""


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a sparse model.

    Args:
        sources: the model's folder, with ``cameras``, ``images`` and ``points3D``, ``.bin`` or ``.txt``.

    Raises:
        DatasetError: with file and line: something in the model or a list is missing or wrong.
        ConfigError: the options do not fit together.
    """
    assert isinstance(options, Options)
    if len(sources) != 1:
        raise ConfigError(f"colmap takes the folder of one model, got {len(sources)}")
    _check_options(options)
    folder = sources[0]
    check_folder(folder, "the folder of a COLMAP model")
    model = read_model(folder)
    root = options.images or _image_folder(folder)
    keyframes, queries = _photos(folder, root, model, options)
    names = (MAP, QUERY) if queries else (MAP, MAP)
    options.check_conditions(names)
    given = [path for key in _PATHS if (path := getattr(options, key)) is not None]
    writer = open_writer("colmap", [folder, *given], options, out, fitting_name(f"colmap_{folder.resolve().name}"))
    job = Build(writer, options, reporter, run)
    depth = _Depth(model, Observations.of(model), options)
    _write_traversal(job, MAP, keyframes, depth)
    if queries:
        _write_traversal(job, QUERY, queries, depth)
    if options.pairs is None:
        write_pairs(job, *names, CAMERA, source=_SOURCE, where=folder)
    else:
        chosen = _listed(options.pairs, keyframes, queries or keyframes)
        write_pair_set(job, *names, CAMERA, chosen)
    return writer.finish()


def _check_options(options: Options) -> None:
    if options.query_list is None and options.query_poses is not None:
        raise ConfigError("--query-poses tells the poses of the queries of --query-list, which is not given")
    if options.query_list is not None and options.queries:
        raise ConfigError("--queries names images of the model, --query-list other ones; give one of them")
    if options.query_list is not None and options.query_poses is None and options.pairs is None:
        raise ConfigError("queries without poses have no nearest keyframe; name their keyframes by --pairs")
    if options.pairs is not None and (options.pair_rule is not None or options.elsewhere):
        raise ConfigError("--pairs names the pairs; --pair-rule and --elsewhere make some")


def _image_folder(model: Path) -> Path:
    """``images`` in the model's folder or one of the two above it, as COLMAP and hloc lay them out."""
    for parent in (model, *list(model.resolve().parents)[:2]):
        if (parent / "images").is_dir():
            return parent / "images"
    raise DatasetError("no folder 'images' beside the model; name it by --images", model)


def _photos(folder: Path, root: Path, model: ColmapModel, options: Options) -> tuple[list[_Photo], list[_Photo]]:
    """The keyframes and the queries, each by name."""
    check_folder(root, "the folder of the model's images")
    known = {image.name: number for number, image in model.images.items()}
    chosen = {name for name in known if any(fnmatchcase(name, pattern) for pattern in options.queries)}
    if options.queries and not chosen:
        raise DatasetError(f"no image is named like {', '.join(map(quoted, options.queries))}", folder)
    if options.queries and len(chosen) == len(known):
        raise DatasetError(f"all {len(known)} images are queries; none is left for the map", folder)

    def photo(index: int, name: str) -> _Photo:
        image = model.images[known[name]]
        pose = _in_metres(image.T_cam_world, options.metres_per_unit)
        return _Photo(name, STEP_NS * index, root / name, model.cameras[image.camera], pose, known[name])

    keyframes = [photo(i, name) for i, name in enumerate(sorted(known.keys() - chosen), start=1)]
    queries = [photo(i, name) for i, name in enumerate(sorted(chosen), start=1)]
    if options.query_list is None:
        return keyframes, queries
    cameras = listed_cameras(options.query_list)
    poses = {} if options.query_poses is None else read_named_poses(options.query_poses)
    for name in poses:
        if name not in cameras:
            raise DatasetError(
                f"tells the pose of {quoted(name)}, which --query-list does not name", options.query_poses
            )
    for i, (name, camera) in enumerate(sorted(cameras.items()), start=1):
        pose = _in_metres(poses[name], options.metres_per_unit) if name in poses else None
        queries.append(_Photo(name, STEP_NS * i, root / name, camera, pose, None))
    return keyframes, queries


def _in_metres(T_cam_world: Array, metres_per_unit: float) -> Array:
    scaled = T_cam_world.copy()
    scaled[:3, 3] *= metres_per_unit
    return scaled


@dataclass(frozen=True, eq=False)
class _Depth:
    """Where the depth of keyframes comes from."""

    model: ColmapModel
    seen: Observations
    options: Options

    @cached_property
    def pinholes(self) -> dict[int, Camera]:
        """The pinhole camera of each camera of the model."""
        return {number: camera.pinhole() for number, camera in self.model.cameras.items()}

    def write(self, writer: DatasetWriter, traversal: str, photo: _Photo) -> None:
        """Write the depth image of a photo if there is one, else the model's points that it observes."""
        options = self.options
        if options.depth is not None:
            path = (options.depth / photo.name).with_suffix(".png")
            if path.exists() and writer.needs_depth(traversal, CAMERA, photo.time):
                units = images.read_raw_depth(path, 1.0 / options.depth_scale, _size(photo))
                depth = undistort(units, photo.camera, nearest=True) if photo.camera.distortion else units
                writer.depth(traversal, CAMERA, photo.time, depth * options.metres_per_unit)
        elif photo.number is not None:
            how = options.min_track, options.noise_px, options.metres_per_unit
            points = keyframe_points(self.model, self.seen, self.pinholes, photo.number, *how)
            if len(points):
                writer.points(traversal, CAMERA, photo.time, points)


def _write_traversal(job: Build[Options], name: str, photos: Sequence[_Photo], depth: _Depth) -> None:
    writer, options = job.writer, job.options
    pinholes = {photo.time: photo.camera.pinhole() for photo in photos}
    usual = Counter(pinholes.values()).most_common(1)[0][0]
    file = TraversalFile(
        name=name,
        condition=options.condition_of(name),
        cameras={CAMERA: CameraEntry.of(usual)},
        source=f"COLMAP model, {len(photos)} images",
    )
    writer.traversal(file, {p.time: invert(p.T_cam_world) for p in photos if p.T_cam_world is not None})
    write_names(writer.layout.traversal(name).names, {p.time: p.name for p in photos})
    own = {time: camera for time, camera in pinholes.items() if camera != usual}
    if own:
        writer.intrinsics(name, CAMERA, own)
    units = [_Unit(writer, name, photo, options.copy_images) for photo in photos]
    job.work(f"images of {name}", _write_image, units)
    with job.reporter.stage(f"depth of {name}", len(photos)) as advance:
        for photo in photos:
            depth.write(writer, name, photo)
            advance(1)


@dataclass(frozen=True, eq=False)
class _Unit:
    """One image to import."""

    writer: DatasetWriter
    traversal: str
    photo: _Photo
    copy: bool


def _write_image(unit: _Unit) -> None:
    """Link an image of a pinhole camera, undistort that of another."""
    photo, writer = unit.photo, unit.writer
    if not photo.camera.distortion:
        images.read_image(photo.path, _size(photo))
        writer.link_image(unit.traversal, CAMERA, photo.time, photo.path, copy=unit.copy)
    elif writer.needs_image(unit.traversal, CAMERA, photo.time):
        writer.image(
            unit.traversal, CAMERA, photo.time, undistort(images.read_image(photo.path, _size(photo)), photo.camera)
        )


def _size(photo: _Photo) -> images.ExpectedSize:
    return images.ExpectedSize(photo.camera.size, f"the camera of {photo.name}")


def _listed(path: Path, keyframes: Sequence[_Photo], queries: Sequence[_Photo]) -> list[Pair]:
    """The pairs of a list, with the truth of those whose query has a pose."""
    references, asked = {p.name: p for p in keyframes}, {p.name: p for p in queries}
    pairs: dict[tuple[int, int], Pair] = {}
    for line, (query_name, reference_name) in listed_pairs(path):
        reference, query = references.get(reference_name), asked.get(query_name)
        if reference is None or query is None:
            unknown, what = (reference_name, "keyframe") if reference is None else (query_name, "query")
            raise DatasetError(f"{quoted(unknown)} is no {what} of this dataset", path, line)
        assert reference.T_cam_world is not None
        truth = None
        if query.T_cam_world is not None:
            truth = relative_pose(invert(query.T_cam_world), invert(reference.T_cam_world))
        pair = Pair(reference.time, query.time, truth, source=_SOURCE)
        if pair.key in pairs:
            raise DatasetError(f"the pair {query_name} {reference_name} occurs again", path, line)
        pairs[pair.key] = pair
    if not pairs:
        raise DatasetError("holds no pair; expected lines 'query keyframe'", path)
    return list(pairs.values())
