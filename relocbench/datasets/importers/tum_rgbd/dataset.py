"""TUM RGB-D layout: ``rgb.txt``, ``depth.txt``, ``groundtruth.txt`` and the images they list.

Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM Systems, IROS 2012. Depth is registered to the colour
camera, so that both share its intrinsics. Images and depth are undistorted to a pinhole camera with the same K.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from relocbench.arrays import Array, Floats
from relocbench.datasets.core import images
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import ClockOptions, ImportOptions
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.schema import CameraEntry, TraversalFile
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.importers.assembly import (
    check_folder,
    import_image,
    note_depth_scale,
    open_writer,
    write_pairs,
)
from relocbench.datasets.importers.clocks import write_posed_traversal
from relocbench.datasets.pairs.depth_scale import DepthFrame
from relocbench.datasets.sensors.plausible_poses import plausible
from relocbench.datasets.sensors.pose_tables import read_trajectory
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.datasets.sensors.times import times_in_ns
from relocbench.datasets.sensors.trajectories import traversal_names
from relocbench.datasets.sensors.undistortion import undistort
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run
from relocbench.files import fitting_name, read_rows
from relocbench.geometry import Camera
from relocbench.progress import Reporter

Preset = Literal["fr1", "fr2", "fr3", "ros-default"]

_SECOND_NS = 10**9
CAMERA = "rgb"
KINECT_SIGMA = (0.0, 0.0, 1.425e-3)
"""sigma_z = 1.425e-3 z^2 m: Khoshelham and Oude Elberink, Accuracy and Resolution of Kinect Depth Data, Sensors 2012"""
INTRINSICS: dict[Preset, Camera] = {
    "fr1": Camera(
        "radtan", 640, 480, 517.3, 516.5, 318.6, 255.3, distortion=(0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
    ),
    "fr2": Camera(
        "radtan", 640, 480, 520.9, 521.0, 325.1, 249.7, distortion=(0.2312, -0.7849, -0.0033, -0.0001, 0.9172)
    ),
    "fr3": Camera("pinhole", 640, 480, 535.4, 539.2, 320.1, 247.6),
    "ros-default": Camera("pinhole", 640, 480, 525.0, 525.0, 319.5, 239.5),
}
"""the calibrations that the benchmark publishes for its cameras"""


class Options(ClockOptions):
    """Options of ``relocbench build-dataset tum-rgbd``."""

    # A hand-held camera turns more than a car does.
    max_angle: float = Field(90.0, gt=0, le=180, description="widest pair in degrees (nearest rule)")
    intrinsics: tuple[Literal["auto", "fr1", "fr2", "fr3", "ros-default"], ...] = Field(
        ("auto",),
        min_length=1,
        max_length=2,
        description="camera calibration, one for all or one per recording; auto: by freiburg1..3 in the folder's name",
    )
    max_time_difference: float = Field(
        0.02, ge=0, description="greatest time in seconds between an image and its depth image"
    )
    # Recorded under this name in datasets, and so in the content ids of the published ones.
    max_truth_gap: float = Field(0.1, gt=0, description="longest gap in seconds in the true poses to interpolate over")
    depth_scale: float = Field(5000.0, gt=0, description="stored depth value of one metre")


@dataclass(frozen=True)
class _Frame:
    """One image with its depth image."""

    time: int
    image: Path
    depth: Path | None


@dataclass(frozen=True, eq=False)
class _Unit:
    """One frame to import."""

    writer: DatasetWriter
    traversal: str
    frame: _Frame
    camera: Camera
    options: Options


def _write_frame(unit: _Unit) -> None:
    """Import an image and its depth, without interpolation, which would invent surfaces between two others."""
    frame, writer, options = unit.frame, unit.writer, unit.options
    where = unit.traversal, CAMERA, frame.time
    import_image(writer, where, frame.image, unit.camera, "--intrinsics", copy=options.copy_images)
    if frame.depth and writer.needs_depth(*where):
        writer.depth(*where, _read_depth(frame.depth, unit.camera, options))


def _read_depth(path: Path, camera: Camera, options: Options) -> Floats:
    """The depth in metres that the pinhole camera with the same K sees, (H, W)."""
    size = images.ExpectedSize(camera.size, "--intrinsics")
    return undistort(images.read_raw_depth(path, 1.0 / options.depth_scale, size), camera, nearest=True)


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from one recording, or from two that share a world. Raises as :class:`Importer`.

    Args:
        sources: one or two sequence folders: reference, query.
    """
    assert isinstance(options, Options)
    if not 1 <= len(sources) <= 2:
        raise ConfigError(f"tum-rgbd takes one or two sequence folders (reference, query), got {len(sources)}")
    for source in sources:
        check_folder(source, "a TUM RGB-D sequence")
    names = traversal_names(sources)
    options.check_conditions(names)
    options.check_time_offsets(len(sources))
    writer = open_writer("tum-rgbd", sources, options, out, fitting_name("_to_".join(names)))
    job = Build(writer, options, reporter, run)
    for index, (source, name) in enumerate(zip(sources, names, strict=True)):
        _write_traversal(job, source, name, index)
    write_pairs(job, names[0], names[-1], CAMERA, source="TUM RGB-D motion capture", where=sources[0])
    return writer.finish()


