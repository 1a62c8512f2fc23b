"""The files of a recording and the messages in them, read with the package rosbags, or mcap.

A recording is a bag of ROS 1 (``.bag``), a bag of ROS 2 (a folder with ``metadata.yaml``), a single ``.mcap`` or
``.db3`` file, or a folder of such files, into which one drive was split. Nothing is copied or written.

``rosbags.highlevel.AnyReader`` is not used. It finds the same messages at the same times, but it reads no MCAP file of
another profile than that of ROS 2, refuses a whole bag for one type that it cannot parse or whose checksum differs,
needed or not, and does not say in which file a fault is. As it finds no single message either, index and cursors would
stay; without cursors, reading all scans and images one by one takes several times as long.
"""

from __future__ import annotations

import struct
import weakref
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from relocbench.datasets.importers.rosbag import kinds
from relocbench.datasets.importers.rosbag.definitions import difference, standard_name, typestore
from relocbench.datasets.importers.rosbag.file_order import check_order, index_place, open_without_index
from relocbench.datasets.importers.rosbag.mcap_file import McapFile, profile_of, search_unindexed_chunks
from relocbench.errors import ConfigError, DatasetError, quoted, raised
from relocbench.files import load_yaml_values, plain_file

SUFFIXES = (".bag", ".bag.active", ".mcap", ".db3")
"""how the names of bags end; ``.bag.active`` is one of ROS 1 that is being recorded, or whose recorder was killed"""
_ROS1 = (".bag", ".bag.active")
METADATA = "metadata.yaml"
_MOST_BETWEEN_NS = 60 * 10**9
"""longest time between the files of one drive"""
_SKIPPED = 8
"""messages that are skipped on the way to a later one before it is looked up instead"""
_HINTS = (
    ("index looks damaged", "`rosbag reindex` writes the index anew"),
    ("end magic", "it ends too early; `mcap recover` saves what is whole"),
    ("Truncated record", "it ends too early; `mcap recover` saves what is whole"),
    ("malformed", "`sqlite3 FILE .recover` saves what is whole"),
)
"""what to do about some faults, by words of the library's message"""


def is_recording(path: Path) -> bool:
    """Whether a path may be a recording of ROS, by its name and those of the files in it."""
    if not path.is_dir():
        return path.is_file() and path.name.endswith(SUFFIXES)
    try:
        return (path / METADATA).is_file() or any(p.name.endswith(SUFFIXES) for p in path.iterdir())
    except OSError:
        return False


def parts_of(source: Path) -> tuple[Path, ...]:
    """The files, or the folder of ROS 2, that a recording consists of, by name.

    Raises:
        DatasetError: there is no bag, or a folder holds files of several formats.
    """
    if source.is_dir() and (source / METADATA).is_file():
        _check_metadata(source / METADATA)
        for path in source.iterdir():
            plain_file(path, "a part of a bag", DatasetError)
        return (source,)
    if source.is_dir():
        files = tuple(sorted(p for p in source.iterdir() if p.name.endswith(SUFFIXES) and not p.name.startswith(".")))
        if not files:
            inner = sorted(p.name for p in source.iterdir() if (p / METADATA).is_file())
            message = f"; the bags {', '.join(inner[:4])} lie in it: give each of them" if inner else ""
            raise DatasetError(f"holds no bag; expected {', '.join(SUFFIXES)} files or {METADATA}{message}", source)
        forms = {".bag" if p.name.endswith(_ROS1) else p.suffix for p in files}
        if len(forms) > 1:
            found = ", ".join(sorted(forms))
            raise DatasetError(f"holds files of several formats ({found}); expected the parts of one drive", source)
        return tuple(plain_file(path, "a bag", DatasetError) for path in files)
    if not source.exists():
        raise DatasetError(f"missing; expected a bag ({', '.join(SUFFIXES)}) or a folder of ROS 2", source)
    if not source.name.endswith(SUFFIXES):
        packed = " decompress it first;" if source.suffix in (".zstd", ".zst", ".gz") else ""
        raise DatasetError(f"does not have the name of a bag;{packed} expected {', '.join(SUFFIXES)}", source)
    plain_file(source, "a bag", DatasetError)
    return (source,)


def _check_metadata(path: Path) -> None:
    values, _ = load_yaml_values(path, "the description of a bag of ROS 2", DatasetError)
    found = values.get("rosbag2_bagfile_information")
    if not isinstance(found, dict):
        raise DatasetError("has no key 'rosbag2_bagfile_information'", path)
    if str(found.get("compression_mode", "")).lower() == "file":
        # The library would unpack all of it into a temporary folder, once in every worker.
        raise DatasetError("its files are compressed as a whole; unpack it first (`ros2 bag convert`)", path)


