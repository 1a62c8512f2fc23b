"""A log of the Ford Multi-AV Seasonal dataset, read as a recording.

Layout and conventions: Agarwal et al., Ford Multi-AV Seasonal Dataset, IJRR 2020; avdata.ford.com, Data; the dataset's
tools, github.com/Ford/AVData (``ford_demo``).

- ``/lidar_{red,green,blue,yellow}_scan`` are VelodyneScan of four HDL-32E; ``/lidar_COLOUR_pointcloud`` are what the
  tools convert them to. The converted clouds have the axes of the ROS driver.
- ``/pose_ground_truth`` (200 Hz, from bundle adjustment), ``/pose_localized`` (20 Hz, by the reflectivity of the
  ground) and ``/pose_raw`` (200 Hz, Applanix POS-LV) are PoseStamped: the body (x forward, y right, z down, origin in
  the middle of the rear axle) in a map with axes north, east, down. ``/tf`` repeats the first; ``/gps``, ``/imu`` and
  ``/velocity_raw`` are not read.
- Images are folders of rectified PNG, named by the times at which the cameras were triggered. ``/image_front_left`` are
  small ones of the front left camera, which are read if there is no folder of it.

The rig is the body with axes x forward, y left, z up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from relocbench.arrays import Array
from relocbench.datasets.core.schema import Transform
from relocbench.datasets.importers.ford_av.axes import TURNS, LidarAxes, axes_by_scans
from relocbench.datasets.importers.ford_av.calibration import (
    FULL_SIZE,
    T_RIG_BODY,
    read_camera_pose,
    read_intrinsics,
    read_lidar_pose,
)
from relocbench.datasets.importers.ford_av.files import CAMERAS, Log
from relocbench.datasets.importers.lidar_drives.conditions import dated
from relocbench.datasets.importers.lidar_drives.drives import DriveFiles, chosen_of, rig_trajectory
from relocbench.datasets.importers.lidar_drives.files import files_by_time, image_size, pinhole_files
from relocbench.datasets.importers.rosbag import kinds, motion
from relocbench.datasets.importers.rosbag.bag import parts_of
from relocbench.datasets.importers.rosbag.extrinsics import Extrinsics, LidarEntry
from relocbench.datasets.importers.rosbag.lidars import lidar_stream
from relocbench.datasets.importers.rosbag.packets import PacketReading
from relocbench.datasets.importers.rosbag.reading import BagSettings, Opened, Reading
from relocbench.datasets.importers.rosbag.recording import table_lines
from relocbench.datasets.importers.rosbag.roles import CameraTopic, Roles
from relocbench.datasets.importers.rosbag.stamps import check_clocks
from relocbench.datasets.importers.rosbag.streams import BagCamera, BagLidar, read_picture
from relocbench.datasets.importers.rosbag.survey import Survey, survey
from relocbench.datasets.importers.rosbag.tracks import tell_left_out
from relocbench.datasets.sensors.point_times import FIELDS
from relocbench.datasets.sensors.pose_tables import PoseTable
from relocbench.datasets.sensors.recording import CameraStream, Trajectory
from relocbench.errors import DatasetError
from relocbench.geometry import Camera, invert
from relocbench.progress import Reporter

OdometrySource = Literal["auto", "ground-truth", "localized", "raw", "lidar"]

COLOURS = ("red", "green", "blue", "yellow")
POSES = {"ground-truth": "/pose_ground_truth", "localized": "/pose_localized", "raw": "/pose_raw"}
THUMBNAILS = "/image_front_left"
_MIN_RANGE_M, _MAX_RANGE_M = 3.0, 100.0
"""the dataset's tools leave out points nearer than 3 m, which are of the car itself"""
_AXES = "--lidar-axes tells: ros (azimuth 0 along x) or velodyne (along y)"
_SIGMA_M = 0.02
"""accuracy of a range by the data sheet of the HDL-32E"""
_PRIOR_SIGMA_M = 3.0
"""positions of GNSS/INS are good to centimetres, with errors of metres where satellites are hidden"""


@dataclass(frozen=True)
class ReadingOptions:
    """How logs are read, the same for all."""

    lidars: tuple[str, ...] = ()
    odometry: OdometrySource = "auto"
    axes: Literal["auto"] | LidarAxes = "auto"
    lidar_intrinsics: Path | None = None


