"""The one pass over a recording: where each scan and image lies, and all poses, fixes and transforms.

The result is kept in a file beside the dataset, so that a build that continues does not read the bag again.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.core.npy import parse_npz
from relocbench.datasets.importers.rosbag import kinds
from relocbench.datasets.importers.rosbag.bag import Part, frame_name, header_of, stamp_ns
from relocbench.datasets.importers.rosbag.survey import Survey
from relocbench.errors import DatasetError
from relocbench.files import read_bytes, write_bytes
from relocbench.progress import Reporter

_FORMAT = 3
_FARTHEST_M = 1e8
"""positions farther from the origin of their frame are none; those on the earth have at most seven digits"""
_REPORTED = 200
"""messages between two steps of the progress bar"""


@dataclass(frozen=True, eq=False)
class MessageLocations:
    """Where the messages of a topic lie, in the order of the files."""

    stamps_ns: Times
    """(N,) stamps of the headers"""
    received_ns: Times
    """(N,) times of receipt"""
    part: Times
    """(N,) number of the file"""
    ordinal: Times
    """(N,) number among the messages of the topic that were received at the same time"""


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of one frame in another."""

    parent: str
    child: str
    times_ns: Times
    """(N,) stamps"""
    received_ns: Times
    """(N,)"""
    values: Array
    """(N, 7) tx, ty, tz, qx, qy, qz, qw"""
    static: bool = False
    left_out: int = 0
    """messages whose pose is not finite"""


@dataclass(frozen=True, eq=False)
class Fixes:
    """Positions by GNSS with a valid status."""

    times_ns: Times
    received_ns: Times
    values: Array
    """(N, 4) latitude and longitude in degrees, altitude and horizontal sigma (0: unknown) in metres, WGS 84"""
    frame: str
    left_out: int


@dataclass(eq=False)
class Index:
    """What one pass over a recording found."""

    places: dict[str, MessageLocations] = field(default_factory=dict)
    poses: dict[str, Poses] = field(default_factory=dict)
    """topic -> poses"""
    links: list[Poses] = field(default_factory=list)
    """transforms between frames"""
    fixes: dict[str, Fixes] = field(default_factory=dict)


def read_index(found: Survey, topics: Sequence[str], kept: Path | None, reporter: Reporter) -> Index:
    """Read the index from ``kept``, or make it and keep it there.

    Args:
        topics: topics of lidars, cameras, odometry and GNSS; transforms are always read.
        kept: None: it is not kept.

    Raises:
        DatasetError: with file, topic and time: a message is damaged.
    """
    topics = tuple(dict.fromkeys(topics))
    mark = _mark(found, topics)
    if kept is not None and kept.exists():
        known = _load(kept, mark)
        if known is not None:
            return known
    made = _scan(found, topics, reporter)
    if kept is not None:
        _save(kept, made, mark)
    return made


def _mark(found: Survey, topics: Sequence[str]) -> dict[str, Any]:
    """What an index was made from: the files, by name, size and time, and the topics."""
    files = [p for part in found.parts for p in (sorted(part.path.iterdir()) if part.path.is_dir() else [part.path])]
    marks = [[p.name, p.stat().st_size, p.stat().st_mtime_ns] for p in files]
    return {"format": _FORMAT, "files": marks, "topics": sorted(topics)}


class _Rows:
    """Values of messages that are collected one by one."""

    def __init__(self) -> None:
        self.times: list[tuple[int, int, int, int]] = []
        """stamp, receipt, part, ordinal"""
        self.values: list[tuple[float, ...]] = []
        self.names = ("", "")
        self.left_out = 0

    def column(self, number: int) -> Times:
        return np.array([row[number] for row in self.times], dtype=np.int64)

    def matrix(self, width: int) -> Array:
        return np.array(self.values, dtype=np.float64).reshape(-1, width)