def _write_traversal(job: Build[Options], source: Path, name: str, index: int) -> None:
    writer, options = job.writer, job.options
    camera = _intrinsics(source, options.intrinsics[min(index, len(options.intrinsics) - 1)])
    frames = _frames(source, name, options, job.reporter)
    path = source / "groundtruth.txt"
    truth = plausible(read_trajectory(path, reporter=job.reporter, own_ns=_SECOND_NS), job.reporter)
    if not len(truth.times_ns):
        raise DatasetError("holds no pose", path)
    none_posed = DatasetError("holds no pose at the time of any image", path)
    trajectory = Trajectory(truth.times_ns, truth.transforms, round(options.max_truth_gap * 1e9), truth.breaks)
    file = TraversalFile(
        name=name,
        condition=options.condition_of(name),
        cameras={CAMERA: CameraEntry.of(camera.pinhole(), depth_sigma=KINECT_SIGMA)},
        source=f"TUM RGB-D sequence {source.resolve().name}",
    )

    def write_frames(poses: Mapping[int, Array]) -> None:
        posed = [frame for time, frame in sorted(frames.items()) if time in poses]
        if len(posed) < len(frames):
            without = len(frames) - len(posed)
            job.reporter.note(f"{name}: {without} of {len(frames)} images without a true pose are left out")
        bare = sum(frame.depth is None for frame in posed)
        if bare:
            job.reporter.note(
                f"{name}: {bare} of {len(posed)} images are not keyframes, because no depth image is within "
                f"{options.max_time_difference:g} s"
            )
        measured = [
            DepthFrame(camera.pinhole(), poses[f.time], partial(_read_depth, f.depth, camera, options))
            for f in posed
            if f.depth is not None
        ]
        what = f"depth by --depth-scale {options.depth_scale:g}"
        note_depth_scale(measured, what, 1.0 / options.depth_scale, name, job.reporter)
        job.work(f"images of {name}", _write_frame, [_Unit(writer, name, frame, camera, options) for frame in posed])

    given_s = options.time_offset_of(index)
    write_posed_traversal(job, file, trajectory, list(frames), write_frames, given_s, none_posed)


def _intrinsics(source: Path, asked: str) -> Camera:
    if asked != "auto":
        return INTRINSICS[asked]  # type: ignore[index]  # pydantic has checked it
    folder = source.resolve().name.lower()
    for number in ("1", "2", "3"):
        if f"freiburg{number}" in folder or f"fr{number}" in folder:
            return INTRINSICS[f"fr{number}"]  # type: ignore[index]
    raise ConfigError(
        f"{source}: give --intrinsics (fr1, fr2, fr3 or ros-default); the folder's name does not name the camera"
    )


def _frames(source: Path, name: str, options: Options, reporter: Reporter) -> dict[int, _Frame]:
    """The existing images by time, each with the depth image nearest in time."""
    listed, depths = _listed(source / "rgb.txt"), _listed(source / "depth.txt")
    available = {t: p for t, p in listed.items() if p.exists()}
    if len(available) < len(listed):
        reporter.note(f"{name}: {len(listed) - len(available)} of {len(listed)} images in rgb.txt do not exist")
    if not available:
        raise DatasetError("none of the images it lists exist", source / "rgb.txt")
    depths = {t: p for t, p in depths.items() if p.exists()}
    limit = round(options.max_time_difference * 1e9)
    return {time: _Frame(time, path, _nearest(depths, time, limit)) for time, path in available.items()}


def _listed(path: Path) -> dict[int, Path]:
    """Files by time in nanoseconds from a list ``seconds path``. Raises DatasetError with file and line."""
    rows = list(read_rows(path, "a list of images (seconds path)", DatasetError))
    for line, fields in rows:
        if len(fields) != 2:
            raise DatasetError(f"expected 2 columns (seconds path), found {len(fields)}", path, line)
    times = times_in_ns([fields[0] for _, fields in rows], lambda i: (path, rows[i][0]), _SECOND_NS).ns
    files: dict[int, Path] = {}
    for time, (line, fields) in zip(times, rows, strict=True):
        if time in files:
            raise DatasetError(f"time {fields[0]} occurs again", path, line)
        files[time] = path.parent / fields[1]
    if not files:
        raise DatasetError("is empty; expected a list of images (seconds path)", path)
    return files


def _nearest(files: dict[int, Path], time: int, limit: int) -> Path | None:
    """The file nearest in time, or None if it is beyond the limit."""
    times = np.array(sorted(files), dtype=np.int64)
    if not times.size:
        return None
    best = int(times[np.argmin(np.abs(times - time))])
    return files[best] if abs(best - time) <= limit else None
