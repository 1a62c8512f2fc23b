"""KITTI odometry layout: ``sequences/NN/{image_0..3,velodyne,calib.txt,times.txt}``, ``poses/NN.txt``.

Depth of the keyframes is computed from stereo images or projected from lidar scans. Line i of the poses and of the
times belongs to frame i, even if frames are missing. Geiger et al., Are we ready for autonomous driving?, CVPR 2012.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from relocbench.arrays import Array
from relocbench.datasets.core import images
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import ImportOptions, PosedRecordingOptions
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.schema import CameraEntry, TraversalFile
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.importers.assembly import check_folder, open_writer, write_pairs
from relocbench.datasets.importers.kitti.files import KittiSequence
from relocbench.datasets.pairs.pairing import make_pairs
from relocbench.datasets.pairs.posed_frames import PosedFrames, pieces_of
from relocbench.datasets.sensors.stereo import StereoGeometry, stereo_depth
from relocbench.datasets.sensors.velodyne import LIDAR_SIGMA, project_scan, read_scan
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run
from relocbench.geometry import Camera, invert
from relocbench.progress import Reporter

CameraName = Literal["image_0", "image_1", "image_2", "image_3"]


class Options(PosedRecordingOptions):
    """Options of ``relocbench build-dataset kitti``."""

    sequence: tuple[str, ...] = Field(
        (),
        max_length=2,
        description="one sequence, such as 06, or a reference and a query whose poses share a world (KITTI's own do "
        "not); default: the folder's only sequence",
    )
    depth: Literal["auto", "stereo", "velodyne"] = Field(
        "auto", description="source of depth; auto: stereo if there are right images, else velodyne"
    )
    camera: CameraName = Field("image_0", description="camera to use (for stereo depth a left one: image_0 or image_2)")
    rate_hz: float = Field(10.0, gt=0, description="frames per second if times.txt is missing")
    max_depth: float = Field(80.0, gt=0, lt=256, description="greatest depth to keep, metres")
    max_disparity: int = Field(128, ge=16, le=512, multiple_of=16, description="pixels searched by stereo matching")


@dataclass(frozen=True, eq=False)
class _Plan:
    """The part of a sequence that goes into the dataset."""

    sequence: KittiSequence
    frames: dict[int, Path]
    """frame number -> image, for frames with a pose and a time"""
    poses: dict[int, Array]
    """frame number -> ``T_world_cam0``"""
    times: dict[int, int]
    """frame number -> nanoseconds"""
    kind: Literal["stereo", "velodyne"] | None
    depth_files: dict[int, Path]
    """frame number -> right image or scan"""
    camera: Camera

    def posed_frames(self) -> PosedFrames:
        """The frames for pairing. The poses are those of the rig's frame, camera 0, instead of the camera's."""
        numbers = tuple(self.frames)
        return PosedFrames(
            tuple(self.times[i] for i in numbers),
            np.array([self.poses[i] for i in numbers]),
            frozenset(self.times[i] for i in self.depth_files),
            numbers,
            pieces_of([self.times[i] for i in numbers], np.array([self.poses[i] for i in numbers])),
        )


@dataclass(frozen=True)
class _StereoUnit:
    left: Path
    right: Path
    depth: Path
    geometry: StereoGeometry


@dataclass(frozen=True)
class _LidarUnit:
    scan: Path
    depth: Path
    camera: Camera
    T_cam_lidar: Array
    max_depth: float


def _compute_depth(unit: _StereoUnit | _LidarUnit) -> None:
    if isinstance(unit, _LidarUnit):
        depth = project_scan(read_scan(unit.scan), unit.camera, unit.T_cam_lidar, unit.max_depth)
    else:
        left = images.read_image(unit.left)
        size = images.ExpectedSize((left.shape[1], left.shape[0]), f"the left image {unit.left}")
        right = images.read_image(unit.right, size)
        depth = stereo_depth(left, right, unit.geometry)
    images.write_depth(unit.depth, depth)


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from one sequence, or from a reference and a query sequence. Raises as :class:`Importer`.

    Args:
        sources: the folder that holds ``sequences`` and ``poses``, or one sequence folder.
    """
    assert isinstance(options, Options)
    sequences = _find_sequences(sources, options)
    options.check_conditions([s.traversal for s in sequences])
    plans = [_read(s, options, needs_depth=s is sequences[0], reporter=reporter) for s in sequences]
    reference, query = plans[0], plans[-1]
    # Options that give no pair are reported before the depth of a long recording is computed.
    frames, where = (reference.posed_frames(), query.posed_frames()), reference.sequence.folder
    make_pairs(*frames, options, same_traversal=query is reference, source="", where=where)
    writer = open_writer("kitti", sources, options, out, "kitti_" + "_".join(s.name for s in sequences))
    job = Build(writer, options, reporter, run)
    for plan in plans:
        _write_traversal(job, plan)
    names = reference.sequence.traversal, query.sequence.traversal
    numbers = {reference.times[i]: i for i in reference.frames}
    write_pairs(job, *names, options.camera, source="KITTI odometry poses", where=where, numbers=numbers)
    return writer.finish()


