"""MCAP files that rosbags does not read, or not right.

The class reads those of other profiles than that of ROS 2: messages of ROS 1, or no profile. It has the part of the
interface of the readers of rosbags that is used here.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from relocbench.errors import ConfigError, DatasetError

_MAGIC = b"\x89MCAP0\r\n"
_LARGEST_RECORD = 2**30
_ENCODINGS = ("ros1", "cdr")


@dataclass(frozen=True)
class Channel:
    """The messages of one topic by one writer."""

    topic: str
    msgtype: str
    msgcount: int
    encoding: str
    digest: str = ""


def profile_of(path: Path) -> str:
    """The profile in the header of an MCAP file; ``ros2`` if it cannot be told, so that rosbags tells why."""
    try:
        with path.open("rb") as stream:
            start = stream.read(8 + 1 + 8 + 4)
            length = struct.unpack("<I", start[17:21])[0]
            if start[:8] != _MAGIC or start[8] != 1 or length > 100:
                return "ros2"
            return stream.read(length).decode()
    except (OSError, struct.error, IndexError, UnicodeDecodeError):
        return "ros2"


class McapFile:
    """An MCAP file, read by the package mcap."""

    def __init__(self, path: Path) -> None:
        """Raises ConfigError if mcap is not installed."""
        self.path = path
        self.connections: list[Channel] = []
        self.chunks: list[Any] = []
        self.channels: dict[int, Any] = {}
        self.start_time = self.end_time = 0
        self.bio: BinaryIO | None = None
        self._reader: Any = None
        try:
            import mcap.reader  # noqa: F401  it is needed when the file is opened
        except ImportError:
            message = "needs the package 'mcap', which is not installed here (the extra 'bags' brings it)"
            raise ConfigError(message, path) from None

    def open(self) -> None:
        """Read the summary.

        Raises:
            DatasetError: there is none.
        """
        from mcap.reader import SeekingReader

        self.bio = self.path.open("rb")
        self._reader = SeekingReader(self.bio, validate_crcs=True, record_size_limit=_LARGEST_RECORD)
        summary = self._reader.get_summary()
        if summary is None or summary.statistics is None:
            raise DatasetError("has no summary of its content; `mcap recover` writes one", self.path)
        self.chunks, self.channels = summary.chunk_indexes, summary.channels
        counts = summary.statistics.channel_message_counts
        for number, channel in summary.channels.items():
            schema = summary.schemas.get(channel.schema_id)
            name = schema.name if schema is not None else "no schema"
            encoding = channel.message_encoding
            kind = _normalised(name) if encoding in _ENCODINGS else f"{name} ({encoding})"
            self.connections.append(Channel(channel.topic, kind, counts.get(number, 0), encoding))
        self.start_time = summary.statistics.message_start_time
        self.end_time = summary.statistics.message_end_time + 1

    def close(self) -> None:
        """Close the file."""
        if self.bio is not None:
            self.bio.close()

    def messages(
        self, connections: Sequence[Channel], start: int | None = None
    ) -> Iterator[tuple[Channel, int, bytes]]:
        """Channel, time of receipt in nanoseconds and bytes of the messages of some topics, ordered by time."""
        by_topic = {channel.topic: channel for channel in connections}
        for _, channel, message in self._reader.iter_messages(topics=list(by_topic), starting_at=start):
            yield by_topic[channel.topic], int(message.log_time), bytes(message.data)


def _normalised(name: str) -> str:
    """``sensor_msgs/Image`` of ROS 1 as ``sensor_msgs/msg/Image``."""
    package, _, last = name.partition("/")
    return f"{package}/msg/{last}" if last and "/" not in last else name


def search_unindexed_chunks(reader: Any) -> None:
    """Let an opened reader of rosbags look for every topic in the chunks of MCAP whose messages are not indexed.

    The index of chunks may leave out that of messages (MCAP specification, Chunk Index); rosbags takes such a chunk for
    one without messages, and counts none where the file has no statistics either.
    """
    storage = getattr(reader, "storage", None)
    for store in getattr(storage, "storages", [storage]):
        unindexed = [chunk for chunk in getattr(store, "chunks", ()) if not chunk.channel_count]
        if not unindexed:
            continue
        if not any(channel.msgcount for channel in store.connections):
            _count(store)
        for chunk in unindexed:
            chunk.channel_count.update({channel.id: 1 for channel in store.connections})


def _count(store: Any) -> None:
    """Count the messages of a file that holds neither statistics nor an index of messages."""
    store.meta_scan()
    found = store.statistics
    counts = found.channel_message_counts
    store.connections = [c._replace(msgcount=counts.get(c.id, 0)) for c in store.connections]
    if found.message_count:
        store.metadata = store.metadata._replace(
            message_count=found.message_count,
            start_time=found.start_time,
            end_time=found.end_time + 1,
            duration=found.end_time + 1 - found.start_time,
        )
