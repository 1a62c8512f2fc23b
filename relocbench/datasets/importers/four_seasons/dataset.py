"""4Seasons and MLAD recordings: rectified images, sparse keyframe points, GNSS-fused poses, relocalization files.

The rig's frame is the rectified left camera (cam0). Poses are those of ``GNSSPoses.txt`` times its scale, or those of
MLAD's ``poses.txt``. Recordings are transformed to the SLAM world of the first one through the earth's frame,
``inv(T_e_w_first) @ T_e_w``, each ``T_e_w`` from ``Transformations.txt``; no file holds ECEF coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from relocbench.arrays import Array
from relocbench.datasets.core import images
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import ImportOptions, PosedRecordingOptions
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.schema import CameraEntry, TraversalFile
from relocbench.datasets.importers.assembly import open_writer, write_pairs
from relocbench.datasets.importers.four_seasons.calibration import StereoCalibration, find_calibration, read_calibration
from relocbench.datasets.importers.four_seasons.files import read_keyframe
from relocbench.datasets.importers.four_seasons.pairs import ListedPair, pairs_of_files, read_relocalization_files
from relocbench.datasets.importers.four_seasons.receiver import agreement, read_gga
from relocbench.datasets.importers.four_seasons.recording import (
    CAMERAS,
    TRACK,
    Recording,
    common_frames,
    read_recording,
)
from relocbench.datasets.pairs.writing import write_pair_set
from relocbench.datasets.sensors.trajectories import traversal_names
from relocbench.errors import DatasetError
from relocbench.execution import Run
from relocbench.files import fitting_name
from relocbench.geometry import Camera, apply, invert
from relocbench.progress import Reporter

_INTRINSICS_TOLERANCE_PX = 0.05
_CAM0, _CAM1 = CAMERAS


class Options(PosedRecordingOptions):
    """Options of the four-seasons importer."""

    calibration_folder: Path | None = Field(
        None, description="calibration folder; default: Calibration or calibration, in the recording or beside it"
    )
    relocalization_files: tuple[Path, ...] = Field(
        (), description="relocalization files, or folders of them; their pairs replace those by rule"
    )
    withheld_truth: Literal["leave", "from-poses"] = Field(
        "leave",
        description="relocalization files without poses: leave the truth out, or compute it from the poses of the two "
        "recordings",
    )
    point_filter: Literal["usual", "none"] = Field(
        "usual", description="'usual': only points of low variance and sufficient baseline; 'none': all points"
    )

    @model_validator(mode="after")
    def _files_name_all_pairs(self) -> Self:
        if self.relocalization_files and self.elsewhere:
            raise ValueError("elsewhere has no effect with relocalization_files, which name all pairs")
        return self


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Import one or more recordings; the first is the reference. Raises as :class:`Importer`."""
    assert isinstance(options, Options)
    names = traversal_names(sources)
    options.check_conditions(names)
    writer = open_writer("four-seasons", sources, options, out, fitting_name("four-seasons-" + "-".join(names)))
    if writer.complete:
        return Dataset(out)
    job = Build(writer, options, reporter, run)
    recordings = [read_recording(source, name, reporter) for source, name in zip(sources, names, strict=True)]
    frames = common_frames(recordings, reporter)
    listed = read_relocalization_files(options.relocalization_files, recordings)
    if not options.relocalization_files:
        _check_rule_can_pair(recordings, frames)
    calibrations = _calibrations(recordings, options, reporter)
    for recording in recordings:
        _check_track(recording, reporter)
        _Import(job, recording, calibrations[recording.name]).write(
            frames.get(recording.name, np.eye(4)), _listed_times(listed, recording)
        )
    if options.relocalization_files:
        sets = pairs_of_files(listed, frames, options.withheld_truth == "from-poses", reporter)
        for key, pairs in sets.items():
            write_pair_set(job, *key, _CAM0, pairs)
    else:
        reference, *others = recordings
        for query in others or [reference]:
            if reference.has_images and query.has_images and query.name in frames:
                source, where = query.pose_source, query.root
                write_pairs(job, reference.name, query.name, _CAM0, source=source, where=where)
    return writer.finish()


