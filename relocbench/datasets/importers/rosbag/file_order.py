"""Bags of ROS 1 without an index, and topics of all bags whose messages go back in time within a file.

The recorder of ROS 1 writes the index when it is stopped. A bag whose recorder was killed has none, and the header of
its last chunk still says that it is empty (http://wiki.ros.org/Bags/Format/2.0). Its messages are found by going
through the whole file, once in each process that reads it.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from relocbench.arrays import Times
from relocbench.errors import DatasetError, quoted

_LARGEST_HEADER = 1 << 20
"""bytes of the header of a record; definitions of messages are in the data of connections"""
_BACK_NS = 1_000_000_000
"""a message of a topic that is written after one which is later by more did not come too late, but after another run"""


def index_place(path: Path) -> int | None:
    """The byte at which the index of a bag of ROS 1 begins, by its header: 0 if there is none, None if unknown."""
    from rosbags.rosbag1.reader import Header, ReaderError, RecordType

    with path.open("rb") as stream:
        if stream.readline(20) != b"#ROSBAG V2.0\n":
            return None
        try:
            return int(Header.read(stream, RecordType.BAGHEADER).get_uint64("index_pos"))
        except (ReaderError, ValueError):
            return None


def open_without_index(reader: Any) -> str:
    """Open a reader of rosbags for a bag that has no index, which is made. Returns what was found, in words.

    Raises:
        DatasetError: the bag holds no whole chunk, or one is compressed in an unknown way.
        Exception: whatever rosbags or a decompressor raises about a damaged chunk.
    """
    reader.bio = reader.path.open("rb")
    left_out = _Indexing(reader).run()
    count = sum(map(len, reader.indexes.values()))
    if not count:
        raise DatasetError("was not closed when it was recorded, and holds no whole message", reader.path)
    words = f"was not closed when it was recorded and has no index; its {count} messages are found in the file's order"
    return f"{words}, and its last {left_out} bytes, a part of a record, are left out" if left_out else words


class _Indexing:
    """A pass over the records of a bag."""

    def __init__(self, reader: Any) -> None:
        self.reader = reader
        self.connections: dict[int, Any] = {}
        self.indexes: dict[int, list[Any]] = defaultdict(list)

    def run(self) -> int:
        """Fill the reader's index. Returns how many bytes at the end of the file are no whole record."""
        stream, size = self.reader.bio, self.reader.path.stat().st_size
        stream.readline()
        end = self._chunks(stream, size)
        reader = self.reader
        reader.indexes = {number: sorted(self.indexes[number]) for number in self.connections}
        reader.connections = [c._replace(msgcount=len(self.indexes[n])) for n, c in self.connections.items()]
        return int(size - end)

    def _chunks(self, stream: BinaryIO, size: int) -> int:
        """Take the messages of all chunks. Returns where the last whole record ends."""
        from rosbags.rosbag1.reader import Chunk, RecordType, decompressors

        for place, header, length in _records(stream, size):
            if header.get_uint8("op") != RecordType.CHUNK:
                continue
            begin, how = stream.tell(), header.get_string("compression")
            if how not in decompressors:
                message = f"the chunk at byte {place} is compressed by {quoted(how, 30)}, expected none, bz2 or lz4"
                raise DatasetError(message, self.reader.path)
            if not length and how != "none":
                return place
            if length:
                data = decompressors[how](stream.read(length))
                self._messages(place, BytesIO(data), len(data))
                self.reader.chunks[place] = Chunk(length, begin, decompressors[how])
            else:  # the recorder was killed before it wrote the length of its last chunk
                self._messages(place, stream, size)
                end = stream.tell()
                self.reader.chunks[place] = Chunk(end - begin, begin, decompressors[how])
                return end
        return stream.tell()

    def _messages(self, place: int, chunk: BinaryIO, size: int) -> None:
        """Take the messages of the chunk at ``place``, from where a stream of its content stands."""
        from rosbags.rosbag1.reader import ChunkInfo, IndexData, RecordType

        begin, times, counts = chunk.tell(), [], dict[int, int]()
        for at, header, _ in _records(chunk, size):
            kind = header.get_uint8("op")
            if kind == RecordType.CONNECTION and header.get_uint32("conn") not in self.connections:
                self.connections[header.get_uint32("conn")] = self._connection(chunk, at)
            elif kind == RecordType.MSGDATA:
                number, time = header.get_uint32("conn"), header.get_time("time")
                self.indexes[number].append(IndexData(time, place, at - begin))
                counts[number] = counts.get(number, 0) + 1
                times.append(time)
        if times:
            self.reader.chunk_infos.append(ChunkInfo(place, min(times), max(times) + 1, counts))

    def _connection(self, chunk: BinaryIO, at: int) -> Any:
        """The connection whose record begins at a byte of a stream, which stays where it is."""
        stands, stream = chunk.tell(), self.reader.bio
        chunk.seek(at)
        self.reader.bio = chunk
        try:
            return self.reader.read_connection()
        finally:
            self.reader.bio = stream
            chunk.seek(stands)