def _scan(found: Survey, topics: Sequence[str], reporter: Reporter) -> Index:
    types = {name: found.topics[name].type for name in topics}
    moving = [t.name for t in found.of_types(kinds.ALL_TRANSFORMS)]
    everything = [*topics, *moving]
    for part in found.parts:
        for name in everything:
            if name in part.types:
                part.check_standard(name)
    rows: dict[str, _Rows] = {name: _Rows() for name in topics}
    links: dict[tuple[str, str], _Rows] = {}
    static: set[tuple[str, str]] = set()
    total = sum(part.counts.get(name, 0) for part in found.parts for name in everything)
    with reporter.stage(f"reading {found.source.name}", total) as advance:
        for number, part in enumerate(found.parts):
            last: dict[str, tuple[int, int]] = {}
            for k, (topic, received_ns, raw) in enumerate(part.messages(everything)):
                if topic in rows:
                    before, ordinal = last.get(topic, (-1, -1))
                    last[topic] = (received_ns, ordinal + 1 if received_ns == before else 0)
                    _take(rows[topic], types[topic], part, topic, raw, (received_ns, number, last[topic][1]))
                else:
                    _take_links(links, static, part, topic, raw, received_ns)
                if k % _REPORTED == _REPORTED - 1:
                    advance(_REPORTED)
    return _index(types, rows, links, static)


def _take(rows: _Rows, kind: str, part: Part, topic: str, raw: bytes, place: tuple[int, int, int]) -> None:
    """Take what a message of a topic other than transforms says."""
    received_ns = place[0]
    if kind in (*kinds.LIDARS, *kinds.CAMERAS):
        try:
            stamp, frame = header_of(raw, part.is_ros1(topic))
        except ValueError as bad:
            raise part.fault(topic, received_ns, str(bad)) from None
        if rows.times and rows.names[0] != frame:
            message = (
                f"is of the frame {frame!r}, and those before are of {rows.names[0]!r}: of two publishers or runs?"
            )
            raise part.fault(topic, received_ns, message)
        rows.names = (frame, "")
        rows.times.append((stamp, *place))
        return
    message = part.decode(topic, raw, received_ns)
    stamp = stamp_ns(message.header.stamp)
    if kind == kinds.FIX:
        values = (float(message.latitude), float(message.longitude), float(message.altitude))
        if int(message.status.status) < 0 or not np.isfinite(values[:2]).all():
            rows.left_out += 1
            return
        height = values[2] if np.isfinite(values[2]) else 0.0
        rows.values.append((*values[:2], height, _horizontal_sigma(message)))
        rows.names = (frame_name(str(message.header.frame_id)), "")
    else:
        parent, child, pose = _pose(kind, message)
        names = (frame_name(parent), frame_name(child))
        if rows.times and rows.names != names:
            raise part.fault(
                topic,
                received_ns,
                f"is the pose of {names[1]!r} in {names[0]!r}, and those before are of {rows.names[1]!r} in "
                f"{rows.names[0]!r}",
            )
        rows.names = names
        if not np.isfinite(pose).all():
            rows.left_out += 1
            return
        rows.values.append(_checked(pose, part, topic, received_ns))
    rows.times.append((stamp, *place))


def _take_links(
    links: dict[tuple[str, str], _Rows],
    static: set[tuple[str, str]],
    part: Part,
    topic: str,
    raw: bytes,
    received_ns: int,
) -> None:
    for transform in part.decode(topic, raw, received_ns).transforms:
        names = frame_name(str(transform.header.frame_id)), frame_name(str(transform.child_frame_id))
        rows = links.setdefault(names, _Rows())
        if topic.endswith("tf_static"):
            static.add(names)
        values = _seven(transform.transform.translation, transform.transform.rotation)
        if not np.isfinite(values).all():
            rows.left_out += 1
            continue
        rows.values.append(_checked(values, part, topic, received_ns))
        rows.times.append((stamp_ns(transform.header.stamp), received_ns, 0, 0))


def _pose(kind: str, message: Any) -> tuple[str, str, tuple[float, ...]]:
    parent = str(message.header.frame_id)
    if kind == kinds.TRANSFORM:
        return parent, str(message.child_frame_id), _seven(message.transform.translation, message.transform.rotation)
    child = str(message.child_frame_id) if kind == kinds.ODOMETRY else ""
    pose = message.pose if kind == kinds.POSE else message.pose.pose
    return parent, child, _seven(pose.position, pose.orientation)