@dataclass(frozen=True, eq=False)
class _Import:
    """Writes one recording as a traversal of the dataset."""

    job: Build[Options]
    recording: Recording
    calibration: StereoCalibration

    def write(self, T_common_w: Array, listed: set[int]) -> None:
        """Write rig, poses, images of the posed and listed frames, and keyframe points."""
        recording = self.recording
        poses = {t: T_common_w @ T_w_cam for t, T_w_cam in recording.T_w_cam.items()}
        self.job.writer.traversal(self._traversal_file(), poses)
        self._link_images({*poses, *recording.keyframes, *listed})
        self._write_points()

    def _traversal_file(self) -> TraversalFile:
        stereo = self.calibration
        cameras = {_CAM0: CameraEntry.of(stereo.cam0)}
        if stereo.cam1 is not None and stereo.T_cam1_cam0 is not None and self.recording.images[_CAM1]:
            cameras[_CAM1] = CameraEntry.of(stereo.cam1, invert(stereo.T_cam1_cam0))
        return TraversalFile(
            name=self.recording.name,
            condition=self.job.options.condition_of(self.recording.name),
            cameras=cameras,
            source=f"4Seasons recording {self.recording.name}, rig frame rectified cam0",
        )

    def _link_images(self, times: set[int]) -> None:
        name = self.recording.name
        units = [(c, t, p) for c in CAMERAS for t, p in self.recording.images[c].items() if t in times]
        if not self.recording.has_images:
            self.job.reporter.note(
                f"{name} has no undistorted_images/{_CAM0}: its poses and points are imported for inspection, but none "
                "of its pairs can be evaluated"
            )
            return
        with self.job.reporter.stage(f"images of {name}", len(units)) as advance:
            for camera, time, path in units:
                self.job.writer.link_image(name, camera, time, path, copy=self.job.options.copy_images)
                advance(1)

    def _write_points(self) -> None:
        job, recording = self.job, self.recording
        layout = job.writer.layout.traversal(recording.name)
        seen = recording.images[_CAM0]
        chosen = {t: p for t, p in recording.keyframes.items() if t in seen or not recording.has_images}
        if len(chosen) < len(recording.keyframes):
            job.reporter.note(f"{len(recording.keyframes) - len(chosen)} keyframes of {recording.name} have no image")
        if not recording.scales and chosen and recording.default_scale == 1.0:
            job.reporter.note(f"{recording.name} gives no GNSS scale: its keyframe points are taken to be in metres")
        units = [
            _KeyframeUnit(
                path,
                layout.points(_CAM0, time),
                self.calibration.cam0,
                recording.scale(time),
                job.options.point_filter == "usual",
            )
            for time, path in chosen.items()
        ]
        empty = job.work(f"keyframe points of {recording.name}", _write_keyframe, units).count(0)
        if empty:
            job.reporter.note(f"{empty} keyframes of {recording.name} have no point that passes the filter")


@dataclass(frozen=True, eq=False)
class _KeyframeUnit:
    """One keyframe file to convert."""

    source: Path
    target: Path
    camera: Camera
    scale: float
    filtered: bool


def _write_keyframe(unit: _KeyframeUnit) -> int:
    """Write the points of one keyframe and return their number; no file is written if there are none."""
    keyframe = read_keyframe(unit.source)
    own, rectified = keyframe.camera, unit.camera
    # Keyframe files repeat the intrinsics, which differ from file to file in the sixth digit.
    apart = np.abs(own.matrix - rectified.matrix).max()
    if own.size != rectified.size or apart > _INTRINSICS_TOLERANCE_PX:
        raise DatasetError(
            f"was made with other intrinsics ({apart:.3g} px apart, {own.width}x{own.height}) than the calibration's "
            f"rectified cam0 ({rectified.width}x{rectified.height})",
            unit.source,
        )
    points = keyframe.points(unit.scale, keyframe.reliable if unit.filtered else None)
    if len(points):
        images.write_points(unit.target, points)
    return len(points)


def _calibrations(
    recordings: Sequence[Recording], options: Options, reporter: Reporter
) -> Mapping[str, StereoCalibration]:
    """Rectified cameras by traversal name; a recording without calibration gets that of the first one."""
    found: dict[str, StereoCalibration] = {}
    for recording in recordings:
        folder = options.calibration_folder or find_calibration(recording.root)
        if folder is not None:
            found[recording.name] = read_calibration(folder)
        elif found:
            found[recording.name] = found[recordings[0].name]
            reporter.note(f"{recording.name} has no calibration folder; that of {recordings[0].name} is used")
        elif recording.keyframes:
            found[recording.name] = StereoCalibration(read_keyframe(next(iter(recording.keyframes.values()))).camera)
            reporter.note(f"{recording.name} has no calibration folder; the intrinsics of its first keyframe are used")
        else:
            raise DatasetError(
                "has neither a calibration folder nor a keyframe; give --calibration-folder", recording.root
            )
    return found


def _check_track(recording: Recording, reporter: Reporter) -> None:
    """Compare poses with the receiver's track, if there is one, which reveals a wrong scale or frame."""
    if recording.T_e_w is None or not (recording.root / TRACK).exists():
        return
    positions = {t: apply(recording.T_e_w, T_w_cam[None, :3, 3])[0] for t, T_w_cam in recording.T_w_cam.items()}
    found = agreement(positions, read_gga(recording.root / TRACK))
    if found is not None:
        reporter.note(
            f"{recording.name} compared with its GNSS track: path length ratio {found.path_ratio:.4f}, median distance "
            f"{found.horizontal_m:.1f} m horizontally and {abs(found.vertical_m):.1f} m vertically"
        )


def _listed_times(listed: Sequence[ListedPair], recording: Recording) -> set[int]:
    references = {p.line.ref_timestamp_ns for p in listed if p.reference is recording}
    return references | {p.line.query_timestamp_ns for p in listed if p.query is recording}


def _check_rule_can_pair(recordings: Sequence[Recording], frames: Mapping[str, Array]) -> None:
    """Raise DatasetError, before hours of work, if no two recordings with images share a frame to pair them in."""
    reference, *queries = recordings
    if queries and all(r.has_images for r in recordings) and not any(q.name in frames for q in queries):
        raise DatasetError(
            f"no pair: its frame cannot be related to the queries' without Transformations.txt and GNSSPoses.txt of "
            f"both; give --relocalization-files, or import {reference.name} alone",
            reference.root,
        )
