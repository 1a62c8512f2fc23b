"""The generic folder: images, a camera, poses, and optionally depth or points.

Its files are described in ``docs/recording-formats.md``. Each folder is one traversal; the first one is the reference.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from relocbench.arrays import Array, Floats
from relocbench.datasets.core import images
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import ClockOptions, ImportOptions
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.schema import CameraEntry, Condition, Strict, Transform, TraversalFile
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.importers.assembly import import_image, note_depth_scale, open_writer, write_pairs
from relocbench.datasets.importers.clocks import write_posed_traversal
from relocbench.datasets.pairs.depth_scale import DepthFrame
from relocbench.datasets.sensors.image_files import ImageFiles
from relocbench.datasets.sensors.plausible_poses import plausible
from relocbench.datasets.sensors.pose_tables import PoseTable, read_trajectory
from relocbench.datasets.sensors.recording import CameraStream, Trajectory
from relocbench.datasets.sensors.trajectories import timed_files, traversal_names
from relocbench.datasets.sensors.undistortion import undistort, undistort_points
from relocbench.errors import DatasetError
from relocbench.execution import Run
from relocbench.files import check_distinct, check_name, fitting_name, load_yaml, load_yaml_values
from relocbench.progress import SILENT, Reporter

CAMERA_FILE, POSE_FILE = "camera.yaml", "poses.txt"
_ONLY_CAMERA = "cam0"


class Options(ClockOptions):
    """Options of the generic importer."""

    LATER = ("time_offset",)

    max_pose_gap: float = Field(
        1.0,
        gt=0,
        description="longest gap in seconds between two poses to interpolate over; images in longer gaps have no pose",
    )


class GenericCamera(CameraEntry):
    """A camera in ``camera.yaml``."""

    T_rig_cam: Transform = Transform(translation_m=(0.0, 0.0, 0.0), quaternion_xyzw=(0.0, 0.0, 0.0, 1.0))
    depth_scale: float | None = Field(None, gt=0, allow_inf_nan=False)
    """metres per unit of the depth images"""


class SingleCameraFile(GenericCamera):
    """The content of ``camera.yaml`` in a folder with one camera."""

    condition: Condition = Condition()
    location: str = ""
    rate_hz: float | None = None


class RigFile(Strict):
    """The content of ``camera.yaml`` in a folder with several cameras."""

    cameras: dict[str, GenericCamera] = Field(min_length=1)
    condition: Condition = Condition()
    location: str = ""
    rate_hz: float | None = None

    @model_validator(mode="after")
    def _plain_names(self) -> Self:
        for name in self.cameras:
            check_name(name, "camera name")
        check_distinct(self.cameras, "camera names")
        return self


@dataclass(frozen=True, eq=False)
class CameraFolder:
    """The files of one camera in a generic folder, by time."""

    camera: GenericCamera
    images: dict[int, Path]
    depth: dict[int, Path]
    points: dict[int, Path]


@dataclass(frozen=True, eq=False)
class GenericFolder:
    """The content of a generic folder."""

    name: str
    root: Path
    condition: Condition
    location: str
    rate_hz: float | None
    cameras: dict[str, CameraFolder]
    poses: PoseTable | None = field(repr=False)
    """the poses ``T_world_rig`` in poses.txt; None where it was not read"""

    @property
    def image_times(self) -> list[int]:
        return sorted({t for camera in self.cameras.values() for t in camera.images})

    def streams(self, T_new_rig: Array) -> dict[str, CameraStream]:
        """The cameras on a rig with other axes, ``T_new_rig`` (4, 4) being from those of the folder."""
        return {
            name: ImageFiles(
                name,
                entry.camera.camera,
                T_new_rig @ entry.camera.T_rig_cam.matrix,
                tuple(entry.images.values()),
                np.array(list(entry.images), dtype=np.int64),
                CAMERA_FILE,
            )
            for name, entry in self.cameras.items()
        }


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Import one or more generic folders; the first is the reference. Raises as :class:`Importer`."""
    assert isinstance(options, Options)
    names = traversal_names(sources)
    options.check_conditions(names)
    options.check_time_offsets(len(sources))
    writer = open_writer("generic", sources, options, out, fitting_name("generic-" + "-".join(names)))
    if writer.complete:
        return Dataset(out)
    folders = [read_folder(source, name, reporter=reporter) for source, name in zip(sources, names, strict=True)]
    reference, *others = folders
    job = Build(writer, options, reporter, run)
    for index, folder in enumerate(folders):
        _write_traversal(job, folder, options.time_offset_of(index))
    for query in others or [reference]:
        cameras = [c for c in reference.cameras if c in query.cameras]
        if not cameras:
            raise DatasetError(f"has no camera of {reference.name} ({', '.join(reference.cameras)})", query.root)
        for camera in cameras:
            numbers = {time: number for number, time in enumerate(reference.cameras[camera].images)}
            write_pairs(job, reference.name, query.name, camera, source=POSE_FILE, where=query.root, numbers=numbers)
    return writer.finish()