def read_ford(log: Log, how: ReadingOptions, reporter: Reporter, kept: Path | None = None) -> DriveFiles:
    """Read a log; scans and images are opened later, on demand, except for a few scans that are looked at.

    Args:
        reporter: is told the topics, and what was found.
        kept: file in which the index of the bag is kept; None: it is made anew.

    Raises:
        DatasetError: with file, line, topic or time: something needed is missing or damaged.
        ConfigError: the dataset has no such lidar, or the packages that read bags are not installed.
    """
    found = survey(log.bag, parts_of(log.bag))
    roles = _roles(found, log, how)
    for line in table_lines(found, roles):
        reporter.note(line)
    files = {
        topic: log.calibration / f"lidar{topic.split('_')[1].capitalize()}_body.yaml" for topic in roles.lidars.values()
    }
    entries = {topic: LidarEntry(T_rig_lidar=Transform.of(read_lidar_pose(path))) for topic, path in files.items()}
    settings = BagSettings(
        extrinsics=Extrinsics(lidars=entries),
        packets=PacketReading(hdl_32e=True, calibration=how.lidar_intrinsics),
        min_range_m=_MIN_RANGE_M,
        max_range_m=_MAX_RANGE_M,
        sigma_m=_SIGMA_M,
    )
    reading = Reading(Opened(found, roles), log.name, settings, kept, reporter)
    reading.note(f"calibration of the vehicle is {log.calibration}")
    lidars = tuple(lidar_stream(reading, name, topic) for name, topic in roles.lidars.items())
    poses = _poses(reading, log)
    cameras = _cameras(reading, log)
    check_clocks(reading.lags_ns, log.bag)
    return DriveFiles(
        name=log.name,
        folder=log.bag,
        condition=dated(log.month, log.bag.parent),
        lidars=_turned(lidars, poses, how, reading),
        cameras=cameras,
        poses=None if how.odometry == "lidar" else poses,
        poses_from=roles.odometry,
        prior=poses,
        prior_sigma_m=_PRIOR_SIGMA_M,
    )


def _roles(found: Survey, log: Log, how: ReadingOptions) -> Roles:
    """The topics that are read, with reasons."""
    roles = Roles()
    for colour in chosen_of(how.lidars or None, COLOURS, COLOURS, "Ford AV has no lidar"):
        names = (f"/lidar_{colour}_scan", f"/lidar_{colour}_pointcloud")
        topics = [t for t in found.of_types((kinds.PACKETS, kinds.CLOUD)) if t.name in names]
        if not topics and colour in how.lidars:
            raise DatasetError(f"has no {' or '.join(names)} that can be read (--lidars {colour})", log.bag)
        for topic in topics[-1:]:  # packets, if there are both
            if topic.type == kinds.CLOUD and not set(FIELDS) & set(topic.fields):
                message = "holds clouds without times of points, which the motion of the car distorts"
                raise DatasetError(
                    f"{topic.name} {message}; expected packets ({names[0]}), or times in the clouds", log.bag
                )
            roles.lidars[f"lidar_{colour}"] = topic.name
            roles.why[topic.name] = ("lidar", "a lidar of the dataset")
    if not roles.lidars:
        available = ", ".join(found.topics) or "none"
        raise DatasetError(
            f"has no scans of its lidars; expected /lidar_red_scan or the like, found {available}", log.bag
        )
    wanted = ("ground-truth", "raw") if how.odometry in ("auto", "lidar") else (how.odometry,)
    poses = {POSES[w]: found.topics[POSES[w]] for w in wanted if POSES[w] in found.topics}
    usable = [name for name, topic in poses.items() if topic.type == kinds.POSE and topic.count and not topic.fault]
    if not usable and how.odometry not in ("auto", "lidar"):
        raise DatasetError(f"has no poses {POSES[how.odometry]} (--odometry {how.odometry})", log.bag)
    if usable:
        roles.odometry = usable[0]
        role = "position" if how.odometry == "lidar" else "odometry"
        roles.why[usable[0]] = (role, "poses of the dataset")
    images = found.topics.get(THUMBNAILS)
    if "front_left" not in log.images and images is not None and images.type in kinds.CAMERAS and images.count:
        roles.cameras["front_left"] = CameraTopic("front_left", THUMBNAILS, "")
        roles.why[THUMBNAILS] = ("camera", "no folder of images of the front left camera")
    for topic in found.of_types(kinds.ALL_TRANSFORMS):
        roles.why[topic.name] = ("-", "repeats the poses")
    return roles


