"""Which topics are the lidars, the cameras, the odometry and the GNSS of a recording, by name or by guess.

Each choice has a reason in words, which is shown before any work starts. Where a guess would be a gamble, the error
names the option that decides.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from relocbench.datasets.importers.rosbag import kinds
from relocbench.datasets.importers.rosbag.survey import Survey, Topic
from relocbench.datasets.sensors.point_times import FIELDS
from relocbench.errors import ConfigError, DatasetError
from relocbench.files import check_distinct, plain_name

_MAPS = ("map", "utm", "earth")
_WORLDS = (*_MAPS, "odom", "world")
_DEPTHS = ("16UC1", "32FC1", "compressedDepth")
_LEAST_HZ = 1.0
"""poses and scans come more often than this; a goal or a map does not"""
_MOST_REASONS = 6
"""topics whose reasons are told"""
_LIDAR_ENDINGS = ("points", "points_raw", "points2", "pointcloud", "point_cloud", "scan", "packets", "velodyne_packets")
_BEST_IMAGES = ("rect_color", "rect", "color", "raw")


@dataclass(frozen=True)
class Wanted:
    """Topics that the user named."""

    lidars: tuple[str, ...] = ()
    cameras: tuple[str, ...] = ()
    """topics, or names of cameras"""
    odometry: str = ""
    """a topic, ``tf`` or ``lidar``"""
    gnss: str = ""
    """a topic or ``none``"""


@dataclass(frozen=True)
class CameraTopic:
    """A camera: the topic of its images, and that of its calibration."""

    name: str
    images: str
    info: str
    """empty: there is none"""

    @property
    def rectified(self) -> bool:
        """Whether images are rectified, by the name of the topic that image_proc gives them."""
        return "rect" in self.images.removesuffix("/compressed").rsplit("/", 1)[-1]


@dataclass
class Roles:
    """What each topic is used for."""

    lidars: dict[str, str] = field(default_factory=dict)
    """name of each lidar and its topic"""
    cameras: dict[str, CameraTopic] = field(default_factory=dict)
    odometry: str = ""
    """a topic, ``tf``, or ``lidar`` for odometry from scans"""
    gnss: str = ""
    why: dict[str, tuple[str, str]] = field(default_factory=dict)
    """topic -> role and reason"""

    def topics(self) -> tuple[str, ...]:
        """The topics whose messages are read, besides those of transforms."""
        motion = [name for name in (self.odometry, self.gnss) if name.startswith("/") or name in self.why]
        return (*self.lidars.values(), *(camera.images for camera in self.cameras.values()), *motion)


TABLE = ("topic", "type", "messages", "rate, Hz", "role", "why")


def table(found: Survey, roles: Roles) -> list[list[str]]:
    """A row for each topic, in the columns of :data:`TABLE`; topics with a role come first."""
    order = {"lidar": 0, "camera": 1, "calibration": 2, "odometry": 3, "GNSS": 4, "transforms": 5}
    rows = []
    for topic in found.topics.values():
        role, why = roles.why.get(topic.name, ("-", _why_unused(topic)))
        rows.append([topic.name, kinds.short(topic.type), str(topic.count), f"{topic.rate_hz:.1f}", role, why])
    return sorted(rows, key=lambda row: (order.get(row[4], 9), row[0]))


def _why_unused(topic: Topic) -> str:
    if not topic.count:
        return "has no message"
    if topic.type in kinds.UNREADABLE:
        return kinds.UNREADABLE[topic.type]
    if topic.fault:
        return f"cannot be read: {topic.fault}"
    return "not needed" if topic.type in kinds.READ else "no sensor that is read"


def choose(found: Survey, wanted: Wanted) -> Roles:
    """Choose the topics of a recording.

    Raises:
        ConfigError: a topic that the user named does not exist or cannot have this role.
        DatasetError: there is no lidar, or it cannot be decided which of several topics is meant.
    """
    roles = Roles()
    for step in _STEPS:
        step(found, wanted, roles)
    return roles


def tried(found: Survey) -> tuple[Roles, str]:
    """The roles that can be guessed, and in words what cannot be decided; empty if all can."""
    roles = Roles()
    undecided: list[str] = []
    for step in _STEPS:
        try:
            step(found, Wanted(), roles)
        except DatasetError as bad:
            undecided.append(bad.expected)
    return roles, "; ".join(undecided)


def _named(found: Survey, name: str, types: Sequence[str], option: str) -> Topic:
    topic = found.topics.get(name) or found.topics.get(f"/{name}")
    allowed = ", ".join(kinds.short(kind) for kind in types)
    if topic is None:
        available = ", ".join(t.name for t in found.of_types(types)) or "none"
        raise ConfigError(f"{option}: no topic {name!r} in {found.source.name}; of {allowed} available: {available}")
    if topic.type in kinds.UNREADABLE:
        message = f"{kinds.short(topic.type)} cannot be read: {kinds.UNREADABLE[topic.type]}"
        raise ConfigError(f"{option}: {topic.name} of {found.source.name}: {message}")
    if topic.type not in types:
        raise ConfigError(f"{option}: {topic.name} has {kinds.short(topic.type)}; expected {allowed}")
    if not topic.count:
        raise DatasetError(f"{option}: {topic.name} has no message", found.source)
    if topic.fault:
        raise DatasetError(f"{option}: {topic.fault}", found.source)
    return topic


def _transforms(found: Survey, wanted: Wanted, roles: Roles) -> None:
    for topic in found.of_types(kinds.ALL_TRANSFORMS):
        roles.why[topic.name] = ("transforms", "its type")


def _odometry(found: Survey, wanted: Wanted, roles: Roles) -> None:
    name = wanted.odometry
    if name in ("", "lidar", "tf"):
        roles.odometry = name or _guessed_odometry(found, wanted, roles)
        return
    topic = _named(found, name, kinds.POSES, "--odometry")
    roles.why[topic.name] = ("odometry", "named by --odometry")
    roles.odometry = topic.name


def _guessed_odometry(found: Survey, wanted: Wanted, roles: Roles) -> str:
    """The only topic with odometry, or else with poses; poses in a map jump (REP 105) and are not guessed."""
    for types, what in (((kinds.ODOMETRY,), "odometry"), (kinds.POSES[1:], "poses")):
        gnss = {wanted.gnss, f"/{wanted.gnss}"}
        available = [t for t in found.of_types(types) if t.rate_hz >= _LEAST_HZ and t.name not in gnss]
        on_map = [t for t in available if t.frame in _MAPS]
        if len(available) > 1 or what == "poses":
            roles.why |= {t.name: ("-", f"poses in the frame '{t.frame}' may jump") for t in on_map}
            available = [t for t in available if t not in on_map]
        if len(available) > 1:
            names = ", ".join(t.name for t in available)
            raise DatasetError(f"has several topics with {what} ({names}); name one by --odometry", found.source)
        if available:
            roles.why[available[0].name] = ("odometry", f"the only topic with {what}")
            return available[0].name
    return ""


def _lidars(found: Survey, wanted: Wanted, roles: Roles) -> None:
    names = wanted.lidars
    if names:
        chosen = [_named(found, name, kinds.LIDARS, "--lidars") for name in dict.fromkeys(names)]
        why = dict.fromkeys((t.name for t in chosen), "named by --lidars")
    else:
        chosen, why = _guessed_lidars(found, roles)
    for topic in chosen:
        name = _sensor_name(topic.name, _LIDAR_ENDINGS)
        if name in roles.lidars:
            name = _sensor_name(topic.name, ())
        roles.lidars[name] = topic.name
        roles.why[topic.name] = ("lidar", why[topic.name])
    _check_names(roles.lidars, "lidars", found.source)


def _guessed_lidars(found: Survey, roles: Roles) -> tuple[list[Topic], dict[str, str]]:
    """The clouds, one topic for each frame; packets, and else laser scans, if there is no cloud."""
    odometry = found.topics.get(roles.odometry)
    worlds = {*_WORLDS, odometry.frame if odometry else "map"}
    clouds = [t for t in found.of_types((kinds.CLOUD,)) if {"x", "y", "z"} <= set(t.fields) and t.rate_hz >= _LEAST_HZ]
    packets = [t for t in found.of_types((kinds.PACKETS,)) if t.rate_hz >= _LEAST_HZ]
    scans = [t for t in found.of_types((kinds.LASER,)) if t.rate_hz >= _LEAST_HZ]
    for topic in clouds:
        if topic.frame in worlds:
            roles.why[topic.name] = ("-", f"is in the frame {topic.frame}, not in that of a sensor")
    candidates = [t for t in clouds if t.frame not in worlds]
    what = "clouds"
    for others, called in ((packets, "packets"), (scans, "laser scans")):
        if candidates:
            roles.why |= {t.name: ("-", f"there are {what}") for t in others}
        else:
            candidates, what = others, called
    if not candidates:
        raise DatasetError(f"has no lidar that can be read ({_why_no_lidar(found, roles)})", found.source)
    chosen, why = [], {}
    for frame in dict.fromkeys(t.frame for t in candidates):
        same = [t for t in candidates if t.frame == frame]
        timed = [t for t in same if set(t.fields) & set(FIELDS)] or same
        if len(timed) > 1:
            names = ", ".join(t.name for t in timed)
            raise DatasetError(
                f"has several topics of {what} in the frame {frame!r} ({names}); name one by --lidars", found.source
            )
        chosen += timed
        reason = "with times of points" if len(same) > 1 else "the only one"
        why[timed[0].name] = f"{what} of the frame {frame!r}: {reason}"
        roles.why |= {t.name: ("-", f"same frame as {timed[0].name}, without times") for t in same if t not in timed}
    return chosen, why


def _why_no_lidar(found: Survey, roles: Roles) -> str:
    """Why each topic that might be a lidar is none."""
    reasons = []
    for topic in found.topics.values():
        if topic.type in kinds.UNREADABLE and topic.count:
            reasons.append(f"{topic.name}: {kinds.UNREADABLE[topic.type]}")
        elif topic.type in kinds.LIDARS:
            reasons.append(topic.fault or f"{topic.name}: {_why_no_scans(topic, roles)}")
    expected = "expected PointCloud2, VelodyneScan or LaserScan of a sensor, at least one a second"
    return "; ".join(reasons[:_MOST_REASONS]) or expected


def _why_no_scans(topic: Topic, roles: Roles) -> str:
    if not topic.count:
        return _why_unused(topic)
    if topic.name in roles.why:
        return roles.why[topic.name][1]
    if topic.type == kinds.CLOUD and not {"x", "y", "z"} <= set(topic.fields):
        return f"has the fields {', '.join(topic.fields) or 'none'}, expected x, y, z among them"
    return f"has {topic.rate_hz:.2g} messages a second, expected at least {_LEAST_HZ:g}; --lidars names it all the same"


def _cameras(found: Survey, wanted: Wanted, roles: Roles) -> None:
    names = wanted.cameras
    groups: dict[str, list[Topic]] = {}
    for topic in found.of_types(kinds.CAMERAS):
        if any(word in topic.encoding for word in _DEPTHS) or topic.name.endswith("compressedDepth"):
            roles.why[topic.name] = ("-", f"depth ({topic.encoding})")
        elif topic.rate_hz < _LEAST_HZ / 10:
            roles.why[topic.name] = ("-", "too few images")
        else:
            groups.setdefault(_namespace(topic.name), []).append(topic)
    for group in groups.values():
        group.sort(key=_image_rank)
        named = next((t for t in group if t.name in names or t.name.lstrip("/") in names), None)
        best = named or group[0]
        info = _info_of(found, best)
        name = _sensor_name(best.name.removesuffix("/compressed"), ("image", *(f"image_{w}" for w in _BEST_IMAGES)))
        if name in roles.cameras:
            name = _sensor_name(best.name.removesuffix("/compressed"), ())
        roles.cameras[name] = CameraTopic(name, best.name, info)
        others = {t.name: ("-", f"same camera as {best.name}") for t in group if t is not best}
        reason = "named by --cameras" if named else f"images of the camera '{name}'"
        roles.why |= {best.name: ("camera", reason), **others}
        if info:
            roles.why[info] = ("calibration", f"of {best.name}")
    known = {name for camera in roles.cameras.values() for name in (camera.name, camera.images)}
    for name in names:
        if name not in known and f"/{name}" not in known:
            _named(found, name, kinds.CAMERAS, "--cameras")
            raise ConfigError(f"--cameras: {name} of {found.source.name} has no images of a camera")
    _check_names(roles.cameras, "cameras", found.source)


def _image_rank(topic: Topic) -> tuple[int, bool, str]:
    """Rectified before raw, colour before grey, stored without loss before compressed."""
    last = topic.name.removesuffix("/compressed").rsplit("/", 1)[-1]
    found = [i for i, word in enumerate(_BEST_IMAGES) if last.endswith(word)]
    return min(found, default=len(_BEST_IMAGES)), topic.type == kinds.COMPRESSED, topic.name


def _namespace(topic: str) -> str:
    """The namespace of a camera; an image topic that stands alone is its own."""
    plain = topic.removesuffix("/compressed")
    above, _, last = plain.rpartition("/")
    return above if above and last.startswith("image") else plain


def _info_of(found: Survey, images: Topic) -> str:
    plain = images.name.removesuffix("/compressed")
    for name in (f"{plain.rpartition('/')[0]}/camera_info", f"{plain}/camera_info"):
        if name in found.topics and found.topics[name].type == kinds.CAMERA_INFO and found.topics[name].count:
            return name
    candidates = found.of_types((kinds.CAMERA_INFO,))
    same = [t for t in candidates if t.frame == images.frame] or candidates
    alone = len(same) == 1 and (same[0].frame == images.frame or len(found.of_types(kinds.CAMERAS)) == 1)
    return same[0].name if alone else ""


def _gnss(found: Survey, wanted: Wanted, roles: Roles) -> None:
    if wanted.gnss == "none":
        return
    if wanted.gnss:
        topic = _named(found, wanted.gnss, (kinds.FIX, *kinds.POSES), "--gnss")
        roles.gnss, roles.why[topic.name] = topic.name, ("GNSS", "named by --gnss")
        return
    available = sorted(found.of_types((kinds.FIX,)), key=lambda t: (-t.count, t.name))
    if available:
        roles.gnss = available[0].name
        roles.why[roles.gnss] = ("GNSS", "the only fixes" if len(available) == 1 else "most fixes")


_STEPS = (_transforms, _odometry, _lidars, _cameras, _gnss)


def _sensor_name(topic: str, endings: Sequence[str]) -> str:
    """A name that a file may have: ``/stereo/left/image_raw`` is ``stereo_left``."""
    words = [word for word in topic.split("/") if word]
    if len(words) > 1 and words[-1] in endings:
        words = words[:-1]
    try:
        return plain_name("_".join(words) or "sensor", "sensor name")
    except ValueError as bad:
        raise DatasetError(f"the topic {topic} cannot name a sensor: {bad}") from None


def _check_names(names: Iterable[str], what: str, source: Path) -> None:
    try:
        check_distinct(list(names), what)
    except ValueError as bad:
        raise DatasetError(str(bad), source) from None