def read_folder(root: Path, name: str, need_poses: bool = True, reporter: Reporter = SILENT) -> GenericFolder:
    """Read the text files of a generic folder and list its images, which are not opened.

    Args:
        need_poses: read ``poses.txt``, which recordings with lidar do not need.
        reporter: is told which rows have no pose.

    Raises:
        DatasetError: with file and line.
    """
    file = root / CAMERA_FILE
    single = "cameras" not in load_yaml_values(file, "the camera or cameras of the folder", DatasetError)[0]
    model: type[SingleCameraFile] | type[RigFile] = SingleCameraFile if single else RigFile
    header = load_yaml(file, model, "a camera description", DatasetError)
    cameras = header.cameras if isinstance(header, RigFile) else {_ONLY_CAMERA: header}
    return GenericFolder(
        name=name,
        root=root,
        condition=header.condition,
        location=header.location,
        rate_hz=header.rate_hz,
        cameras={c: _read_camera_folder(root, "" if single else c, entry, reporter) for c, entry in cameras.items()},
        poses=read_trajectory(root / POSE_FILE, reporter=reporter) if need_poses else None,
    )


def _read_camera_folder(root: Path, subfolder: str, entry: GenericCamera, reporter: Reporter) -> CameraFolder:
    shown = timed_files(root / "images" / subfolder, reporter=reporter)
    folder = CameraFolder(
        entry,
        shown,
        timed_files(root / "depth" / subfolder, (".png",), like=shown.values()),
        timed_files(root / "points" / subfolder, (".csv",), like=shown.values()),
    )
    if not folder.images:
        raise DatasetError("holds no image; expected TIMESTAMP.png or .jpg", root / "images" / subfolder)
    if folder.depth and entry.depth_scale is None:
        raise DatasetError("key 'depth_scale' is missing; expected metres per unit of depth", root / CAMERA_FILE)
    for kind, files in (("depth", folder.depth), ("points", folder.points)):
        for time, path in files.items():
            if time not in folder.images:
                raise DatasetError(f"there is no image at the time of this {kind} file", path)
    return folder


def rig_trajectory(
    folder: GenericFolder, max_gap_s: float, reporter: Reporter = SILENT, *, holes: bool = True
) -> Trajectory:
    """The poses of the rig, without outliers, and interrupted at jumps and holes.

    Args:
        max_gap_s: longest gap between two poses to interpolate over. An image exactly at a pose's time always has it.
        holes: shorter gaps that are holes in this drive are not interpolated over either.

    Raises:
        DatasetError: the poses cannot be those of one drive.
    """
    assert folder.poses is not None
    table = plausible(folder.poses, reporter, holes=holes)
    return Trajectory(table.times_ns, table.transforms, math.floor(max_gap_s * 1e9), table.breaks)