class Part:
    """One opened file, or one folder of ROS 2; it is closed when nothing refers to it any more."""

    def __init__(self, path: Path) -> None:
        """Open it. Raises DatasetError with the file if it is damaged, ConfigError if rosbags is not installed."""
        self.path = path
        self._ros1: set[str] = set()
        self.counts: dict[str, int] = {}
        self.types: dict[str, str] = {}
        self.remark = ""
        """what is odd about the file, although it can be read"""
        try:
            self._open()
        except Exception as bad:  # noqa: BLE001  a damaged file raises whatever its bytes lead to
            raise _fault(path, bad) from None

    def _open(self) -> None:
        self._reader: Any = _reader(self.path)
        weakref.finalize(self, _close, self._reader)
        if self._is_ros1_file:
            self._open_ros1()
        else:
            self._reader.open()
        check_order(self._reader, self.path)
        search_unindexed_chunks(self._reader)
        for connection in self._reader.connections:
            name = connection.topic
            if not (isinstance(name, str) and isinstance(connection.msgtype, str)):
                raise DatasetError(f"{quoted(name)} is not the name of a topic, or its type is invalid", self.path)
            if self.types.setdefault(name, connection.msgtype) != connection.msgtype:
                raise DatasetError(f"topic {name} has messages of several types", self.path)
            if self._is_ros1_file or getattr(connection, "encoding", "") == "ros1":
                self._ros1.add(name)
            self.counts[name] = self.counts.get(name, 0) + int(connection.msgcount)
        self.begin_ns, self.end_ns = int(self._reader.start_time), int(self._reader.end_time)

    def _open_ros1(self) -> None:
        place, size = index_place(self.path), self.path.stat().st_size
        if place is not None and place > size:
            message = f"is cut off: it has {size} bytes, and its index begins at byte {place}"
            raise DatasetError(f"{message}; `rosbag reindex` saves what is whole", self.path)
        if place == 0:
            self.remark = open_without_index(self._reader)
        else:
            self._reader.open()

    @property
    def _is_ros1_file(self) -> bool:
        return self.path.name.endswith(_ROS1)

    def messages(self, topics: Sequence[str], start_ns: int | None = None) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time of receipt in nanoseconds and serialised bytes of each message, ordered by time.

        Raises:
            DatasetError: naming file and time, where the file is damaged.
        """
        chosen = [c for c in self._reader.connections if c.topic in topics]
        if not chosen:
            return
        last = start_ns
        try:
            for connection, last, raw in self._reader.messages(connections=chosen, start=start_ns):
                yield connection.topic, int(last), raw
        except Exception as bad:  # noqa: BLE001  a damaged file raises whatever its bytes lead to
            raise _fault(self.path, bad, "" if last is None else f" after the time {last} ns") from None

    def is_ros1(self, topic: str) -> bool:
        """Whether the messages of a topic are serialised as in ROS 1."""
        return topic in self._ros1

    def decode(self, topic: str, raw: bytes, received_ns: int) -> Any:
        """A message as an object with the fields of its type. Raises DatasetError with file, topic and time."""
        try:
            name, ros1 = standard_name(self.types[topic]), self.is_ros1(topic)
            store = typestore(ros1)
            return store.deserialize_ros1(raw, name) if ros1 else store.deserialize_cdr(raw, name)
        except Exception as bad:  # noqa: BLE001  what a damaged message raises in the library's generated code is open
            raise self.fault(topic, received_ns, f"cannot be decoded ({raised(bad)})") from None

    def fault(self, topic: str, received_ns: int, what: str) -> DatasetError:
        """An error about one message."""
        return DatasetError(f"{topic}, message received at {received_ns} ns: {what}", self.path)

    def check_standard(self, topic: str) -> None:
        """Raise DatasetError if a topic's type is defined otherwise in this file than by ROS."""
        name = self.types[topic]
        for connection in self._reader.connections:
            if connection.topic == topic and (found := difference(connection, name, self.is_ros1(topic))):
                raise DatasetError(f"{topic}: its {kinds.short(name)} is not the standard message: {found}", self.path)


def _close(reader: Any) -> None:
    with suppress(Exception):  # libraries complain where it was not opened, or only in part
        reader.close()


