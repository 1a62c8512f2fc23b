"""Checks of recordings before any work begins, so that faults of inputs are found in seconds and told all at once.

Odometry that has to be computed from lidar is computed after these checks.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from relocbench.arrays import Times
from relocbench.datasets.groundtruth.blocks.nodes import arc_length_along
from relocbench.datasets.groundtruth.jobs.mounting import mounting_faults
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.groundtruth.jobs.repeats import repeat_faults
from relocbench.datasets.groundtruth.jobs.scaling import enlarged
from relocbench.datasets.groundtruth.odometry.length import LARGEST_STRETCH, length_ratio
from relocbench.datasets.sensors.recording import CameraStream, FieldRecording, LidarStream
from relocbench.errors import DatasetError
from relocbench.progress import Reporter

FEWEST_SCANS = 10
LEAST_ROAD_M = 5.0
"""a few blocks; registrations of fewer cannot confirm each other"""
_BYTES_A_METRE = 100_000
"""blocks of a drive with two push-broom lidars, measured"""


def faults_of(recording: FieldRecording, cameras: Sequence[str]) -> list[DatasetError]:
    """What is wrong with the scans and images of a recording; the first, middle and last of each sensor are read."""
    faults = []
    if not recording.lidars:
        faults.append(DatasetError("has no lidar scans, which the ground truth is made from", recording.folder))
    for lidar in recording.lidars:
        faults += _scan_faults(recording, lidar)
    for name in cameras:
        if name in recording.cameras:
            faults += _image_faults(recording, recording.cameras[name])
    return faults


def _scan_faults(recording: FieldRecording, lidar: LidarStream) -> list[DatasetError]:
    count = len(lidar.times_ns)
    if count < FEWEST_SCANS:
        return [DatasetError(f"{lidar.name} has {count} scans; at least {FEWEST_SCANS} are needed", recording.folder)]
    points: list[int] = []

    def look(index: int) -> None:
        points.append(len(lidar.read(index).points))

    faults = _looked_at(look, count)
    if not faults and not any(points):
        message = f"{lidar.name}: its first, middle and last scan have no point within {lidar.max_range_m:g} m"
        faults = [DatasetError(message, recording.folder)]
    return faults or repeat_faults(recording, lidar)


def _image_faults(recording: FieldRecording, stream: CameraStream) -> list[DatasetError]:
    times, scans = stream.times_ns, [lidar.times_ns for lidar in recording.lidars if len(lidar.times_ns)]
    if not len(times):
        return [DatasetError(f"camera {stream.name} has no images", recording.folder)]
    if scans:
        begin, end = min(int(s[0]) for s in scans), max(int(s[-1]) for s in scans)
        if not np.any((times >= begin) & (times <= end)):
            spans = f"{_span(times)}, the lidar scans from {_span(np.array([begin, end]))}"
            message = f"no image of {stream.name} was taken while a lidar recorded: the images are from {spans}"
            return [DatasetError(message, recording.folder)]

    def look(index: int) -> None:
        size = stream.read(index).shape[1::-1]
        if size != stream.camera.size:
            wanted = "x".join(map(str, stream.camera.size))
            message = f"image {index} of {stream.name} has {size[0]}x{size[1]} pixels, expected {wanted}"
            raise DatasetError(message, stream.file(index) or recording.folder)

    return _looked_at(look, len(times))


def _looked_at(look: Callable[[int], None], count: int) -> list[DatasetError]:
    """The faults of the first, middle and last of a sensor's files; the same fault is told once."""
    faults: dict[str, DatasetError] = {}
    for index in dict.fromkeys((0, count // 2, count - 1)):
        try:
            look(index)
        except DatasetError as bad:
            faults.setdefault(bad.expected, bad)
    return list(faults.values())


def motion_faults(
    recording: FieldRecording, options: FieldOptions, reporter: Reporter, factor: float = 1.0
) -> list[DatasetError]:
    """What is wrong with the odometry of a recording that will be enlarged; what only shortens the result is noted."""
    faults = _clock_faults(recording, reporter) or _length_faults(recording, options, reporter, factor)
    if not faults and factor == 1.0:  # in a room, ceilings may be seen better than the floor
        faults = mounting_faults(recording)
    return faults or (stretch_faults(recording) if options.use_prior else [])


def stretch_faults(recording: FieldRecording) -> list[DatasetError]:
    """The fault of odometry whose length is not that by GNSS, if there is GNSS."""
    prior = recording.prior
    if prior is None:
        return []
    ratio = length_ratio(recording.odometry, prior, recording.prior_sigma_m)
    if ratio is None or not ratio.exceeds(LARGEST_STRETCH):
        return []
    message = (
        f"the path by odometry is {ratio.words(1)} than by GNSS (known to {100 * ratio.margin:.1f} %), expected at "
        f"most {100 * LARGEST_STRETCH:g} %: no submap would fit those of other drives; correct the scale of the "
        "odometry, or give --no-use-prior if the GNSS is wrong"
    )
    return [DatasetError(message, recording.folder)]


def _clock_faults(recording: FieldRecording, reporter: Reporter) -> list[DatasetError]:
    odometry, folder = recording.odometry, recording.folder
    for lidar in recording.lidars:
        share = float(np.mean(odometry.covers(lidar.times_ns)))
        if share == 0.0:
            message = (
                f"the odometry covers no scan of {lidar.name}: it is from {_span(odometry.times_ns)}, the scans from "
                f"{_span(lidar.times_ns)}; times of both must be of one clock and in one unit"
            )
            return [DatasetError(message, folder)]
        if share < 0.5:
            reporter.note(f"{recording.name}: the odometry covers {100 * share:.0f} % of the scans of {lidar.name}")
    return []


def _length_faults(
    recording: FieldRecording, options: FieldOptions, reporter: Reporter, factor: float
) -> list[DatasetError]:
    folder, driven = recording.folder, driven_m(enlarged(recording, factor))
    if factor != 1.0 and driven < options.submap - 1:
        driven, submap, least = driven / factor, options.submap / factor, LEAST_ROAD_M / factor
        if driven < least:
            message = f"moved {driven:.2g} m while a lidar recorded; at least {least:.2g} m are needed at this --scale"
            return [DatasetError(message, folder)]
        reporter.note(
            f"{recording.name} moved {driven:.2g} m, less than a submap has ({submap:.2g} m, enlarged --submap "
            f"{options.submap:g}): its submaps hold {driven:.2g} m at most, and poses are less certain"
        )
        return []
    if driven < LEAST_ROAD_M:
        message = f"drove {driven:.1f} m of road while a lidar recorded; at least {LEAST_ROAD_M:g} m are needed"
        return [DatasetError(f"{message}, and {options.submap:g} m to fill a submap (--submap)", folder)]
    if driven < options.submap - 1:
        reporter.note(
            f"{recording.name} drove {driven:.0f} m of road, less than a submap has (--submap {options.submap:g}): "
            f"its submaps hold {driven:.0f} m at most, and poses are less certain"
        )
    return []


def driven_m(recording: FieldRecording) -> float:
    """Metres of road driven while a lidar recorded and the odometry was known.

    Raises:
        DatasetError: odometry and lidars have no time in common.
    """
    way = arc_length_along(recording)
    ends = [way.travelled_m[way.segment == s] for s in np.unique(way.segment)]
    return float(sum(metres[-1] - metres[0] for metres in ends))


def check_space(root: Path, metres: float) -> None:
    """Raise DatasetError if the disk has no room for the blocks of so many metres of road."""
    place = next(path for path in (root.resolve(), *root.resolve().parents) if path.exists())
    free, needed = shutil.disk_usage(place).free, int(metres * _BYTES_A_METRE)
    if free < needed:
        message = (
            f"{free / 2**20:.0f} MiB are free; the blocks of {metres:.0f} m of road need about {needed / 2**20:.0f} MiB"
        )
        raise DatasetError(message, root)


def _span(times_ns: Times) -> str:
    return f"{_moment(int(times_ns[0]))} to {_moment(int(times_ns[-1]))}"


def _moment(time_ns: int) -> str:
    """A time as a date if it is one since 1990, else in seconds."""
    seconds = time_ns / 1e9
    if seconds < 631152000 or seconds > 4e9:
        return f"{seconds:.3f} s"
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S}"