def _find_sequences(sources: list[Path], options: Options) -> list[KittiSequence]:
    if len(sources) != 1:
        raise ConfigError(f"kitti takes one folder (with sequences/ and poses/), got {len(sources)}; see --sequence")
    root = sources[0].resolve()
    if (root / "calib.txt").exists() and root.parent.name == "sequences":
        asked: tuple[str, ...] = options.sequence or (root.name,)
        root = root.parent.parent
    else:
        check_folder(root / "sequences", "the sequences of a KITTI odometry folder")
        available = sorted(p.name for p in (root / "sequences").iterdir() if p.is_dir())
        if not options.sequence and len(available) != 1:
            raise ConfigError(f"--sequence is needed: {root} holds {', '.join(available) or 'none'}")
        asked = options.sequence or (available[0],)
    found = [KittiSequence(root, name) for name in dict.fromkeys(asked)]
    for sequence in found:
        check_folder(sequence.folder, f"KITTI sequence {sequence.name}")
    return found


def _read(sequence: KittiSequence, options: Options, needs_depth: bool, reporter: Reporter) -> _Plan:
    """Read a sequence and select its usable frames; nothing is written."""
    found = sequence.image_frames(options.camera)
    if not found:
        raise DatasetError("holds no images (000000.png, ...)", sequence.folder / options.camera)
    times, poses, _ = sequence.times_and_poses(options.rate_hz, max(found) + 1, reporter)
    frames = {i: path for i, path in found.items() if i in poses and i in times}
    if len(frames) < len(found):
        first = next(path.name for i, path in found.items() if i not in frames)
        message = f"{len(found) - len(frames)} of {len(found)} images have no pose or no time and are left out"
        reporter.note(f"{sequence.name}: {message}, the first is {first}")
    if not frames:
        raise DatasetError(f"holds {len(poses)} poses, but none for an existing image", sequence.poses_file)
    kind = _depth_kind(sequence, options, needs_depth)
    depth_files = {i: path for i, path in _depth_files(sequence, options, kind).items() if i in frames}
    if kind and len(depth_files) < len(frames):
        lacking = "right image" if kind == "stereo" else "lidar scan"
        reporter.note(
            f"{sequence.name}: {len(frames) - len(depth_files)} of {len(frames)} frames are not keyframes, because "
            f"they have no {lacking}"
        )
    camera = sequence.camera(options.camera, next(iter(frames.values())))
    return _Plan(sequence, frames, poses, times, kind, depth_files, camera)


