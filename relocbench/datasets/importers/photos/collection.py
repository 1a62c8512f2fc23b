"""Writing a collection of photos as a traversal: images and depth, poses, a camera for each image, and their names."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from relocbench.arrays import Array, Floats
from relocbench.datasets.core import images
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.names import write_names
from relocbench.datasets.core.schema import CameraEntry, TraversalFile
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.importers.assembly import import_image, note_depth_scale
from relocbench.datasets.importers.photos.options import PhotoOptions
from relocbench.datasets.importers.photos.points import Observations, SparseModel, keyframe_points
from relocbench.datasets.motion.collections import far_from_all
from relocbench.datasets.motion.words import distance
from relocbench.datasets.pairs.depth_scale import DepthFrame
from relocbench.errors import quoted
from relocbench.geometry import Camera, invert
from relocbench.progress import Reporter
from relocbench.tracking import KeyframePoints

CAMERA = "photo"
MAP, QUERY = "map", "query"
STEP_NS = 1_000_000_000
"""photos have no times that mean anything: the N-th is given that of N seconds"""


@dataclass(frozen=True, eq=False)
class Photo:
    """An image to import."""

    name: str
    time: int
    """nanoseconds"""
    path: Path
    camera: Camera
    T_cam_world: Array | None
    """(4, 4) in metres; None if withheld"""
    number: int | None
    """the image's number in the model; None if it is not in one"""

    @property
    def size(self) -> images.ExpectedSize:
        """The size that the image must have."""
        return images.ExpectedSize(self.camera.size, f"the camera of {self.name}")


class DepthSource(Protocol):
    """Where the depth of photos comes from."""

    @property
    def unit(self) -> tuple[str, float]:
        """What says the unit of depth images, in words, and the metres that it says."""
        ...

    def image(self, photo: Photo) -> Callable[[], Floats] | None:
        """What reads the depth in metres that the photo's pinhole camera sees, (H, W); None if there is no image."""
        ...

    def points(self, photo: Photo) -> KeyframePoints | None:
        """The points of a photo without a depth image; None if there are none."""
        ...


@dataclass(frozen=True, eq=False)
class ModelPoints:
    """The depth of a photo is that of the model's points that it observes."""

    model: SparseModel
    seen: Observations
    options: PhotoOptions

    @cached_property
    def pinholes(self) -> dict[int, Camera]:
        """The pinhole camera of each camera of the model."""
        return {number: camera.pinhole() for number, camera in self.model.cameras.items()}

    @property
    def unit(self) -> tuple[str, float]:
        return "no depth image", 1.0

    def image(self, photo: Photo) -> Callable[[], Floats] | None:
        """Always None: there are points."""
        return None

    def points(self, photo: Photo) -> KeyframePoints | None:
        """The model's points that the photo observes; None if there are none."""
        if photo.number is None:
            return None
        options = self.options
        how = options.min_track, options.noise_px, options.metres_per_unit
        points = keyframe_points(self.model, self.seen, self.pinholes, photo.number, *how)
        return points if len(points) else None


def in_metres(T_cam_world: Array, metres_per_unit: float) -> Array:
    """The pose (4, 4) with its translation in metres."""
    scaled = T_cam_world.copy()
    scaled[:3, 3] *= metres_per_unit
    return scaled


def without_far(photos: Sequence[Photo], where: Path, reporter: Reporter) -> list[Photo]:
    """The photos without those whose poses are far from those of all others, which are named.

    Args:
        where: where the poses are from, for messages.
    """
    posed = [(photo.name, photo.T_cam_world) for photo in photos if photo.T_cam_world is not None]
    far = far_from_all(np.array([invert(T_cam_world)[:3, 3] for _, T_cam_world in posed]).reshape(-1, 3))
    left_out = {posed[row][0] for row, _ in far}
    for row, metres in far:
        reporter.note(
            f"{where.name}: image {quoted(posed[row][0])} is {distance(metres)} from the nearest of the others, "
            "which are close together; it is left out"
        )
    return [photo for photo in photos if photo.name not in left_out]


def write_traversal(
    job: Build[PhotoOptions], name: str, photos: Sequence[Photo], depth: DepthSource, source: str
) -> None:
    """Write photos, at least one, as a traversal.

    Args:
        source: what they were imported from, in words.

    Raises:
        DatasetError: an image is missing, damaged or not of its camera's size; or its depth is.
    """
    writer, options = job.writer, job.options
    pinholes = {photo.time: photo.camera.pinhole() for photo in photos}
    usual = Counter(pinholes.values()).most_common(1)[0][0]
    file = TraversalFile(
        name=name,
        condition=options.condition_of(name),
        cameras={CAMERA: CameraEntry.of(usual)},
        source=f"{source}, {len(photos)} images",
    )
    writer.traversal(file, {p.time: invert(p.T_cam_world) for p in photos if p.T_cam_world is not None})
    write_names(writer.layout.traversal(name).names, {p.time: p.name for p in photos})
    own = {time: camera for time, camera in pinholes.items() if camera != usual}
    if own:
        writer.intrinsics(name, CAMERA, own)
    note_depth_scale(list(_measured(photos, depth)), *depth.unit, name, job.reporter)
    units = [_Unit(writer, name, photo, options.copy_images) for photo in photos]
    job.work(f"images of {name}", _write_image, units)
    with job.reporter.stage(f"depth of {name}", len(photos)) as advance:
        for photo in photos:
            _write_depth(writer, name, photo, depth)
            advance(1)


def _measured(photos: Sequence[Photo], depth: DepthSource) -> Iterator[DepthFrame]:
    """The photos with pose and depth image."""
    for photo in photos:
        read = depth.image(photo)
        if photo.T_cam_world is not None and read is not None:
            yield DepthFrame(photo.camera.pinhole(), invert(photo.T_cam_world), read)


def _write_depth(writer: DatasetWriter, traversal: str, photo: Photo, depth: DepthSource) -> None:
    frame, read = (traversal, CAMERA, photo.time), depth.image(photo)
    if read is not None:
        if writer.needs_depth(*frame):
            writer.depth(*frame, read())
        return
    points = depth.points(photo)
    if points is not None:
        writer.points(*frame, points)


@dataclass(frozen=True, eq=False)
class _Unit:
    """One image to import."""

    writer: DatasetWriter
    traversal: str
    photo: Photo
    copy: bool


def _write_image(unit: _Unit) -> None:
    photo, frame = unit.photo, (unit.traversal, CAMERA, unit.photo.time)
    import_image(unit.writer, frame, photo.path, photo.camera, photo.size.source, copy=unit.copy)
