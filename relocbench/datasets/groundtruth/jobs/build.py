"""The build of a dataset from recordings of one road: the first is the reference, the others are queries.

Intermediate results that take long are written to ``OUT/groundtruth``, where a killed build continues:
``blocks/TRAVERSAL`` (points), ``registrations/REF__QUERY.csv`` (the registration of each node, with its evidence) and
``graph/REF__QUERY.csv`` (the poses of the nodes). Depth and images are written file by file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from relocbench.datasets.core.build import Build
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import parse_pose
from relocbench.datasets.groundtruth.alignment.two_drives import FirstPose
from relocbench.datasets.groundtruth.depth.stereo import stereo_pair
from relocbench.datasets.groundtruth.jobs.aligning import Aligned, align
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.groundtruth.jobs.readying import ready
from relocbench.datasets.groundtruth.jobs.recipe import pair_by_recipe
from relocbench.datasets.groundtruth.jobs.scaling import reduced_paired
from relocbench.datasets.groundtruth.jobs.writing import (
    Frames,
    camera_frames,
    choose_frames,
    rig_poses,
    write_traversal,
)
from relocbench.datasets.groundtruth.pairs.outcome import PairOutcome
from relocbench.datasets.groundtruth.pairs.pairing import Paired, PairingUnit, pair_up
from relocbench.datasets.groundtruth.pairs.reasons import by_kind
from relocbench.datasets.groundtruth.pose_graph.files import write_graph
from relocbench.datasets.groundtruth.registration.scene_scale import SceneScale
from relocbench.datasets.groundtruth.submaps.drive import Drive, make_drive
from relocbench.datasets.pairs.writing import write_pair_set
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run, run_units
from relocbench.progress import Reporter

RIG = "rig"
"""the frame of pairs without images"""
_ALONE = "--cameras none pairs poses of the rig without images"


def build_ground_truth(recordings: Sequence[FieldRecording], job: Build[FieldOptions]) -> Dataset:
    """Build the dataset of a reference drive and its query drives.

    Args:
        recordings: at least two, the reference first.

    Raises:
        ConfigError: an option does not fit the recordings.
        DatasetError: a recording is damaged, or no pair could be accepted; names the most frequent reason.
    """
    options, reporter, run = job.options, job.reporter, job.run
    cameras, first = check_recordings(recordings, options)
    if cameras == (RIG,) and RIG not in recordings[0].cameras:
        recordings = [replace(recording, cameras={}) for recording in recordings]
        reporter.note(
            "poses of the rig at scans of lidar are paired, without images: no tracker can run on this dataset"
        )
    recordings, large, scale = ready(recordings, cameras, job)
    folder = job.writer.layout.root / "groundtruth"
    if not options.use_prior:
        large = [replace(recording, prior=None) for recording in large]
    if first is not None:
        first = (*first[:2], scale.enlarged(first[2]))
    aligned = None
    if options.recipe == "own":
        estimate = options.calibration == "estimate"
        aligned = align(large, folder, options.alignment, first, estimate, reporter, run, scale.factor)
    drives = aligned.drives if aligned is not None else _cut(large, folder, options, reporter, run)
    frames = [
        {
            name: choose_frames(r, drive, name, options, is_reference=r is recordings[0], enlarged=scale.factor)
            for name in cameras
        }
        for r, drive in zip(recordings, drives, strict=True)
    ]
    reference, queries = drives[0], drives[1:]
    if aligned is None:
        paired = pair_by_recipe(drives, frames, folder, options, first, reporter, run, scale.factor)
    else:
        images = zip(queries, frames[1:], strict=True)
        units = [_unit(aligned, query, (frames[0], of_query), options, scale) for query, of_query in images]
        paired = _pair(units, folder / "graph", reporter, run)
    paired = [reduced_paired(one, scale.factor) for one in paired]
    _require_accepted(paired, [q.name for q in queries], folder / "registrations")
    poses = rig_poses(recordings, frames, paired)
    for recording, drive, chosen, known in zip(recordings, drives, frames, poses, strict=True):
        write_traversal(job, recording, drive, chosen, known, scale.factor)
    for query, answer in zip(queries, paired, strict=True):
        for camera, outcomes in answer.outcomes.items():
            write_pair_set(job, reference.name, query.name, camera, [outcome.pair() for outcome in outcomes])
            reporter.note(_summary(query.name, camera, outcomes))
    return job.writer.finish()


def check_recordings(
    recordings: Sequence[FieldRecording], options: FieldOptions
) -> tuple[tuple[str, ...], FirstPose | None]:
    """Check recordings against the options. Returns the cameras whose images are paired, and the pose given by hand.

    Where no recording has images, or none are wanted, the one camera is :data:`RIG`, whose poses are paired.

    Raises:
        ConfigError: there are fewer than two drives, one of them lacks a camera or, for depth by stereo, its partner,
            or the pose given by hand cannot be read or is of a time outside the drives.
        DatasetError: the reference has no images, and another drive has.
    """
    if len(recordings) < 2:
        raise ConfigError(f"ground truth across drives needs a reference and at least one other, got {len(recordings)}")
    cameras = recordings[0].cameras
    if (options.without_images and "none" not in cameras) or not (
        options.cameras or any(recording.cameras for recording in recordings)
    ):
        if options.depth == "stereo":
            raise ConfigError("--depth stereo needs images of two cameras, and poses of the rig are paired without any")
        return (RIG,), _first_pose(recordings, options)
    wanted = options.cameras or tuple(cameras)[:1]
    if not wanted:
        raise DatasetError(f"holds no images, but other recordings do: {_ALONE}", recordings[0].folder)
    for recording in recordings:
        for name in wanted:
            if name not in recording.cameras:
                known = ", ".join(recording.cameras) or "none"
                message = f"--cameras: {recording.name} has no images of a camera '{name}'; it has {known}"
                raise ConfigError(message if recording.cameras else f"{message}; {_ALONE}")
            if options.depth == "stereo" and stereo_pair(recording.cameras, name) is None:
                message = f"--depth stereo: {recording.name} has no camera to the right of {name}, rectified with it"
                raise ConfigError(message)
    return wanted, _first_pose(recordings, options)


def _first_pose(recordings: Sequence[FieldRecording], options: FieldOptions) -> FirstPose | None:
    """The pose of ``--first-pose``; its query time decides which query drive it is of."""
    if not options.first_pose:
        return None
    words = options.first_pose.replace(",", " ").split()
    try:
        ref_ns, query_ns = (int(word) for word in words[:2])
        pose = parse_pose(words[2:], Path("--first-pose"), 1)
    except (ValueError, DatasetError):
        raise ConfigError("--first-pose: expected 'REF_NS QUERY_NS tx ty tz qx qy qz qw'") from None
    for time, drives in ((ref_ns, recordings[:1]), (query_ns, recordings[1:])):
        if not any(r.odometry.times_ns[0] <= time <= r.odometry.times_ns[-1] for r in drives):
            names = ", ".join(r.name for r in drives)
            raise ConfigError(f"--first-pose: {time} (nanoseconds) is outside the times of {names}")
    return ref_ns, query_ns, pose


def _cut(
    recordings: Sequence[FieldRecording], folder: Path, options: FieldOptions, reporter: Reporter, run: Run
) -> list[Drive]:
    """The drives, cut into blocks, from which depth is drawn."""
    block_m = options.alignment.block_m
    return [make_drive(r, folder / "blocks" / r.name, block_m, reporter, run) for r in recordings]


def _unit(
    aligned: Aligned,
    query: Drive,
    frames: tuple[Mapping[str, Frames], Mapping[str, Frames]],
    options: FieldOptions,
    scale: SceneScale,
) -> PairingUnit:
    cameras = tuple(camera_frames(name, frames[0][name], frames[1][name], scale.factor) for name in frames[0])
    limits = (options.limits_at(scale.factor), options.max_angle)
    registrations, shared = tuple(aligned.registrations[query.name]), aligned.shared.get(query.name)
    return PairingUnit(aligned.drives[0], query, registrations, cameras, *limits, shared)


def _pair(units: Sequence[PairingUnit], folder: Path, reporter: Reporter, run: Run) -> list[Paired]:
    out: dict[int, Paired] = {}
    with reporter.stage("pose graphs and pairs", len(units)) as advance:
        for index, paired in run_units(pair_up, units, run):
            unit = units[index]
            path = folder / f"{unit.reference.name}__{unit.query.name}.csv"
            write_graph(path, paired.reference, paired.query)
            out[index] = paired
            advance(1)
    return [out[k] for k in range(len(units))]


def _require_accepted(paired: Sequence[Paired], queries: Sequence[str], folder: Path) -> None:
    """Raises DatasetError if no pair was accepted."""
    everything = [o for p in paired for outcomes in p.outcomes.values() for o in outcomes]
    if any(o.accepted for o in everything):
        return
    kinds = by_kind(o.reason for o in everything)
    often = next(iter(kinds.values()))[0] if kinds else "there are no images"
    raise DatasetError(
        f"no pair of {', '.join(queries)} could be accepted; most often: {often} (the registrations are here)", folder
    )


def _summary(query: str, camera: str, outcomes: Sequence[PairOutcome]) -> str:
    """One line for the user: the number of accepted pairs, their median sigmas, and why others were rejected."""
    accepted = [o for o in outcomes if o.accepted]
    text = f"{query}, {camera}: {len(accepted)} of {len(outcomes)} pairs accepted"
    if accepted:
        metres = np.median([o.sigma_translation_m for o in accepted if o.sigma_translation_m is not None])
        degrees = np.median([o.sigma_rotation_deg for o in accepted if o.sigma_rotation_deg is not None])
        length = f"{100 * metres:.1f} cm" if metres >= 0.002 else f"{1000 * metres:.2f} mm"
        text += f", median sigma {length} and {degrees:.3f} deg"
        if not accepted[0].pair().has_calibrated_sigmas:
            text += ", as Open3D states it: not calibrated, and many times smaller than the errors"
    kinds = by_kind(o.reason for o in outcomes if not o.accepted)
    return "; ".join([text, *(f"{len(reasons)}: {reasons[0]}" for reasons in list(kinds.values())[:3])])