def open_parts(paths: Sequence[Path]) -> list[Part]:
    """Open the parts of a drive, ordered by time.

    Raises:
        DatasetError: a part is damaged, or the parts are too far apart in time to be one drive.
    """
    parts = sorted((open_part(path) for path in paths), key=lambda part: part.begin_ns)
    filled = [part for part in parts if any(part.counts.values())]
    if not filled:
        raise DatasetError("holds no message", paths[0])
    for before, after in pairwise(filled):
        apart = after.begin_ns - before.end_ns
        if apart > _MOST_BETWEEN_NS:
            raise DatasetError(
                f"begins {apart / 1e9:.0f} s after {before.path.name} ends; the files of a folder are taken for one "
                "drive: give each drive a folder or name its file",
                after.path,
            )
    return parts


def open_part(path: Path) -> Part:
    """A part, which stays open in this process as long as the file does not change, since opening reads its index."""
    try:
        found = path.stat()
    except OSError as bad:
        raise DatasetError(f"cannot be read ({bad.strerror}); expected a bag", path) from None
    return _open(path, found.st_size, found.st_mtime_ns)


@lru_cache(maxsize=8)
def _open(path: Path, size: int, time_ns: int) -> Part:
    return Part(path)


class _Cursor:
    """A place among the messages of one topic in one part."""

    def __init__(self, part: Part, topic: str, start_ns: int) -> None:
        self.part = part
        self.place = (start_ns, -1)
        self._found = part.messages([topic], start_ns)

    def advance(self) -> bytes | None:
        """The next message, None at the end."""
        following = next(self._found, None)
        if following is None:
            return None
        _, received_ns, raw = following
        self.place = (received_ns, self.place[1] + 1 if received_ns == self.place[0] else 0)
        return raw


_cursors: dict[tuple[Path, str], _Cursor] = {}
"""of this process: where each topic was read last"""


def read_raw(path: Path, topic: str, received_ns: int, ordinal: int) -> bytes:
    """A message by its time of receipt and its number among those of the topic that were received at this time.

    Messages that are read in their order are read once; others are looked up.

    Raises:
        DatasetError: the file is damaged or has changed.
    """
    wanted = (received_ns, ordinal)
    part = open_part(path)
    cursor = _cursors.pop((path, topic), None)
    if cursor is not None and cursor.part is not part:
        cursor = None
    for _ in range(_SKIPPED):
        if cursor is None or cursor.place >= wanted:
            break
        raw = cursor.advance()
        if raw is not None and cursor.place == wanted:
            _cursors[path, topic] = cursor
            return raw
    cursor = _Cursor(part, topic, received_ns)
    while cursor.place < wanted:
        raw = cursor.advance()
        if raw is None or cursor.place > wanted:
            break
        if cursor.place == wanted:
            _cursors[path, topic] = cursor
            return raw
    raise part.fault(topic, received_ns, "is not there any more; the file has changed since it was indexed")


def header_of(raw: bytes, ros1: bool) -> tuple[int, str]:
    """The stamp in nanoseconds and the frame of a message that begins with a header.

    Raises:
        ValueError: the message is too short.
    """
    try:
        if ros1:
            _, seconds, rest, length = struct.unpack_from("<IIII", raw)
            name = raw[16 : 16 + length]
        else:
            seconds, rest, length = struct.unpack_from("<iII" if raw[1] & 1 else ">iII", raw, 4)
            name = raw[16 : 16 + length]
        if len(name) != length:
            raise ValueError("its header is cut off")
        return seconds * 10**9 + rest, frame_name(name.rstrip(b"\0").decode())
    except (struct.error, IndexError):
        raise ValueError("its header is cut off") from None


def stamp_ns(stamp: Any) -> int:
    """Nanoseconds of a ``builtin_interfaces/Time``."""
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def frame_name(name: str) -> str:
    """The name of a frame; the slash with which names began in early versions of ROS means nothing."""
    return name.removeprefix("/")


def _reader(path: Path) -> Any:
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    except ImportError:
        raise ConfigError(
            "reading bags needs the package 'rosbags', which is not installed here (the extra 'bags' brings it)"
        ) from None
    if path.suffix == ".mcap" and profile_of(path) != "ros2":
        return McapFile(path)
    return Reader1(path) if path.name.endswith(_ROS1) else Reader2(path)


def _fault(path: Path, bad: Exception, where: str = "") -> Exception:
    """What the library raised about a damaged file, as one line."""
    if isinstance(bad, DatasetError | ConfigError):
        return bad
    message = raised(bad).replace(str(path), path.name)
    hint = next((f"; {hint}" for words, hint in _HINTS if words in message), "")
    return DatasetError(f"cannot be read as a bag{where} ({message}){hint}", path)