def _write_traversal(job: Build[Options], folder: GenericFolder, given_s: float | None) -> None:
    """Write rig, poses, and the images, depth and points of the posed frames."""
    writer, options = job.writer, job.options
    holes = options.given("max_pose_gap") is None
    trajectory = rig_trajectory(folder, options.max_pose_gap, job.reporter, holes=holes)

    def write_frames(poses: Mapping[int, Array]) -> None:
        without = len(folder.image_times) - len(poses)
        if without:
            job.reporter.note(
                f"{without} image times of {folder.name} have no pose (before, after or in a gap of {POSE_FILE})"
            )
        units = [
            _FrameUnit(writer, folder.name, name, time, c.camera, path, c.depth.get(time), c.points.get(time), options)
            for name, c in folder.cameras.items()
            for time, path in c.images.items()
            if time in poses
        ]
        for name, c in folder.cameras.items():
            _note_depth_scale(folder, name, c, poses, job.reporter)
        job.work(f"frames of {folder.name}", _write_frame, units)

    file = TraversalFile(
        name=folder.name,
        condition=options.conditions.get(folder.name, folder.condition),
        location=folder.location,
        rate_hz=folder.rate_hz,
        cameras={
            name: CameraEntry.of(c.camera.camera.pinhole(), c.camera.T_rig_cam.matrix, c.camera.depth_sigma)
            for name, c in folder.cameras.items()
        },
        source=f"generic folder {folder.name}",
    )
    none_posed = DatasetError(_why_no_pose(folder), folder.root / POSE_FILE)
    write_posed_traversal(job, file, trajectory, folder.image_times, write_frames, given_s, none_posed)


def _note_depth_scale(
    folder: GenericFolder, name: str, content: CameraFolder, poses: Mapping[int, Array], reporter: Reporter
) -> None:
    entry = content.camera
    if entry.depth_scale is None:
        return
    frames = [
        DepthFrame(entry.camera.pinhole(), poses[time] @ entry.T_rig_cam.matrix, partial(_read_depth, path, entry))
        for time, path in content.depth.items()
        if time in poses
    ]
    of = f" of camera {name}" if len(folder.cameras) > 1 else ""
    what = f"depth_scale {entry.depth_scale:g}{of} in {CAMERA_FILE}"
    note_depth_scale(frames, what, entry.depth_scale, folder.name, reporter)


def _read_depth(path: Path, entry: GenericCamera) -> Floats:
    """The depth in metres that the pinhole camera with the same K sees, (H, W)."""
    assert entry.depth_scale is not None
    depth = images.read_raw_depth(path, entry.depth_scale, images.ExpectedSize(entry.camera.size, CAMERA_FILE))
    return undistort(depth, entry.camera, nearest=True)


@dataclass(frozen=True, eq=False)
class _FrameUnit:
    """One image to import, with its depth and points."""

    writer: DatasetWriter
    traversal: str
    camera_name: str
    timestamp_ns: int
    camera: GenericCamera
    image: Path
    depth: Path | None
    points: Path | None
    options: Options


def _write_frame(unit: _FrameUnit) -> None:
    """Import the image, depth and points of a frame."""
    where = unit.traversal, unit.camera_name, unit.timestamp_ns
    camera, writer = unit.camera.camera, unit.writer
    import_image(writer, where, unit.image, camera, CAMERA_FILE, copy=unit.options.copy_images)
    if unit.depth is not None and writer.needs_depth(*where):
        writer.depth(*where, _read_depth(unit.depth, unit.camera))
    if unit.points is not None:
        points = images.read_points(unit.points)
        outside = np.nonzero(~camera.contains(points.uv, border=-0.5))[0]
        if outside.size:
            raise DatasetError("the point lies outside the image", unit.points, int(outside[0]) + 2)
        writer.points(*where, points if camera.model == "pinhole" else undistort_points(points, camera))


def _why_no_pose(folder: GenericFolder) -> str:
    if folder.poses is None or not len(folder.poses.times_ns):
        return "holds no pose; expected lines 't tx ty tz qx qy qz qw'"
    poses, frames = folder.poses.times_ns, folder.image_times
    return (
        f"no image has a pose: poses span {poses[0]} to {poses[-1]} ns, images {frames[0]} to {frames[-1]} ns "
        "(an integer is nanoseconds, a number with a decimal point seconds)"
    )
