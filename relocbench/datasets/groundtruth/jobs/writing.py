"""Writing the traversals of a dataset: descriptions, poses, images and depth, or poses alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core import images
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.schema import CameraEntry, Transform, TraversalFile
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.blocks.nodes import nearest_nodes
from relocbench.datasets.groundtruth.depth.depth import DepthOptions
from relocbench.datasets.groundtruth.depth.images import DepthFrame, DepthView, make_depth
from relocbench.datasets.groundtruth.depth.stereo import StereoPair, stereo_pair
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.groundtruth.pairs.pairing import CameraFrames, Paired
from relocbench.datasets.groundtruth.registration.scene_scale import scaled
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.sensors.recording import CameraStream, FieldRecording, RigStream
from relocbench.errors import DatasetError
from relocbench.execution import chunks, run_units
from relocbench.geometry import invert

_IMAGES_A_UNIT = 16


@dataclass(frozen=True, eq=False)
class Frames:
    """The selected images of one camera of one drive, or where it has none, the selected poses of its rig."""

    stream: CameraStream | RigStream
    pair: StereoPair | None
    """the stereo pair of this camera, if it has one"""
    indices: tuple[int, ...]

    @property
    def times(self) -> tuple[int, ...]:
        return tuple(int(self.stream.times_ns[i]) for i in self.indices)


def camera_frames(camera: str, reference: Frames, query: Frames, enlarged: float) -> CameraFrames:
    """The images of a camera that are paired, its poses on the rigs in metres that are enlarged so many times."""
    T_rig_refcam, T_rig_querycam = (scaled(frames.stream.T_rig_cam, enlarged) for frames in (reference, query))
    return CameraFrames(camera, T_rig_refcam, T_rig_querycam, reference.times, query.times)


def choose_frames(
    recording: FieldRecording,
    drive: Drive,
    camera: str,
    options: FieldOptions,
    *,
    is_reference: bool,
    enlarged: float = 1.0,
) -> Frames:
    """Select the images of a camera, or poses of the rig where the recording has no such camera.

    Args:
        recording: in metres.
        drive: in metres that are enlarged so many times.

    Raises:
        DatasetError: no image can be selected.
    """
    apart = (options.keyframe_distance if is_reference else options.query_distance) * enlarged
    pair = stereo_pair(recording.cameras, camera) if camera in recording.cameras else None
    stream = recording.cameras[camera] if camera in recording.cameras else recording.rig_stream(camera)
    # A keyframe needs a pose; for a query without one the rejection is recorded.
    indices = select_images(recording, stream, drive.nodes, apart, in_gaps=not is_reference)
    if options.depth == "stereo" and pair is not None:
        both = pair.common_times()
        indices = [i for i in indices if int(stream.times_ns[i]) in both]
    if not indices and isinstance(stream, RigStream):
        raise DatasetError(f"no scan of {stream.lidar} was taken while odometry was recorded", recording.folder)
    if not indices:
        raise DatasetError(f"no image of {camera} was taken while lidar and odometry were recorded", recording.folder)
    return Frames(stream, pair, tuple(indices))


def rig_poses(
    recordings: Sequence[FieldRecording], frames: Sequence[Mapping[str, Frames]], paired: Sequence[Paired]
) -> list[dict[int, Array]]:
    """For each drive, timestamp_ns -> ``T_world_rig``.

    The world is the reference's odometry. The pose of a query image is that by its accepted pair.
    """
    reference = recordings[0]
    times = sorted({time for chosen in frames[0].values() for time in chosen.times})
    T_world_ref = dict(zip(times, reference.odometry.at(np.array(times, dtype=np.int64)), strict=True))
    out = [T_world_ref]
    for chosen, answer in zip(frames[1:], paired, strict=True):
        poses: dict[int, Array] = {}
        for camera, outcomes in answer.outcomes.items():
            T_rig_refcam, T_rig_cam = frames[0][camera].stream.T_rig_cam, chosen[camera].stream.T_rig_cam
            for o in outcomes:
                if o.accepted and o.T_query_ref is not None and o.query_timestamp_ns not in poses:
                    T_world_refcam = T_world_ref[o.ref_timestamp_ns] @ T_rig_refcam
                    poses[o.query_timestamp_ns] = T_world_refcam @ invert(o.T_query_ref) @ invert(T_rig_cam)
        out.append(poses)
    return out


def write_traversal(
    job: Build[FieldOptions],
    recording: FieldRecording,
    drive: Drive,
    frames: Mapping[str, Frames],
    poses: Mapping[int, Array],
    enlarged: float = 1.0,
) -> None:
    """Write the description, poses, images and depth of one drive; only images with a pose have depth.

    Args:
        recording, poses: in metres.
        drive: in metres that are enlarged so many times.
    """
    writer, options = job.writer, job.options
    name, length, entries = recording.name, options.depth_submap, {}
    bare: dict[str, Transform] = {}
    origin = (
        f"depth from lidar submaps of {length / enlarged:.3g} m" if options.depth == "lidar" else "depth from stereo"
    )
    for camera, chosen in frames.items():
        stream = chosen.stream
        if isinstance(stream, RigStream):
            bare[camera] = Transform.of(stream.T_rig_cam)
            origin = f"poses of the rig at scans of {stream.lidar}"
            continue
        _write_images(job, name, stream, chosen)
        T_rig_cam, how = scaled(stream.T_rig_cam, enlarged), _depth_options(recording, enlarged)
        view = DepthView(drive, stream.camera, T_rig_cam, options.depth, chosen.pair, length, how, enlarged)
        path = writer.layout.traversal(name).depth
        wanted = [DepthFrame(time, path(camera, time)) for time in chosen.times if time in poses]
        missing = {frame.time_ns for frame in wanted if writer.needs_depth(name, camera, frame.time_ns)}
        sigma, agreement = make_depth(view, wanted, missing, job.reporter, job.run)
        if agreement is not None and chosen.pair is not None:
            job.reporter.note(f"{name}, {camera}: lidar against stereo with {chosen.pair.right.name}: {agreement}")
        entries[camera] = CameraEntry.of(stream.camera, stream.T_rig_cam, sigma)
    file = TraversalFile(
        name=name,
        condition=options.conditions.get(name, recording.condition),
        location=recording.location,
        cameras=entries,
        frames=bare,
        source=f"recording {recording.folder.name}, {origin}",
    )
    writer.traversal(file, dict(poses))


def _depth_options(recording: FieldRecording, enlarged: float) -> DepthOptions:
    """Options of depth in a scene that is enlarged, as is the noise of the lidars."""
    options = DepthOptions()
    if enlarged <= 1.0:
        return options
    range_m = max(options.noise.range_m, *(lidar.sigma_m * enlarged for lidar in recording.lidars))
    return replace(options, noise=replace(options.noise, range_m=range_m))


@dataclass(frozen=True, eq=False)
class _ImageUnit:
    """Raw images to be developed and written, as a unit of work."""

    stream: CameraStream
    layout: DatasetLayout
    traversal: str
    indices: tuple[int, ...]


def _write_images(job: Build[FieldOptions], traversal: str, stream: CameraStream, chosen: Frames) -> None:
    writer, developed = job.writer, []
    with job.reporter.stage(f"images of {traversal}", len(chosen.indices)) as advance:
        for index, time in zip(chosen.indices, chosen.times, strict=True):
            source = stream.file(index)
            if source is None and writer.needs_image(traversal, stream.name, time):
                developed.append(index)
                continue
            if source is not None:
                writer.link_image(traversal, stream.name, time, source, copy=job.options.copies_images)
            advance(1)
        units = [
            _ImageUnit(stream, writer.layout, traversal, tuple(part)) for part in chunks(developed, _IMAGES_A_UNIT)
        ]
        for _, done in run_units(_develop, units, job.run):
            advance(done)


def _develop(unit: _ImageUnit) -> int:
    for index in unit.indices:
        time = int(unit.stream.times_ns[index])
        path = unit.layout.traversal(unit.traversal).image(unit.stream.name, time)
        images.write_image(path, unit.stream.read(index))
    return len(unit.indices)


def select_images(
    recording: FieldRecording, stream: CameraStream | RigStream, nodes: Nodes, apart_m: float, *, in_gaps: bool = False
) -> list[int]:
    """Indices of images at least ``apart_m`` of road apart, between the first and the last node of the drive.

    Args:
        in_gaps: also select images at times that the odometry does not cover, as many as at the drive's mean speed, so
            that their rejection is recorded.
    """
    times = stream.times_ns
    inside = (times >= nodes.times_ns[0]) & (times <= nodes.times_ns[-1])
    known = recording.odometry.covers(times) & (nearest_nodes(nodes, recording.odometry, times) >= 0)
    rows = np.flatnonzero(inside if in_gaps else inside & known)
    if not len(rows):
        return []
    seconds = (times - nodes.times_ns[0]) / 1e9
    at_nodes = (nodes.times_ns - nodes.times_ns[0]) / 1e9
    travelled = np.interp(seconds, at_nodes, nodes.travelled_m)
    segments = nodes.segments()
    same = segments[1:] == segments[:-1]
    driven, spent = np.diff(nodes.travelled_m)[same].sum(), np.diff(at_nodes)[same].sum()
    wait_s = apart_m * spent / driven if driven > 0 else np.inf
    chosen: list[int] = []
    for index in rows.tolist():
        if chosen:
            last = chosen[-1]
            waited = not (known[index] and known[last]) and seconds[index] - seconds[last] >= wait_s - 1e-9
            if not waited and travelled[index] - travelled[last] < apart_m - 1e-6:
                continue
        chosen.append(index)
    return chosen