def _write_traversal(job: Build[Options], plan: _Plan) -> None:
    """Write one traversal with its images and depth."""
    writer, options = job.writer, job.options
    name, calibration = plan.sequence.traversal, plan.sequence.calibration
    sigma = (0.0, 0.0, 0.0)
    if plan.kind:
        sigma = _stereo_geometry(plan.sequence, options).depth_sigma if plan.kind == "stereo" else (LIDAR_SIGMA, 0, 0)
    file = TraversalFile(
        name=name,
        condition=options.condition_of(name),
        rate_hz=_rate(plan.times),
        cameras={options.camera: CameraEntry.of(plan.camera, calibration.T_cam0_cam(options.camera), sigma)},
        source=f"KITTI odometry sequence {plan.sequence.name}, depth from {plan.kind or 'nothing'}",
    )
    writer.traversal(file, {plan.times[i]: plan.poses[i] for i in plan.frames})
    with job.reporter.stage(f"images of {name}", len(plan.frames)) as advance:
        for i, path in plan.frames.items():
            writer.link_image(name, options.camera, plan.times[i], path, copy=options.copy_images)
            advance(1)
    job.work(f"depth of {name} from {plan.kind}", _compute_depth, _depth_units(writer, plan, options))


def _depth_units(writer: DatasetWriter, plan: _Plan, options: Options) -> list[_StereoUnit | _LidarUnit]:
    """The depth images that still have to be computed."""
    name, sequence = plan.sequence.traversal, plan.sequence
    units: list[_StereoUnit | _LidarUnit] = []
    for i, source in plan.depth_files.items():
        if not writer.needs_depth(name, options.camera, plan.times[i]):
            continue
        path = writer.layout.traversal(name).depth(options.camera, plan.times[i])
        if plan.kind == "stereo":
            units.append(_StereoUnit(plan.frames[i], source, path, _stereo_geometry(sequence, options)))
        else:
            T_cam_lidar = invert(sequence.calibration.T_cam0_cam(options.camera)) @ sequence.calibration.T_cam0_lidar()
            units.append(_LidarUnit(source, path, plan.camera, T_cam_lidar, options.max_depth))
    return units


def _depth_kind(sequence: KittiSequence, options: Options, needs_depth: bool) -> Literal["stereo", "velodyne"] | None:
    """The source of a sequence's depth; None for a query sequence without depth."""
    right = _right_of(options.camera)
    has_right = right is not None and bool(sequence.image_frames(right))
    has_scans = bool(sequence.frames("velodyne", ".bin"))
    if options.depth == "stereo" and right is None:
        raise ConfigError(f"stereo depth needs a left camera (image_0 or image_2), got {options.camera}")
    if options.depth != "velodyne" and has_right:
        return "stereo"
    if options.depth != "stereo" and has_scans:
        return "velodyne"
    if not needs_depth:
        return None
    wanted = {"auto": f"{right or 'image_1'}/ or velodyne/", "stereo": f"{right}/", "velodyne": "velodyne/"}
    raise DatasetError(f"has no depth for the keyframes; expected {wanted[options.depth]}", sequence.folder)


def _right_of(camera: str) -> str | None:
    return {"image_0": "image_1", "image_2": "image_3"}.get(camera)


def _depth_files(sequence: KittiSequence, options: Options, kind: str | None) -> dict[int, Path]:
    """Frame number -> right image or scan."""
    if kind == "stereo":
        return sequence.image_frames(str(_right_of(options.camera)))
    return sequence.frames("velodyne", ".bin") if kind == "velodyne" else {}


def _stereo_geometry(sequence: KittiSequence, options: Options) -> StereoGeometry:
    left = sequence.calibration.projection(options.camera)
    right = sequence.calibration.matrix(f"P{int(options.camera[-1]) + 1}", "stereo depth")
    focal_baseline = float(left[0, 3] - right[0, 3])
    if focal_baseline <= 0:
        raise DatasetError("the right camera is not to the right of the left one", sequence.calibration.path)
    offset = float(left[0, 2] - right[0, 2])
    return StereoGeometry(focal_baseline, offset, options.max_depth, options.max_disparity)


def _rate(times: dict[int, int]) -> float | None:
    return round(1e9 / float(np.median(np.diff(list(times.values())))), 3) if len(times) > 1 else None
