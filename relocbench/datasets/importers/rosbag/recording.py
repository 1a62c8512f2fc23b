"""A bag read as a recording: lidars, cameras, odometry, GNSS, and the poses of sensors on the rig by tf."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.core.schema import CameraEntry, Condition
from relocbench.datasets.groundtruth.odometry.lidar_odometry import FromLidar, lidar_odometry
from relocbench.datasets.importers.rosbag import kinds, motion
from relocbench.datasets.importers.rosbag.bag import parts_of
from relocbench.datasets.importers.rosbag.clouds import cloud_fields
from relocbench.datasets.importers.rosbag.frames import BASES, Frames
from relocbench.datasets.importers.rosbag.index import Index, Poses, read_index
from relocbench.datasets.importers.rosbag.motion import GeodeticOrigin
from relocbench.datasets.importers.rosbag.pictures import calibration_of
from relocbench.datasets.importers.rosbag.point_times import FIELDS, PointTimes, detect
from relocbench.datasets.importers.rosbag.roles import TABLE, CameraTopic, Roles, Wanted, choose, table
from relocbench.datasets.importers.rosbag.settings import Extrinsics
from relocbench.datasets.importers.rosbag.stamps import Stamps, check_clocks, times_of
from relocbench.datasets.importers.rosbag.streams import BagCamera, BagLidar, Messages, read_picture
from relocbench.datasets.importers.rosbag.survey import Survey, survey
from relocbench.datasets.sensors.recording import CameraStream, FieldRecording, Trajectory
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import Camera, invert, make_transform
from relocbench.progress import Reporter, Silent

Pattern = Literal["auto", "spinning", "push-broom"]
ScanMotion = Literal["auto", "compensated", "distorted"]

_PRIOR_SIGMA_M = 10.0
_SAMPLES = 5
"""scans from which the times of points and the pattern are told"""
_FLAT = 1e-5
"""a scan is flat if its points leave a plane through the lidar by less than this part of their distance"""
_UPRIGHT = float(np.cos(np.radians(30)))


@dataclass(frozen=True)
class BagSettings:
    """How bags are read, the same for all drives."""

    wanted: Wanted = field(default_factory=Wanted)
    base_frame: str = ""
    extrinsics: Extrinsics = field(default_factory=Extrinsics)
    extrinsics_file: Path | None = None
    point_times: PointTimes | None = None
    """None: they are told from the values"""
    motion: ScanMotion = "auto"
    pattern: Pattern = "auto"
    min_range_m: float = 0.5
    max_range_m: float = 100.0
    sigma_m: float = 0.03
    stamps: Stamps = "header"
    max_gap_ns: int = 1_000_000_000


@dataclass(frozen=True, eq=False)
class Opened:
    """A recording whose topics are chosen."""

    survey: Survey
    roles: Roles


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
    return [
        f"{found.source.name}: {'  '.join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip()}"
        for row in rows
    ]


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
    return _Reading(opened, name, settings, kept, reporter or Silent()).recording(origin, from_lidar)


class _Reading:
    """The work of :func:`read_bag`."""

    def __init__(self, opened: Opened, name: str, settings: BagSettings, kept: Path | None, reporter: Reporter) -> None:
        self.survey, self.roles = opened.survey, opened.roles
        self.name, self.settings, self.reporter = name, settings, reporter
        self.source = self.survey.source
        if settings.extrinsics_file is not None:
            settings.extrinsics.check_used(self.roles, settings.extrinsics_file)
        self.index: Index = read_index(self.survey, self.roles.topics(), kept, reporter)
        self.frames = Frames(self.index.links, self.source)
        self.lags: dict[str, float] = {}
        self.base = self._base_frame()

    def recording(
        self, origin: GeodeticOrigin | None, from_lidar: FromLidar
    ) -> tuple[FieldRecording, GeodeticOrigin | None]:
        lidars = tuple(self._lidar(name, topic) for name, topic in self.roles.lidars.items())
        cameras = {name: stream for name, topic in self.roles.cameras.items() if (stream := self._camera(topic))}
        measured = self._odometry()
        fixes = self._fix_times()
        check_clocks(self.lags, self.source)
        if measured is None:
            spinning = next((lidar for lidar in lidars if lidar.pattern == "spinning"), None)
            if spinning is None:
                raise DatasetError(
                    "has neither odometry nor a spinning lidar to compute it from; name a topic by --odometry",
                    self.source,
                )
            self._note(f"odometry is computed from the scans of {spinning.messages.topic}")
            measured = from_lidar(spinning, self.reporter, max_gap_ns=self.settings.max_gap_ns)
        prior, sigma, found = self._prior(measured, origin, fixes)
        recording = FieldRecording(
            name=self.name,
            folder=self.source,
            condition=Condition(),
            odometry=measured,
            lidars=lidars,
            cameras=cameras,
            prior=prior,
            prior_sigma_m=sigma,
        )
        return recording, found

    def _note(self, text: str) -> None:
        self.reporter.note(f"{self.name}: {text}")

    def _base_frame(self) -> str:
        """The frame that is the rig: as named, else a vehicle's, that of the odometry, or that of the first lidar."""
        first = self.survey.topics[next(iter(self.roles.lidars.values()))].frame
        poses = self.index.poses.get(self.roles.odometry)
        named = self.settings.base_frame.removeprefix("/")
        if named:
            known = {*self.frames.names(), first, poses.child if poses else ""}
            if named not in known:
                there = ", ".join(sorted(known - {""})) or "none"
                raise DatasetError(f"--base-frame: there is no frame {named!r}; there is {there}", self.source)
            return named
        for frame in (*BASES, poses.child if poses else ""):
            if frame and (frame == first or (frame in self.frames and self.frames.connected(frame, first))):
                self._note(f"the rig is the frame '{frame}'")
                return frame
        if self.settings.extrinsics_file is None:
            self._note(f"the rig is the frame of the lidar, '{first}': no frame of a vehicle leads to it")
        return first

    def _times(self, topic: str, stamps: Times, received: Times) -> tuple[Times, Times]:
        what = f"{self.name}: {topic}"
        times, kept, by_header = times_of(stamps, received, what, self.settings.stamps, self.reporter)
        if by_header and len(kept):
            self.lags[topic] = float(np.median(received[kept] - stamps[kept]))
        return times, kept

    def _messages(self, topic: str) -> tuple[Messages, Times]:
        places = self.index.places[topic]
        times, kept = self._times(topic, places.stamps_ns, places.received_ns)
        if len(times) < 2:
            raise DatasetError(
                f"{topic} has {len(times)} messages with a time of their own; expected more", self.source
            )
        files = tuple(part.path for part in self.survey.parts)
        found = (places.part[kept], places.received_ns[kept], places.ordinal[kept])
        return Messages(files, topic, self.survey.topics[topic].type, *found), times

    def _lidar(self, name: str, topic: str) -> BagLidar:
        settings, about = self.settings, self.survey.topics[topic]
        messages, times = self._messages(topic)
        pose = settings.extrinsics.lidar(name, topic)
        if pose is None:
            pose = self.frames.transform(self.base, about.frame)
        farthest = settings.max_range_m
        if about.type == kinds.LASER:
            farthest = min(farthest, float(self.survey.first(topic).range_max))
        plain = BagLidar(
            name, messages, pose, times, "push-broom", PointTimes(), settings.min_range_m, farthest, settings.sigma_m
        )
        if about.type == kinds.LASER:
            self._note(f"{topic}: laser scans, times by time_increment")
            return plain
        samples = np.unique(np.linspace(0, len(times) - 1, _SAMPLES).astype(int)).tolist()
        pattern = settings.pattern
        if pattern == "auto":
            pattern = "push-broom" if self._flat(plain, samples) else "spinning"
        spread = self._point_times(plain, samples, pattern)
        self._note(f"{topic}: {pattern} lidar, times of points: {spread}")
        return BagLidar(name, messages, pose, times, pattern, spread, settings.min_range_m, farthest, settings.sigma_m)

    def _flat(self, lidar: BagLidar, samples: Sequence[int]) -> bool:
        """Whether all points of each scan lie in one plane through the lidar."""
        scans = [points for i in samples if len(points := lidar.read(i).points) >= 10]
        return bool(scans) and all(np.linalg.svd(p, compute_uv=False)[2] < _FLAT * np.linalg.norm(p) for p in scans)

    def _point_times(self, lidar: BagLidar, samples: Sequence[int], pattern: str) -> PointTimes:
        settings, topic = self.settings, lidar.messages.topic
        period = float(np.median(np.diff(lidar.times_ns)))
        if settings.motion == "distorted" and settings.point_times is None:
            found = self._detected(lidar, samples, period)
            if not found.field and pattern != "spinning":
                raise ConfigError(f"--motion distorted: {topic} is no spinning lidar, and its points have no times")
            return found if found.field else PointTimes(turn_ns=round(period))
        if settings.motion == "compensated":
            return PointTimes()
        if settings.point_times is None:
            return self._detected(lidar, samples, period)
        name = settings.point_times.field
        if name and name not in self.survey.topics[topic].fields:
            there = ", ".join(self.survey.topics[topic].fields)
            raise ConfigError(f"--point-time: {topic} has no field {name!r}; it has {there}")
        return settings.point_times

    def _detected(self, lidar: BagLidar, samples: Sequence[int], period: float) -> PointTimes:
        topic = lidar.messages.topic
        name = next((f for f in self.survey.topics[topic].fields if f in FIELDS), None)
        if name is None:
            return PointTimes()
        scans = []
        for i in samples:
            message, part, received = lidar.messages.read(i)
            try:
                fields = cloud_fields(message, ("x", "y", "z", name))
            except ValueError as bad:
                raise part.fault(topic, received, str(bad)) from None
            finite = np.isfinite(np.column_stack([fields[axis] for axis in "xyz"])).all(axis=1)
            scans.append((int(lidar.times_ns[i]), fields[name][finite]))
        try:
            return detect(name, scans, period)
        except ValueError as bad:
            raise DatasetError(
                f"{topic}: {bad}; --point-time tells it (FIELD:UNIT:BASE, or none if scans are motion compensated)",
                self.source,
            ) from None

    def _camera(self, camera: CameraTopic) -> CameraStream | None:
        """A camera; None if it cannot be read and nobody asked for it, which is reported."""
        try:
            return self._read_camera(camera)
        except (DatasetError, ConfigError) as bad:
            if {camera.name, camera.images} & set(self.settings.wanted.cameras):
                raise
            self._note(f"the camera '{camera.name}' is not read: {bad}")
            return None

    def _read_camera(self, camera: CameraTopic) -> CameraStream:
        topic, known = camera.images, self.settings.extrinsics.camera(camera)
        messages, times = self._messages(topic)
        first, path = read_picture(messages, 0)
        size = first.shape[1], first.shape[0]
        entry, pose = known if known is not None else (None, None)
        if isinstance(entry, CameraEntry):
            if entry.camera.size != size:
                told = "x".join(map(str, entry.camera.size))
                raise DatasetError(f"{topic} has images of {size[0]}x{size[1]}, expected {told} (--extrinsics)", path)
            return self._camera_stream(camera.name, messages, entry.camera, pose, times)
        if not camera.info:
            raise DatasetError(f"{topic} has no CameraInfo; --extrinsics can tell its intrinsics", self.source)
        try:
            found = calibration_of(self.survey.first(camera.info), size, camera.rectified)
        except ValueError as bad:
            raise DatasetError(f"{camera.info}: {bad}", self.source) from None
        if pose is None:
            frame = self.survey.topics[topic].frame
            pose = self.frames.transform(self.base, frame)
            if abs(pose[2, 2]) > _UPRIGHT and "optical" not in frame:
                raise DatasetError(
                    f"{topic} would look {'up' if pose[2, 2] > 0 else 'down'}: its frame {frame!r} seems to have x "
                    "forward, where images need z forward, x right, y down; --extrinsics tells the pose of the camera",
                    self.source,
                )
            pose = pose @ make_transform(found.R_optical_camera, [0.0, 0.0, 0.0])
        return self._camera_stream(camera.name, messages, found.camera, pose, times)

    def _camera_stream(
        self, name: str, messages: Messages, camera: Camera, pose: Array | None, times: Times
    ) -> CameraStream:
        assert pose is not None
        return BagCamera(name, messages, camera, pose, times)

    def _odometry(self) -> Trajectory | None:
        """The motion by a topic or by tf; None if it has to be computed from scans."""
        chosen = self.roles.odometry
        if chosen == "lidar":
            return None
        if chosen in self.index.poses:
            found, what = self.index.poses[chosen], chosen
        else:
            link = self._moving_link(required=chosen == "tf")
            if link is None:
                return None
            found, what = link, f"tf, '{link.child}' in '{link.parent}'"
            self._note(f"odometry is that of {what}")
        times, kept = self._times(what, found.times_ns, found.received_ns)
        if len(times) < 2:
            raise DatasetError(f"{what} holds {len(times)} poses; odometry needs at least 2", self.source)
        return motion.odometry(times, found.values[kept], self._T_body_rig(found), self.settings.max_gap_ns)

    def _T_body_rig(self, poses: Poses) -> Array:
        """From the rig to the frame whose poses are given."""
        told = self.settings.extrinsics.T_rig_odometry
        if told is not None:
            return np.asarray(invert(self.settings.extrinsics.T_new_rig @ told.matrix))
        if not poses.child:
            self._note(
                f"the poses in '{poses.parent}' name no frame of the vehicle; they are taken for those of the rig"
            )
            return np.asarray(invert(self.settings.extrinsics.T_new_rig))
        if self.settings.extrinsics_file is not None and poses.child not in self.frames:
            return np.asarray(invert(self.settings.extrinsics.T_new_rig))
        return self.frames.transform(poses.child, self.base)

    def _moving_link(self, required: bool) -> Poses | None:
        """The transform that changes and leads to the rig; that from 'odom' if there are several."""
        there = [link for link in self.frames.moving if self.frames.connected(link.child, self.base)]
        best = [link for link in there if link.parent == "odom"] or there
        if len(best) > 1:
            names = ", ".join(f"{link.parent} to {link.child}" for link in best)
            raise DatasetError(f"tf has several moving transforms ({names}); name a topic by --odometry", self.source)
        if required and not best:
            raise DatasetError(f"--odometry tf: no transform that changes leads to {self.base!r}", self.source)
        return best[0] if best else None

    def _fix_times(self) -> tuple[Times, Times] | None:
        chosen = self.roles.gnss
        found = self.index.fixes.get(chosen) or self.index.poses.get(chosen)
        if not chosen or found is None:
            return None
        return self._times(chosen, found.times_ns, found.received_ns)

    def _prior(
        self, measured: Trajectory, origin: GeodeticOrigin | None, times: tuple[Times, Times] | None
    ) -> tuple[Trajectory | None, float, GeodeticOrigin | None]:
        chosen = self.roles.gnss
        if times is None:
            return None, _PRIOR_SIGMA_M, origin
        at, kept = times
        if chosen in self.index.poses:
            found = self.index.poses[chosen]
            T_map_rig = motion.poses(found.values[kept]) @ self._T_body_rig(found)
            return (Trajectory(at, T_map_rig) if len(at) else None), _PRIOR_SIGMA_M, origin
        fixes = self.index.fixes[chosen]
        if fixes.left_out:
            self._note(f"{chosen}: {fixes.left_out} messages without a fix are left out")
        if not len(at):
            self._note(f"{chosen} has no fix; drives are registered without GNSS")
            return None, _PRIOR_SIGMA_M, origin
        start = origin or GeodeticOrigin.of(fixes)
        if origin is None:
            self._note(f"GNSS positions are relative to {start}")
        enu = motion.east_north_up(fixes.values[kept, :3], start)
        prior = motion.map_of_fixes(at, enu, measured, self._antenna(fixes.frame))
        if prior is None:
            self._note(f"{chosen}: the drive is too short to tell its heading; it is registered without GNSS")
        known = fixes.values[kept, 3]
        sigma = float(np.median(known[known > 0])) if (known > 0).any() else 0.0
        return prior, max(_PRIOR_SIGMA_M, sigma), start

    def _antenna(self, frame: str) -> Array:
        """Position (3,) of the antenna on the rig."""
        told = self.settings.extrinsics.T_rig_gnss
        if told is not None:
            return np.asarray((self.settings.extrinsics.T_new_rig @ told.matrix)[:3, 3])
        if frame and self.frames.connected(self.base, frame):
            return np.asarray(self.frames.transform(self.base, frame)[:3, 3])
        self._note(f"the place of the antenna ('{frame}') on the rig is unknown; it is taken for the rig's origin")
        return np.zeros(3)


def camera_names(opened: Opened, asked: Sequence[str]) -> tuple[str, ...]:
    """Names of cameras that were given as names or topics."""
    by_topic = {camera.images: name for name, camera in opened.roles.cameras.items()}
    return tuple(dict.fromkeys(by_topic.get(one) or by_topic.get(f"/{one}") or one for one in asked))
