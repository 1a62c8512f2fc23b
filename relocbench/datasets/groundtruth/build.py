"""From recordings of one road to a dataset: the first is the reference, all others ask about it.

Everything that took long lies in ``OUT/groundtruth`` as soon as it is done, and a killed build goes on from there:
``blocks/TRAVERSAL`` (points), ``registrations/REF__QUERY.csv`` (what was found at each node, and the evidence),
``graph/REF__QUERY.csv`` (where the graph puts the nodes). Depth and images are kept file by file.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets import images
from relocbench.datasets.correspondences import write_pair_set
from relocbench.datasets.dataset import Dataset
from relocbench.datasets.groundtruth import track_files
from relocbench.datasets.groundtruth.alignment import Drive, FirstPose, TrackUnit, make_drive, track_drive
from relocbench.datasets.groundtruth.depth import DepthOptions
from relocbench.datasets.groundtruth.depth_work import DepthFrame, depth_sigma, make_depth
from relocbench.datasets.groundtruth.evidence import Registration
from relocbench.datasets.groundtruth.frames import chosen_images
from relocbench.datasets.groundtruth.graph_files import PlacedDrive, write_graph
from relocbench.datasets.groundtruth.options import FieldOptions
from relocbench.datasets.groundtruth.outcome import PairOutcome
from relocbench.datasets.groundtruth.pairing import CameraFrames, Paired, PairingUnit, pair_up
from relocbench.datasets.groundtruth.recording import CameraStream, FieldRecording
from relocbench.datasets.importers import Run
from relocbench.datasets.layout import DatasetLayout
from relocbench.datasets.pairfile import parse_pose
from relocbench.datasets.schema import CameraEntry, TraversalFile
from relocbench.datasets.writer import DatasetWriter
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import chunks, run_units
from relocbench.geometry import invert
from relocbench.progress import Reporter

Array = NDArray[np.float64]

_IMAGES_A_UNIT = 16


def build_ground_truth(
    recordings: Sequence[FieldRecording], writer: DatasetWriter, options: FieldOptions, reporter: Reporter, run: Run
) -> Dataset:
    """The dataset of a reference drive and the drives that ask about it.

    Raises:
        ConfigError: fewer than two drives, or a camera that one of them does not have.
        DatasetError: something in a recording is damaged; or no pair could be accepted, with the reason.
    """
    if len(recordings) < 2:
        raise ConfigError(f"ground truth across drives needs a reference and at least one other, got {len(recordings)}")
    cameras = _cameras(recordings, options)
    first = _first_pose(options)
    folder = writer.layout.root / "groundtruth"
    if not options.use_prior:
        recordings = [_without_prior(recording) for recording in recordings]
    drives = [make_drive(r, folder / "blocks" / r.name, options.alignment, reporter, run) for r in recordings]
    reference, queries = drives[0], drives[1:]
    registrations = _register(reference, queries, folder, options, first, reporter, run)
    frames = [
        {name: _chosen(recording, drive, name, options, recording is recordings[0]) for name in cameras}
        for recording, drive in zip(recordings, drives, strict=True)
    ]
    units = [
        PairingUnit(
            reference,
            query,
            tuple(registrations[query.name]),
            tuple(
                CameraFrames(
                    name,
                    recordings[0].cameras[name].T_rig_cam,
                    recordings[k + 1].cameras[name].T_rig_cam,
                    frames[0][name].times,
                    frames[k + 1][name].times,
                )
                for name in cameras
            ),
            options.alignment,
            options.limits,
            options.max_angle,
        )
        for k, query in enumerate(queries)
    ]
    paired = _pair(units, folder, reporter, run)
    _refuse_nothing(paired, [q.name for q in queries], folder)
    poses = _poses(recordings, frames, paired)
    for k, (recording, drive) in enumerate(zip(recordings, drives, strict=True)):
        _write_traversal(writer, recording, drive, cameras, frames[k], poses[k], options, reporter, run)
    for k, query in enumerate(queries):
        for name in cameras:
            pairs = [outcome.pair() for outcome in paired[k].outcomes[name]]
            write_pair_set(
                writer,
                reference.name,
                query.name,
                name,
                pairs,
                count=options.correspondences,
                seed=options.seed,
                reporter=reporter,
                run=run,
            )
            reporter.note(_summary(query.name, name, paired[k].outcomes[name]))
    return writer.finish()


@dataclass(frozen=True, eq=False)
class _Chosen:
    """The images of one camera of one drive that take part."""

    indices: tuple[int, ...]
    times: tuple[int, ...]


def _cameras(recordings: Sequence[FieldRecording], options: FieldOptions) -> tuple[str, ...]:
    there = recordings[0].cameras
    asked = options.cameras or tuple(there)[:1]
    if not asked:
        raise DatasetError("holds no images", recordings[0].folder)
    for recording in recordings:
        for name in asked:
            if name not in recording.cameras:
                known = ", ".join(recording.cameras) or "none"
                raise ConfigError(f"--cameras: {recording.name} has no camera '{name}'; it has {known}")
    return asked


def _first_pose(options: FieldOptions) -> FirstPose | None:
    if not options.first_pose:
        return None
    words = options.first_pose.replace(",", " ").split()
    try:
        ref_ns, query_ns = (int(word) for word in words[:2])
        pose = parse_pose(words[2:], Path("--first-pose"), 1)
    except (ValueError, DatasetError):
        raise ConfigError("--first-pose is 'REF_NS QUERY_NS tx ty tz qx qy qz qw'") from None
    return ref_ns, query_ns, pose


def _without_prior(recording: FieldRecording) -> FieldRecording:
    return replace(recording, prior=None)


def _register(
    reference: Drive,
    queries: Sequence[Drive],
    folder: Path,
    options: FieldOptions,
    first: FirstPose | None,
    reporter: Reporter,
    run: Run,
) -> dict[str, list[Registration]]:
    """Registrations of each query drive; those that a former run finished are read."""
    paths = {q.name: folder / "registrations" / f"{reference.name}__{q.name}.csv" for q in queries}
    found = {name: track_files.read_registrations(path) for name, path in paths.items() if path.exists()}
    missing = [q for q in queries if q.name not in found]
    units = [TrackUnit(reference, q, options.alignment, first) for q in missing]
    with reporter.stage("registering drives", len(units)) as advance:
        for index, (registrations, messages) in run_units(_track, units, workers=run.workers, scheduler=run.scheduler):
            query = missing[index]
            for message in messages:
                reporter.note(f"{query.name}: {message}")
            track_files.write_registrations(paths[query.name], registrations, reference.nodes, query.nodes)
            # What is used is what a resumed build would read.
            found[query.name] = track_files.read_registrations(paths[query.name])
            advance(1)
    return found


def _track(unit: TrackUnit) -> tuple[list[Registration], list[str]]:
    messages: list[str] = []
    return track_drive(unit, messages.append), messages


def _pair(units: Sequence[PairingUnit], folder: Path, reporter: Reporter, run: Run) -> list[Paired]:
    out: dict[int, Paired] = {}
    with reporter.stage("pose graphs and pairs", len(units)) as advance:
        for index, paired in run_units(pair_up, units, workers=run.workers, scheduler=run.scheduler):
            unit = units[index]
            _write_graph(folder / "graph" / f"{unit.reference.name}__{unit.query.name}.csv", unit, paired)
            out[index] = paired
            advance(1)
    return [out[k] for k in range(len(units))]


def _write_graph(path: Path, unit: PairingUnit, paired: Paired) -> None:
    count = len(unit.reference.nodes)
    before, after = paired.way_to_trusted[:count], paired.way_to_trusted[count:]
    verdicts = {r.query: verdict for r, verdict in zip(unit.registrations, paired.verdicts, strict=True)}
    write_graph(
        path,
        PlacedDrive(unit.reference.name, unit.reference.nodes.times_ns, paired.T_world_ref, before, {}),
        PlacedDrive(unit.query.name, unit.query.nodes.times_ns, paired.T_world_query, after, verdicts),
    )


def _refuse_nothing(paired: Sequence[Paired], queries: Sequence[str], folder: Path) -> None:
    """Raises DatasetError where not one pair was accepted."""
    everything = [o for p in paired for outcomes in p.outcomes.values() for o in outcomes]
    if any(o.accepted for o in everything):
        return
    reason = Counter(o.reason for o in everything).most_common(1)[0][0] if everything else "there are no images"
    raise DatasetError(
        f"no pair of {', '.join(queries)} could be accepted; most often: {reason} (all registrations lie here)",
        folder / "registrations",
    )


def _chosen(recording: FieldRecording, drive: Drive, camera: str, options: FieldOptions, is_reference: bool) -> _Chosen:
    stream = recording.cameras[camera]
    apart = options.keyframe_distance if is_reference else options.query_distance
    indices = chosen_images(recording, stream, drive.nodes, apart)
    if not indices:
        raise DatasetError(f"no image of {camera} was taken while lidar and odometry ran", recording.folder)
    return _Chosen(tuple(indices), tuple(int(stream.times_ns[i]) for i in indices))


def _poses(
    recordings: Sequence[FieldRecording], frames: Sequence[Mapping[str, _Chosen]], paired: Sequence[Paired]
) -> list[dict[int, Array]]:
    """timestamp_ns -> ``T_world_rig`` of each drive. The world is the reference's odometry; a query image lies where
    its accepted pair puts it."""
    reference = recordings[0]
    times = sorted({time for chosen in frames[0].values() for time in chosen.times})
    T_world_ref = dict(zip(times, reference.odometry.at(np.array(times, dtype=np.int64)), strict=True))
    out = [T_world_ref]
    for recording, answer in zip(recordings[1:], paired, strict=True):
        poses: dict[int, Array] = {}
        for camera, outcomes in answer.outcomes.items():
            T_rig_refcam, T_rig_cam = reference.cameras[camera].T_rig_cam, recording.cameras[camera].T_rig_cam
            for o in outcomes:
                if o.accepted and o.T_query_ref is not None and o.query_timestamp_ns not in poses:
                    T_world_refcam = T_world_ref[o.ref_timestamp_ns] @ T_rig_refcam
                    poses[o.query_timestamp_ns] = T_world_refcam @ invert(o.T_query_ref) @ invert(T_rig_cam)
        out.append(poses)
    return out


def _write_traversal(
    writer: DatasetWriter,
    recording: FieldRecording,
    drive: Drive,
    cameras: Sequence[str],
    frames: Mapping[str, _Chosen],
    poses: Mapping[int, Array],
    options: FieldOptions,
    reporter: Reporter,
    run: Run,
) -> None:
    """Description, poses, images and depth of one drive; depth where there is a pose."""
    name, length, depth = recording.name, options.depth_submap, DepthOptions()
    entries = {}
    for camera in cameras:
        stream = recording.cameras[camera]
        posed = [time for time in frames[camera].times if time in poses]
        sigma = depth_sigma(drive, stream.camera, stream.T_rig_cam, posed, length, depth) if posed else (0.0, 0.0, 0.0)
        entries[camera] = CameraEntry.of(stream.camera, stream.T_rig_cam, sigma)
    condition = options.conditions.get(name, recording.condition)
    file = TraversalFile(
        name=name,
        condition=condition,
        location=recording.location,
        cameras=entries,
        source=f"recording {recording.folder.name}, depth from lidar submaps of {length:g} m",
    )
    writer.traversal(file, dict(poses))
    for camera in cameras:
        stream, chosen = recording.cameras[camera], frames[camera]
        _write_images(writer, name, stream, chosen, options, reporter, run)
        wanted = [
            DepthFrame(time, writer.layout.traversal(name).depth(camera, time))
            for time in chosen.times
            if time in poses and writer.needs_depth(name, camera, time)
        ]
        make_depth(drive, stream.camera, stream.T_rig_cam, wanted, length, depth, reporter, run)


@dataclass(frozen=True, eq=False)
class _ImageUnit:
    """Images that have to be developed before they can be written."""

    stream: CameraStream
    layout: DatasetLayout
    traversal: str
    indices: tuple[int, ...]


def _write_images(
    writer: DatasetWriter,
    traversal: str,
    stream: CameraStream,
    chosen: _Chosen,
    options: FieldOptions,
    reporter: Reporter,
    run: Run,
) -> None:
    developed = []
    with reporter.stage(f"images of {traversal}", len(chosen.indices)) as advance:
        for index, time in zip(chosen.indices, chosen.times, strict=True):
            source = stream.file(index)
            if source is not None:
                writer.link_image(traversal, stream.name, time, source, copy=options.copy_images)
                advance(1)
            elif writer.needs_image(traversal, stream.name, time):
                developed.append(index)
            else:
                advance(1)
        units = [
            _ImageUnit(stream, writer.layout, traversal, tuple(part)) for part in chunks(developed, _IMAGES_A_UNIT)
        ]
        for _, done in run_units(_develop, units, workers=run.workers, scheduler=run.scheduler):
            advance(done)


def _develop(unit: _ImageUnit) -> int:
    for index in unit.indices:
        time = int(unit.stream.times_ns[index])
        path = unit.layout.traversal(unit.traversal).image(unit.stream.name, time)
        images.write_image(path, unit.stream.read(index))
    return len(unit.indices)


def _summary(query: str, camera: str, outcomes: Sequence[PairOutcome]) -> str:
    """One line for a person: how many pairs, how certain, and why the others are not in."""
    accepted = [o for o in outcomes if o.accepted]
    text = f"{query}, {camera}: {len(accepted)} of {len(outcomes)} pairs accepted"
    if accepted:
        sigma_cm = 100 * float(
            np.median([o.sigma_translation_m for o in accepted if o.sigma_translation_m is not None])
        )
        turn = float(np.median([o.sigma_rotation_deg for o in accepted if o.sigma_rotation_deg is not None]))
        text += f", median sigma {sigma_cm:.1f} cm and {turn:.3f} deg"
    reasons = Counter(o.reason.split(":")[0] for o in outcomes if not o.accepted)
    return "; ".join([text, *(f"{count}: {reason}" for reason, count in reasons.most_common(3))])
