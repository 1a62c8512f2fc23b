"""A bag read as a recording: lidars, cameras, odometry, GNSS, and the poses of sensors on the rig by tf."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from relocbench.datasets.core.schema import CameraEntry, Condition
from relocbench.datasets.groundtruth.odometry.deferred import Pending, with_prior
from relocbench.datasets.groundtruth.odometry.lidar_odometry import FromLidar, lidar_odometry
from relocbench.datasets.importers.rosbag.bag import parts_of
from relocbench.datasets.importers.rosbag.lidars import lidar_stream
from relocbench.datasets.importers.rosbag.motion import GeodeticOrigin
from relocbench.datasets.importers.rosbag.pictures import calibration_of
from relocbench.datasets.importers.rosbag.reading import BagSettings, Opened, Reading
from relocbench.datasets.importers.rosbag.roles import TABLE, CameraTopic, Roles, Wanted, choose, table
from relocbench.datasets.importers.rosbag.stamps import check_clocks, silences
from relocbench.datasets.importers.rosbag.streams import BagCamera, read_picture
from relocbench.datasets.importers.rosbag.survey import Survey, survey
from relocbench.datasets.importers.rosbag.tracks import fix_times, odometry, prior
from relocbench.datasets.sensors.recording import MAX_GAP_NS, CameraStream, FieldRecording
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import make_transform
from relocbench.progress import SILENT, Reporter


def open_bag(source: Path, wanted: Wanted, reporter: Reporter = SILENT) -> Opened:
    """Look at a recording and choose its topics; the choice is reported as a table.

    Raises:
        DatasetError: a file is damaged, or it cannot be decided which topic is meant.
        ConfigError: a topic that the user named cannot be used, or rosbags is not installed.
    """
    found = survey(source, parts_of(source))
    roles = choose(found, wanted)
    for line in (*remarks(found), *table_lines(found, roles)):
        reporter.note(line)
    return Opened(found, roles)


def remarks(found: Survey) -> list[str]:
    """What is odd about the files of a recording, although they can be read."""
    return [f"{part.path.name} {part.remark}" for part in found.parts if part.remark]


def table_lines(found: Survey, roles: Roles) -> list[str]:
    """The table of topics as lines of text."""
    rows = [list(TABLE), *table(found, roles)]
    widths = [max(len(row[i]) for row in rows) for i in range(len(TABLE))]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows)
    return [f"{found.source.name}: {line}" for line in lines]


def read_bag(
    opened: Opened,
    name: str,
    settings: BagSettings,
    *,
    origin: GeodeticOrigin | None = None,
    kept: Path | None = None,
    reporter: Reporter = SILENT,
    from_lidar: FromLidar = lidar_odometry,
) -> tuple[FieldRecording, GeodeticOrigin | None]:
    """Read a bag as a recording; scans and images are read later, on demand.

    Args:
        origin: origin of the map that positions by GNSS are in; all drives need that of the first.
        kept: file in which the index is kept; None: it is made anew.
        from_lidar: computes odometry from scans; called after everything else has been checked.

    Returns:
        The recording, and the origin of its map if it has positions by GNSS.

    Raises:
        DatasetError: with file, topic and time: something needed is missing or damaged.
        ConfigError: the settings do not fit the recording.
    """
    reading = Reading(opened, name, settings, kept, reporter)
    lidars = tuple(lidar_stream(reading, title, topic) for title, topic in opened.roles.lidars.items())
    cameras = {
        title: stream for title, topic in opened.roles.cameras.items() if (stream := camera_stream(reading, topic))
    }
    motion = odometry(reading)
    fixes = fix_times(reading)
    check_clocks(reading.lags_ns, reading.source)
    index = reading.index
    places = {topic: of.received_ns for topic, of in index.places.items()}
    for silence in silences(places | {topic: of.received_ns for topic, of in index.poses.items()}):
        reading.note(silence)
    source = ""
    if motion is None:
        spinning = next((lidar for lidar in lidars if lidar.pattern == "spinning"), None)
        if spinning is None:
            message = "has neither odometry nor a spinning lidar to compute it from; name a topic by --odometry"
            raise DatasetError(message, reading.source)
        reading.note(f"odometry is computed from the scans of {spinning.messages.topic}")
        motion, source = from_lidar(spinning, reporter, max_gap_ns=settings.max_gap_ns or MAX_GAP_NS), spinning.name
    prior_of, sigma, start = prior(reading, origin, fixes)
    motion = with_prior(motion, prior_of)
    recording = FieldRecording(
        name=name,
        folder=reading.source,
        condition=Condition(),
        odometry=motion,
        lidars=lidars,
        cameras=cameras,
        prior=None if isinstance(motion, Pending) else prior_of(motion),
        prior_sigma_m=sigma,
        odometry_lidar=source,
    )
    return recording, start


def camera_names(opened: Opened, asked: Sequence[str]) -> tuple[str, ...]:
    """Names of cameras that were given as names or topics."""
    by_topic = {camera.images: name for name, camera in opened.roles.cameras.items()}
    return tuple(dict.fromkeys(by_topic.get(one) or by_topic.get(f"/{one}") or one for one in asked))


_UPRIGHT = float(np.cos(np.radians(30)))
"""of the angle between the optical axis and the vertical: nearer to it, no camera of a car looks"""


def camera_stream(reading: Reading, camera: CameraTopic) -> CameraStream | None:
    """A camera; None if it cannot be read and nobody asked for it, which is reported."""
    try:
        return _read_camera(reading, camera)
    except (DatasetError, ConfigError) as bad:
        if {camera.name, camera.images} & set(reading.settings.wanted.cameras):
            raise
        reading.note(f"the camera '{camera.name}' is not read: {bad}")
        return None


def _read_camera(reading: Reading, camera: CameraTopic) -> CameraStream:
    """A camera whose images can be read.

    Raises:
        DatasetError: it is not calibrated, or nothing tells its pose on the rig.
    """
    topic, known = camera.images, reading.settings.extrinsics.camera(camera)
    messages, times = reading.messages(topic)
    first, path = read_picture(messages, 0)
    size = first.shape[1], first.shape[0]
    entry, pose = known if known is not None else (None, None)
    if isinstance(entry, CameraEntry):
        if entry.camera.size != size:
            expected = "x".join(map(str, entry.camera.size))
            raise DatasetError(f"{topic} has images of {size[0]}x{size[1]}, expected {expected} (--extrinsics)", path)
        assert pose is not None
        return BagCamera(camera.name, messages, entry.camera, pose, times)
    if not camera.info:
        raise DatasetError(f"{topic} has no CameraInfo; give its intrinsics by --extrinsics", reading.source)
    try:
        found = calibration_of(reading.survey.first(camera.info), size, camera.rectified)
    except ValueError as bad:
        raise DatasetError(f"{camera.info}: {bad}", reading.source) from None
    if pose is None:
        frame = reading.survey.topics[topic].frame
        pose = reading.frames.transform(reading.base, frame)
        if abs(pose[2, 2]) > _UPRIGHT and "optical" not in frame:
            raise DatasetError(
                f"{topic} would look {'up' if pose[2, 2] > 0 else 'down'}: its frame {frame!r} seems to have x "
                "forward, where images need z forward, x right, y down; give the pose of the camera by --extrinsics",
                reading.source,
            )
        pose = pose @ make_transform(found.R_optical_camera, [0.0, 0.0, 0.0])
    return BagCamera(camera.name, messages, found.camera, pose, times)
