"""A bag read as a recording: lidars, cameras, odometry, GNSS, and the poses of sensors on the rig by tf."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from relocbench.datasets.core.schema import Condition
from relocbench.datasets.groundtruth.odometry.deferred import Pending, with_prior
from relocbench.datasets.groundtruth.odometry.lidar_odometry import FromLidar, lidar_odometry
from relocbench.datasets.importers.rosbag.bag import parts_of
from relocbench.datasets.importers.rosbag.cameras import camera_stream
from relocbench.datasets.importers.rosbag.lidars import lidar_stream
from relocbench.datasets.importers.rosbag.motion import GeodeticOrigin
from relocbench.datasets.importers.rosbag.reading import Opened, Reading
from relocbench.datasets.importers.rosbag.roles import TABLE, Roles, Wanted, choose, table
from relocbench.datasets.importers.rosbag.settings import BagSettings
from relocbench.datasets.importers.rosbag.stamps import check_clocks
from relocbench.datasets.importers.rosbag.survey import Survey, survey
from relocbench.datasets.importers.rosbag.tracks import fix_times, odometry, prior
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.errors import DatasetError
from relocbench.progress import Reporter, Silent


def open_bag(source: Path, wanted: Wanted, reporter: Reporter | None = None) -> Opened:
    """Look at a recording and choose its topics; the choice is reported as a table.

    Raises:
        DatasetError: a file is damaged, or it cannot be decided which topic is meant.
        ConfigError: a topic that the user named cannot be used, or rosbags is not installed.
    """
    found = survey(source, parts_of(source))
    roles = choose(found, wanted)
    for line in table_lines(found, roles):
        (reporter or Silent()).note(line)
    return Opened(found, roles)


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
    reporter: Reporter | None = None,
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
    report = reporter or Silent()
    reading = Reading(opened, name, settings, kept, report)
    lidars = tuple(lidar_stream(reading, title, topic) for title, topic in opened.roles.lidars.items())
    cameras = {
        title: stream for title, topic in opened.roles.cameras.items() if (stream := camera_stream(reading, topic))
    }
    motion = odometry(reading)
    fixes = fix_times(reading)
    check_clocks(reading.lags_ns, reading.source)
    source = ""
    if motion is None:
        spinning = next((lidar for lidar in lidars if lidar.pattern == "spinning"), None)
        if spinning is None:
            message = "has neither odometry nor a spinning lidar to compute it from; name a topic by --odometry"
            raise DatasetError(message, reading.source)
        reading.note(f"odometry is computed from the scans of {spinning.messages.topic}")
        motion, source = from_lidar(spinning, report, max_gap_ns=settings.max_gap_ns), spinning.name
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