def _records(stream: BinaryIO, size: int) -> Iterator[tuple[int, Any, int]]:
    """Place, header and length of the data of each whole record of a stream, which stands at the data.

    At the end it stands behind the last of them, whatever the caller does with it in between.
    """
    from rosbags.rosbag1.reader import Header, ReaderError

    place = stream.tell()
    while True:
        start = stream.read(4)
        if len(start) < 4 or struct.unpack("<I", start)[0] > _LARGEST_HEADER:
            break
        stream.seek(place)
        try:
            header = Header.read(stream)
            header.get_uint8("op")
        except (ReaderError, ValueError):
            break
        rest = stream.read(4)
        if len(rest) < 4:
            break
        begin, length = stream.tell(), int(struct.unpack("<I", rest)[0])
        if begin + length > size:
            break
        yield place, header, length
        place = begin + length
        stream.seek(place)
    stream.seek(place)


def check_order(reader: Any, path: Path) -> None:
    """Raise DatasetError if a topic holds several runs, which their times alone would mix."""
    for topic, times in _written(reader):
        for at in np.flatnonzero(np.diff(times) < -_BACK_NS) + 1:
            # Parts that were put together in another order do not overlap, and their times tell the right one.
            if times[at:].max() >= times[:at].min():
                raise DatasetError(
                    f"{topic}: message {at + 1} in the file was received at {times[at]} ns, "
                    f"{(times[at - 1] - times[at]) / 1e9:.1f} s before the one that was written before it: the bag "
                    "holds a recording that was looped, or several runs; cut it there",
                    path,
                )


def _written(reader: Any) -> Iterator[tuple[str, Times]]:
    """The topic of each writer, and times of receipt (N,) of its messages in the order of the file.

    Those of MCAP files without an index of messages are left out.
    """
    if hasattr(reader, "indexes"):  # of ROS 1
        for connection in reader.connections:
            found = sorted(reader.indexes[connection.id], key=lambda entry: (entry.chunk_pos, entry.offset))
            yield connection.topic, np.array([entry.time for entry in found], dtype=np.int64)
        return
    storage = getattr(reader, "storage", reader)
    for store in getattr(storage, "storages", [storage]):
        if (database := getattr(store, "dbconn", None)) is not None:
            topics = {connection.id: connection.topic for connection in store.connections}
            rows = np.array(
                database.execute("SELECT topic_id, timestamp FROM messages ORDER BY id").fetchall(), dtype=np.int64
            ).reshape(-1, 2)
        elif chunks := getattr(store, "chunks", ()):
            topics = {number: channel.topic for number, channel in store.channels.items()}
            rows = np.concatenate([_indexed(store.bio, chunk) for chunk in sorted(chunks, key=_place_of)])
        else:
            continue
        for number in np.unique(rows[:, 0]).tolist():
            yield topics.get(number, str(number)), rows[rows[:, 0] == number, 1]


def _place_of(chunk: Any) -> int:
    return int(chunk.chunk_start_offset)


def _indexed(stream: BinaryIO, chunk: Any) -> Times:
    """(N, 2) channel and time of the messages of a chunk of MCAP in their order (specification, Message Index)."""
    found = []
    for number, place in chunk.message_index_offsets.items():
        stream.seek(place + 1 + 8 + 2)
        (size,) = struct.unpack("<I", stream.read(4))
        entries = np.frombuffer(stream.read(size), dtype="<u8").reshape(-1, 2).astype(np.int64)
        found.append(np.column_stack([entries[:, 1], np.full(len(entries), number), entries[:, 0]]))
    rows = np.concatenate(found) if found else np.zeros((0, 3), dtype=np.int64)
    return rows[np.argsort(rows[:, 0], kind="stable"), 1:]
