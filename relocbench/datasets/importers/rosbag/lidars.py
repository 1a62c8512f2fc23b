"""The lidars of a bag: their poses on the rig, their pattern, and how the times of their points are told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from relocbench.datasets.groundtruth.odometry.scan_motion import detected_motion
from relocbench.datasets.importers.rosbag import kinds
from relocbench.datasets.importers.rosbag.clouds import cloud_fields
from relocbench.datasets.importers.rosbag.reading import Reading
from relocbench.datasets.importers.rosbag.streams import BagLidar
from relocbench.datasets.sensors.point_times import FIELDS, PointTimes, detect
from relocbench.errors import ConfigError, DatasetError

_SAMPLES = 5
"""scans from which the times of points and the pattern are told"""
_FLAT = 1e-5
"""a scan is flat if its points leave a plane through the lidar by less than this part of their distance"""


def lidar_stream(reading: Reading, name: str, topic: str) -> BagLidar:
    """A lidar whose pose on the rig, pattern and times of points are known.

    Raises:
        DatasetError: a scan is damaged, nothing tells its pose, or the times of its points make no sense.
        ConfigError: the settings do not fit it.
    """
    settings, about = reading.settings, reading.survey.topics[topic]
    messages, times = reading.messages(topic)
    pose = settings.extrinsics.lidar(name, topic)
    if pose is None:
        pose = reading.frames.transform(reading.base, about.frame)
    farthest = settings.max_range_m
    if about.type == kinds.LASER:
        farthest = min(farthest, float(reading.survey.first(topic).range_max))
    plain = BagLidar(
        name, messages, pose, times, "push-broom", PointTimes(), settings.min_range_m, farthest, settings.sigma_m
    )
    if about.type == kinds.LASER:
        reading.note(f"{topic}: laser scans, times by time_increment")
        return plain
    if about.type == kinds.PACKETS:
        return _of_packets(reading, plain)
    samples = np.unique(np.linspace(0, len(times) - 1, _SAMPLES).astype(int)).tolist()
    pattern = settings.pattern
    if pattern == "auto":
        pattern = "push-broom" if _flat(plain, samples) else "spinning"
    spread = _point_times(reading, plain, samples, pattern)
    lidar = replace(plain, pattern=pattern, times=spread)
    if settings.motion == "auto" and settings.point_times is None and pattern == "spinning" and not spread.field:
        swept = replace(lidar, times=PointTimes(turn_ns=_turn_ns(plain)))
        title = f"{reading.name}: {topic}: points have no times"
        if detected_motion(title, lidar, swept, reading.reporter) == "distorted":
            lidar = swept
    reading.note(f"{topic}: {pattern} lidar, times of points: {lidar.times}")
    return lidar


def _turn_ns(lidar: BagLidar) -> int:
    """The time of a turn: from one scan to the next."""
    return round(float(np.median(np.diff(lidar.times_ns))))


def _of_packets(reading: Reading, plain: BagLidar) -> BagLidar:
    """A lidar whose messages hold packets: it spins, and its points have the times of their firings."""
    settings = reading.settings
    if settings.point_times is not None and settings.point_times.field:
        raise ConfigError(f"--point-time: {plain.messages.topic} holds packets, which have no fields")
    timed = settings.motion != "compensated" and settings.point_times is None
    pattern = "spinning" if settings.pattern == "auto" else settings.pattern
    message = "by their firings" if timed else "none: scans are taken as motion compensated"
    reading.note(f"{plain.messages.topic}: {pattern} lidar, packets of a Velodyne, times of points: {message}")
    return replace(plain, pattern=pattern, packets=settings.packets, timed=timed)


def _flat(lidar: BagLidar, samples: Sequence[int]) -> bool:
    """Whether all points of each scan lie in one plane through the lidar."""
    scans = [points for i in samples if len(points := lidar.read(i).points) >= 10]
    return bool(scans) and all(np.linalg.svd(p, compute_uv=False)[2] < _FLAT * np.linalg.norm(p) for p in scans)


def _point_times(reading: Reading, lidar: BagLidar, samples: Sequence[int], pattern: str) -> PointTimes:
    settings, topic = reading.settings, lidar.messages.topic
    period = float(_turn_ns(lidar))
    if settings.motion == "distorted" and settings.point_times is None:
        found = _detected(reading, lidar, samples, period)
        if not found.field and pattern != "spinning":
            raise ConfigError(f"--motion distorted: {topic} is not a spinning lidar, and its points have no times")
        return found if found.field else PointTimes(turn_ns=_turn_ns(lidar))
    if settings.motion == "compensated":
        return PointTimes()
    if settings.point_times is None:
        return _detected(reading, lidar, samples, period)
    name = settings.point_times.field
    if name and name not in reading.survey.topics[topic].fields:
        available = ", ".join(reading.survey.topics[topic].fields)
        raise ConfigError(f"--point-time: {topic} has no field {name!r}; it has {available}")
    return settings.point_times


def _detected(reading: Reading, lidar: BagLidar, samples: Sequence[int], period: float) -> PointTimes:
    topic = lidar.messages.topic
    name = next((f for f in reading.survey.topics[topic].fields if f in FIELDS), None)
    if name is None:
        return PointTimes()
    scans = []
    for i in samples:
        message, part, received = lidar.messages.read(i)
        try:
            fields = cloud_fields(message, ("x", "y", "z", name))
        except ValueError as bad:
            raise part.fault(topic, received, str(bad)) from None
        # Beams without a return often have no time either.
        returned = lidar.in_range(np.column_stack([fields[axis] for axis in "xyz"]).astype(np.float64))
        scans.append((int(lidar.times_ns[i]), fields[name][returned]))
    try:
        return detect(name, scans, period)
    except ValueError as bad:
        raise DatasetError(
            f"{topic}: {bad}; give it by --point-time (FIELD:UNIT:BASE, or none if scans are motion compensated)",
            reading.source,
        ) from None