def _seven(t: Any, q: Any) -> tuple[float, ...]:
    return t.x, t.y, t.z, q.x, q.y, q.z, q.w


def _checked(values: tuple[float, ...], part: Part, topic: str, received_ns: int) -> tuple[float, ...]:
    numbers = tuple(map(float, values))
    with np.errstate(over="ignore", invalid="ignore"):
        norm = float(np.linalg.norm(numbers[3:]))
    if not np.isfinite(numbers).all() or not abs(norm - 1.0) <= 1e-2 or max(map(abs, numbers[:3])) > _FARTHEST_M:
        message = f"is no pose: {', '.join(f'{v:g}' for v in numbers)} (x, y, z, qx, qy, qz, qw)"
        raise part.fault(topic, received_ns, message)
    return numbers


def _horizontal_sigma(message: Any) -> float:
    if int(message.position_covariance_type) == 0:
        return 0.0
    variance = float(message.position_covariance[0]) + float(message.position_covariance[4])
    return float(np.sqrt(variance / 2)) if np.isfinite(variance) and variance > 0 else 0.0


def _index(
    types: dict[str, str],
    rows: dict[str, _Rows],
    links: dict[tuple[str, str], _Rows],
    static: set[tuple[str, str]],
) -> Index:
    out = Index()
    for topic, found in rows.items():
        stamps, received = found.column(0), found.column(1)
        if types[topic] == kinds.FIX:
            out.fixes[topic] = Fixes(stamps, received, found.matrix(4), found.names[0], found.left_out)
        elif types[topic] in kinds.POSES:
            out.poses[topic] = Poses(*found.names, stamps, received, found.matrix(7), left_out=found.left_out)
        else:
            out.places[topic] = MessageLocations(stamps, received, found.column(2), found.column(3))
    for names, found in links.items():
        poses = Poses(*names, found.column(0), found.column(1), found.matrix(7), names in static, found.left_out)
        out.links.append(poses)
    return out


_KINDS = {"places": MessageLocations, "poses": Poses, "links": Poses, "fixes": Fixes}


def _save(path: Path, index: Index, mark: dict[str, Any]) -> None:
    named: dict[str, dict[str, Any]] = {"places": index.places, "poses": index.poses, "fixes": index.fixes}
    entries = [(kind, topic, one) for kind, found in named.items() for topic, one in found.items()]
    arrays: dict[str, Any] = {}
    about: dict[str, Any] = {"mark": mark, "entries": []}
    for number, (kind, topic, one) in enumerate([*entries, *(("links", "", link) for link in index.links)]):
        of_arrays = {name: value for name, value in vars(one).items() if isinstance(value, np.ndarray)}
        arrays |= {f"{name}_{number}": value for name, value in of_arrays.items()}
        plain = {name: value for name, value in vars(one).items() if name not in of_arrays}
        about["entries"].append([kind, topic, list(of_arrays), plain])
    about["arrays"] = list(arrays)
    text = np.frombuffer(json.dumps(about, sort_keys=True).encode(), dtype=np.uint8)
    stream = io.BytesIO()
    np.savez(stream, about=text, **arrays)
    write_bytes(path, stream.getvalue())


def _load(path: Path, mark: dict[str, Any]) -> Index | None:
    """The index in a file; None if it was made from something else or is damaged."""
    try:
        data = read_bytes(path, "an index", DatasetError)
        about = json.loads(parse_npz(data, ("about",), path)["about"].tobytes().decode())
        if about["mark"] != mark:
            return None
        arrays = parse_npz(data, about["arrays"], path)
        out = Index()
        for number, (kind, topic, names, plain) in enumerate(about["entries"]):
            one: Any = _KINDS[kind](**plain, **{name: arrays[f"{name}_{number}"] for name in names})
            if kind == "links":
                out.links.append(one)
            else:
                getattr(out, kind)[topic] = one
    except (DatasetError, KeyError, ValueError, TypeError, IndexError):
        return None
    return out
