"""Build a dataset from a sparse model of COLMAP: Aachen, RobotCar Seasons, CMU, Cambridge and 7-Scenes come as one.

Keyframes are images of the model, with its points as their depth. Queries are images of the model too, or those of a
list with their intrinsics, as on visuallocalization.net (``name MODEL width height params...``); their true poses come
from the model or from a file (``name qw qx qy qz tx ty tz``, camera from world), or are withheld.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import Field

from relocbench.arrays import Floats
from relocbench.datasets.core import images
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.named_poses import read_named_poses, read_words
from relocbench.datasets.importers.assembly import check_folder, open_writer, write_pairs
from relocbench.datasets.importers.colmap.model import read_model
from relocbench.datasets.importers.colmap.project import model_folder
from relocbench.datasets.importers.photos.cameras import parse_camera
from relocbench.datasets.importers.photos.collection import (
    CAMERA,
    MAP,
    QUERY,
    STEP_NS,
    DepthSource,
    ModelPoints,
    Photo,
    in_metres,
    without_far,
    write_traversal,
)
from relocbench.datasets.importers.photos.lists import chosen_queries, listed_pairs, pairs_by_name
from relocbench.datasets.importers.photos.options import PhotoOptions
from relocbench.datasets.importers.photos.points import Observations, SparseModel
from relocbench.datasets.pairs.writing import write_pair_set
from relocbench.datasets.sensors.undistortion import undistort
from relocbench.errors import ConfigError, DatasetError, quoted
from relocbench.execution import Run
from relocbench.files import fitting_name
from relocbench.geometry import Camera
from relocbench.progress import Reporter
from relocbench.tracking import KeyframePoints

_SOURCE = "COLMAP model"


class Options(PhotoOptions):
    """Options of ``relocbench build-dataset colmap``."""

    PATHS: ClassVar[tuple[str, ...]] = ("images", "depth", "query_list", "query_poses", "pairs")

    sparse_model: str = Field(
        "", description="the model's folder within the given one, such as sparse/1; default: the only one there"
    )
    images: Path | None = Field(
        None, description="folder below which the model's image names lie; default: images beside the model"
    )
    query_list: Path | None = Field(
        None, description="queries that the model does not hold: lines 'name MODEL width height params...'"
    )
    query_poses: Path | None = Field(
        None,
        description="true poses of these, camera from world: lines 'name qw qx qy qz tx ty tz'; default: withheld",
    )
    depth: Path | None = Field(
        None, description="folder of depth images, PNG of 16 bits named like the images; default: the model's points"
    )
    depth_scale: float = Field(1000.0, gt=0, description="stored depth value of one unit of the model")


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a sparse model. Raises as :class:`Importer`.

    Args:
        sources: the model's folder, with ``cameras``, ``images`` and ``points3D``, ``.bin`` or ``.txt``; or the folder
            of a project that holds it as COLMAP lays it out.
    """
    assert isinstance(options, Options)
    if len(sources) != 1:
        raise ConfigError(f"colmap takes the folder of one model, got {len(sources)}")
    _check_options(options)
    project = sources[0]
    check_folder(project, "the folder of a COLMAP model")
    folder = model_folder(project, options.sparse_model)
    if folder != project:
        reporter.note(f"reads the model in {folder.relative_to(project)}")
    model = read_model(folder, reporter)
    root = options.images or _image_folder(folder)
    photos = _photos(folder, root, model, options, reporter)
    keyframes, queries = (without_far(some, folder, reporter) for some in photos)
    names = (MAP, QUERY) if queries else (MAP, MAP)
    options.check_conditions(names)
    writer = open_writer(
        "colmap", [folder, *options.paths], options, out, fitting_name(f"colmap_{project.resolve().name}")
    )
    job = Build(writer, options, reporter, run)
    depth: DepthSource = ModelPoints(model, Observations.of(model), options)
    if options.depth is not None:
        depth = _DepthImages(options.depth, options)
    write_traversal(job, MAP, keyframes, depth, _SOURCE)
    if queries:
        write_traversal(job, QUERY, queries, depth, _SOURCE)
    if options.pairs is None:
        write_pairs(job, *names, CAMERA, source=_SOURCE, where=folder)
    else:
        asked = {names[1]: queries or keyframes}
        chosen = pairs_by_name(options.pairs, listed_pairs(options.pairs), keyframes, asked, _SOURCE)
        write_pair_set(job, *names, CAMERA, chosen[names[1]])
    return writer.finish()