def _poses(reading: Reading, log: Log) -> Trajectory | None:
    """``T_map_rig`` in a map with axes north, west, up; None without poses."""
    topic = reading.roles.odometry
    if not topic:
        return None
    found = reading.index.poses[topic]
    tell_left_out(reading, topic, found)
    times, kept = reading.times(topic, found.times_ns, found.received_ns)
    T_ned_body = motion.poses(found.values[kept])
    # The map is turned like the body: from north, east, down to north, west, up.
    return rig_trajectory(PoseTable(log.bag, times, T_RIG_BODY @ T_ned_body), reading.reporter, invert(T_RIG_BODY))


def _turned(
    lidars: tuple[BagLidar, ...], poses: Trajectory | None, how: ReadingOptions, reading: Reading
) -> tuple[BagLidar, ...]:
    """The lidars under the axes that the calibration means."""
    axes: LidarAxes
    if how.axes != "auto":
        axes, evidence = how.axes, "as --lidar-axes says"
    else:
        by_scans, shares = (None, {}) if poses is None else axes_by_scans(lidars, poses)
        agreed = ", ".join(f"{100 * share:.0f} % under {name}" for name, share in shares.items())
        if by_scans is None:
            why = f"scans do not tell ({agreed})" if agreed else "there are no poses by which scans could tell"
            raise DatasetError(f"{why} which axes of the lidars the calibration means; {_AXES}", reading.source)
        axes, evidence = by_scans, f"told by scans, of which agree {agreed}"
    reading.note(f"azimuth 0 of the lidars is along {'x' if axes == 'ros' else 'y'} ({axes}): {evidence}")
    return tuple(replace(lidar, T_rig_lidar=lidar.T_rig_lidar @ TURNS[axes]) for lidar in lidars)


def _cameras(reading: Reading, log: Log) -> dict[str, CameraStream]:
    """The cameras whose images are there; those without calibration are noted."""
    out: dict[str, CameraStream] = {}
    for name, folder in log.images.items():
        images = files_by_time(folder, (".png",), dates_only=True)
        calibrated = _calibration(reading, log, name)
        if calibrated is not None:
            path, intrinsics, size, T_rig_cam = calibrated
            seen = image_size(images[0][0])
            if size is not None and size != seen:
                message = f"images are {seen[0]}x{seen[1]}, the calibration {path.name} is of {size[0]}x{size[1]}"
                raise DatasetError(message, images[0][0])
            out[name] = pinhole_files(name, images, intrinsics, T_rig_cam, path)
    for name, camera in reading.roles.cameras.items():
        calibrated = _calibration(reading, log, name)
        if calibrated is not None:
            path, intrinsics, size, T_rig_cam = calibrated
            messages, times = reading.messages(camera.images)
            first, _ = read_picture(messages, 0)
            small = _smaller(intrinsics, size or FULL_SIZE, (first.shape[1], first.shape[0]))
            if small is None:
                message = (
                    f"of {first.shape[1]}x{first.shape[0]} are not smaller copies of images of {size or FULL_SIZE}"
                )
                reading.note(f"{camera.images} is not read: images {message}")
                continue
            reading.note(f"{camera.images} holds images of {small.width}x{small.height}: smaller than the camera's")
            out[name] = BagCamera(name, messages, small, T_rig_cam, times)
    return out


def _calibration(
    reading: Reading, log: Log, camera: str
) -> tuple[Path, tuple[float, float, float, float], tuple[int, int] | None, Array] | None:
    """File of the intrinsics, these, the size of images if it is told, and ``T_rig_cam``."""
    beginning = CAMERAS[camera][1]
    path, pose = (log.calibration / f"{beginning}{ending}.yaml" for ending in ("Intrinsics", "_body"))
    missing = [p.name for p in (path, pose) if not p.exists()]
    if missing:
        reading.note(f"the camera '{camera}' is not read: {log.calibration} has no {' and no '.join(missing)}")
        return None
    return path, *read_intrinsics(path), read_camera_pose(pose)


def _smaller(
    intrinsics: tuple[float, float, float, float], full: tuple[int, int], size: tuple[int, int]
) -> Camera | None:
    """The camera of images that were made smaller; None if they have other proportions."""
    if abs(full[1] * size[0] / full[0] - size[1]) > 1.0:
        return None
    x, y = size[0] / full[0], size[1] / full[1]
    fx, fy, cx, cy = intrinsics
    return Camera("pinhole", *size, fx * x, fy * y, (cx + 0.5) * x - 0.5, (cy + 0.5) * y - 0.5)