def _check_options(options: Options) -> None:
    if options.query_list is None and options.query_poses is not None:
        raise ConfigError("--query-poses has the poses of the queries of --query-list, which is not given")
    if options.query_list is not None and options.queries:
        raise ConfigError("--queries names images of the model, --query-list other ones; give one of them")
    if options.query_list is not None and options.query_poses is None and options.pairs is None:
        raise ConfigError("queries without poses have no nearest keyframe; name their keyframes by --pairs")
    options.check_pairs()


def _image_folder(model: Path) -> Path:
    """``images`` in the model's folder or one of the two above it, as COLMAP and hloc lay them out."""
    for parent in (model, *list(model.resolve().parents)[:2]):
        if (parent / "images").is_dir():
            return parent / "images"
    raise DatasetError("no folder 'images' beside the model; name it by --images", model)


def _photos(
    folder: Path, root: Path, model: SparseModel, options: Options, reporter: Reporter
) -> tuple[list[Photo], list[Photo]]:
    """The keyframes and the queries, each by name."""
    check_folder(root, "the folder of the model's images")
    known = {image.name: number for number, image in model.images.items()}
    chosen = chosen_queries(known, options.queries, folder)

    def photo(index: int, name: str) -> Photo:
        image = model.images[known[name]]
        pose = in_metres(image.T_cam_world, options.metres_per_unit)
        return Photo(name, STEP_NS * index, root / name, model.cameras[image.camera], pose, known[name])

    keyframes = [photo(i, name) for i, name in enumerate(sorted(known.keys() - chosen), start=1)]
    queries = [photo(i, name) for i, name in enumerate(sorted(chosen), start=1)]
    if options.query_list is None:
        return keyframes, queries
    cameras = listed_cameras(options.query_list)
    poses = {} if options.query_poses is None else read_named_poses(options.query_poses, reporter=reporter)
    for name in poses:
        if name not in cameras:
            raise DatasetError(f"has a pose of {quoted(name)}, which --query-list does not name", options.query_poses)
    for i, (name, camera) in enumerate(sorted(cameras.items()), start=1):
        pose = in_metres(poses[name], options.metres_per_unit) if name in poses else None
        queries.append(Photo(name, STEP_NS * i, root / name, camera, pose, None))
    return keyframes, queries


@dataclass(frozen=True, eq=False)
class _DepthImages:
    """A folder of depth images that are named like the photos."""

    folder: Path
    options: Options

    @property
    def unit(self) -> tuple[str, float]:
        scale = self.options.depth_scale
        return f"depth by --depth-scale {scale:g}", 1.0 / scale

    def image(self, photo: Photo) -> Callable[[], Floats] | None:
        """What reads the depth image of a photo, if there is one."""
        path = (self.folder / photo.name).with_suffix(".png")
        return partial(self._read, path, photo) if path.exists() else None

    def _read(self, path: Path, photo: Photo) -> Floats:
        units = images.read_raw_depth(path, 1.0 / self.options.depth_scale, photo.size)
        depth = undistort(units, photo.camera, nearest=True) * self.options.metres_per_unit
        return np.asarray(depth, dtype=np.float32)

    def points(self, photo: Photo) -> KeyframePoints | None:
        """Always None: depth is that of images."""
        return None


def listed_cameras(path: Path) -> dict[str, Camera]:
    """Cameras by image name, from a list of visuallocalization.net or hloc: ``name MODEL width height params...``.

    Raises:
        DatasetError: with file and line.
    """
    found: dict[str, Camera] = {}
    for line, fields in read_words(path, "queries with intrinsics (name MODEL width height params...)", DatasetError):
        if len(fields) < 5:
            raise DatasetError("expected name MODEL width height params...", path, line)
        if fields[0] in found:
            raise DatasetError(f"image {quoted(fields[0])} occurs again", path, line)
        found[fields[0]] = parse_camera(fields[1:], path, line)
    if not found:
        raise DatasetError("holds no image; expected lines 'name MODEL width height params...'", path)
    return found
