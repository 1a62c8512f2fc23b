"""Headers of LAS and LAZ files: everything that they promise is compared with the file before a library reads it.

Formats: ASPRS, "LAS Specification", versions 1.0 to 1.4; M. Isenburg, "LASzip", for the chunks of compressed points.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.sensors.cloud_formats.point_table import points_follow
from relocbench.errors import DatasetError

_LEAST_HEADER = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375}
"""minor version -> bytes"""
_LEAST_RECORD = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""format of points -> bytes of a record"""
_VLR, _EVLR = 54, 60
_PROJECTION_USERS = (b"LASF_Projection", b"liblas")
_LASZIP = 22204
_POINTWISE, _LAYERED = 2, 3
"""ways of compression that write chunks"""
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""item of a layered point -> layers; of bytes that are not known each byte has one"""
_VARIABLE = 0xFFFFFFFF
"""size of chunks that differ"""
_MOST_KEPT = 2**20
"""bytes of a record of variable length that is looked into"""
_MOST_RECORDS = 100_000
_LOOKED_AT = 1000
"""records behind the promised ones that are looked at"""


@dataclass(frozen=True, eq=False)
class LasHeader:
    """What is needed of a header whose promises the file keeps."""

    points: int
    record_bytes: int
    compressed: bool
    scales: Array
    """(3,)"""
    offsets: Array
    """(3,)"""
    projection: dict[int, bytes]
    """records that state the coordinate system, by their number"""
    prefers_wkt: bool


def read_header(stream: BinaryIO, size: int, path: Path) -> LasHeader:
    """Read and check the header and the records of variable length.

    Args:
        size: of the file, in bytes.

    Raises:
        DatasetError: the file is no LAS of version 1.0 to 1.4, or does not hold what its header promises, or holds more
            points than it promises.
    """
    return _Checked(stream, size, path).header()


class _Checked:
    """A file while its header is checked."""

    def __init__(self, stream: BinaryIO, size: int, path: Path) -> None:
        self.stream, self.size, self.path = stream, size, path
        self.start = stream.read(375)
        if self.start[:4] != b"LASF":
            raise self._fault("is not a LAS or LAZ file: it does not begin with LASF")
        major, self.minor = self.start[24:26] if len(self.start) >= 26 else (0, 0)
        if len(self.start) >= 26 and (major != 1 or self.minor not in _LEAST_HEADER):
            raise self._fault(f"is LAS of version {major}.{self.minor}, expected 1.0 to 1.4")
        least = _LEAST_HEADER.get(self.minor, 227)
        self.header_bytes = self._value("<H", 94) if len(self.start) >= least else 0
        if len(self.start) < least or not least <= self.header_bytes <= size:
            raise self._fault(f"is truncated or damaged: its header has {self.header_bytes} bytes, the file {size}")

    def header(self) -> LasHeader:
        self.at, vlrs = self._value("<I", 96), self._value("<I", 100)
        if not self.header_bytes <= self.at <= self.size:
            raise self._fault(f"is truncated: its points begin at byte {self.at}, but it holds {self.size} bytes")
        kind, record, count = self._value("<B", 104), self._value("<H", 105), self._value("<I", 107)
        compressed, kind = bool(kind & 0xC0), kind & 0x3F
        if kind >= len(_LEAST_RECORD) or record < _LEAST_RECORD[kind]:
            raise self._fault(f"its points have format {kind} and {record} bytes, which do not fit each other")
        scales, offsets = np.array(struct.unpack_from("<6d", self.start, 131)).reshape(2, 3)
        if not np.isfinite([scales, offsets]).all() or not scales.all():
            raise self._fault("its scales or offsets are zero or not finite")
        evlrs = evlr_at = 0
        if self.minor == 4:
            evlr_at, evlrs, many = struct.unpack_from("<QIQ", self.start, 235)
            if count and many and count != many:
                raise self._fault(f"its header promises {many} points, and {count} in the field of older versions")
            count = many or count
        records = self._records(self.header_bytes, self.at, vlrs, _VLR, "records of variable length")
        records |= self._records(evlr_at, self.size, evlrs, _EVLR, "extended records of variable length")
        end = min(evlr_at, self.size) if evlrs and evlr_at >= self.at else self.size
        if self.minor == 3 and self.at < (waveforms := self._value("<Q", 227)) <= self.size:
            end = waveforms
        if compressed:
            self._check_chunks(records.pop(_LASZIP, None), count, record, end)
        else:
            self._check_points(count, record, end, scales, offsets)
        return LasHeader(
            count, record, compressed, scales, offsets, records, prefers_wkt=bool(self._value("<H", 6) & 16)
        )

    def _records(self, at: int, end: int, count: int, head: int, what: str) -> dict[int, bytes]:
        """The content of the records that are used, by number."""
        if count and (at < self.header_bytes or at + count * head > end):
            room = max(end - at, 0) // head if at >= self.header_bytes else 0
            raise self._fault(f"its header promises {count} {what}, but there is room for {room} at most")
        if count > _MOST_RECORDS:
            raise self._fault(f"holds {count} {what}, more than {_MOST_RECORDS}")
        kept: dict[int, bytes] = {}
        for number in range(count):
            self.stream.seek(at)
            start = self.stream.read(head)
            user, at = start[2:18].split(b"\0")[0], at + head
            length = (
                int.from_bytes(start[20:22] if head == _VLR else start[20:28], "little") if len(start) == head else -1
            )
            if length < 0 or at + length > end:
                raise self._fault(f"its header promises {count} {what}, but number {number + 1} does not fit into it")
            key = int.from_bytes(start[18:20], "little")
            if (user in _PROJECTION_USERS or key == _LASZIP) and length <= _MOST_KEPT:
                kept.setdefault(key, self.stream.read(length))
            at += length
        return kept

    def _check_points(self, count: int, record: int, end: int, scales: Array, offsets: Array) -> None:
        held = (end - self.at) // record
        if held < count:
            raise self._fault(f"is truncated: its header promises {count} points, but it holds {held}")
        if held == count:
            return
        self.stream.seek(self.at + count * record)
        behind = self._coordinates(record, min(held - count, _LOOKED_AT)) * scales + offsets
        promised = np.array(struct.unpack_from("<6d", self.start, 179)).reshape(3, 2).T
        if count:
            self.stream.seek(self.at)
            promised = self._coordinates(record, min(count, _LOOKED_AT)) * scales + offsets
        if points_follow(promised if promised.any() else promised[:0], behind):
            message = f"its header promises {count} points, but {held - count} more records lie behind them"
            raise self._fault(f"{message}; correct the header, such as by `lasinfo -repair`")

    def _coordinates(self, record: int, count: int) -> Array:
        """The integers x, y and z (N, 3) of the next records."""
        raw = np.frombuffer(self.stream.read(count * record), dtype=np.uint8).reshape(-1, record)
        return np.ascontiguousarray(raw[:, :12]).view("<i4").astype(np.float64)

    def _check_chunks(self, laszip: bytes | None, count: int, record: int, end: int) -> None:
        """The chunks of compressed points: their table lies within the file, and they are enough for the points."""
        if laszip is None or len(laszip) < 34:
            raise self._fault("holds compressed points, but not how (the record 'laszip encoded')")
        compressor = struct.unpack_from("<H", laszip)[0]
        if compressor not in (_POINTWISE, _LAYERED):
            raise self._fault("its points are compressed in one piece, as by LASzip before 2.0; expected chunks")
        chunk, items = struct.unpack_from("<I", laszip, 12)[0], struct.unpack_from("<H", laszip, 32)[0]
        found = [struct.unpack_from("<HH", laszip, 34 + 6 * k) for k in range(items) if len(laszip) >= 40 + 6 * k]
        held = sum(size for _, size in found)
        if len(found) != items or held != record or not chunk:
            raise self._fault(f"its compressed points have {held} bytes in chunks of {chunk}, expected {record}")
        if not count:
            return
        # A chunk begins with the bytes of its first point as they are.
        table = self._table_at(self.at, "<q")
        if table == -1:  # written to a stream: the place is told at the end
            table = self._table_at(self.size - 8, "<q")
        if not self.at + 8 <= table <= end - 8:
            raise self._fault(f"is truncated: its table of chunks is at byte {table}, but points end at byte {end}")
        chunks = self._table_at(table + 4, "<I")
        least = 1 if chunk == _VARIABLE else -(-count // chunk)
        room = (table - self.at - 8) // record
        if chunks < least or chunks > room:
            message = f"its header promises {count} points, which are at least {least} chunks of up to {chunk}"
            raise self._fault(f"{message}; its table has {chunks} chunks, and there is room for {room}")
        if compressor == _LAYERED:
            self._check_layers(count, record, chunks, table, sum(_LAYERS.get(k, size) for k, size in found))

    def _check_layers(self, count: int, record: int, chunks: int, table: int, layers: int) -> None:
        """The chunks of layers: a first point as it is, the number of points, the bytes of each layer, and these."""
        at, points, head = self.at + 8, 0, struct.Struct(f"<{1 + layers}I")
        for number in range(chunks):
            self.stream.seek(at + record)
            data = self.stream.read(head.size)
            many, *sizes = head.unpack(data) if len(data) == head.size else (0, 0)
            at, points = at + record + head.size + sum(sizes), points + many
            if at > table:
                raise self._fault(f"is damaged: its chunk {number + 1} of {chunks} ends at byte {at}, beyond {table}")
        if points != count:
            raise self._fault(f"its header promises {count} points, but its chunks have {points}")

    def _table_at(self, at: int, form: str) -> int:
        self.stream.seek(max(at, 0))
        data = self.stream.read(struct.calcsize(form))
        return int(struct.unpack(form, data)[0]) if len(data) == struct.calcsize(form) else 0

    def _value(self, form: str, at: int) -> int:
        return int(struct.unpack_from(form, self.start, at)[0])

    def _fault(self, message: str) -> DatasetError:
        return DatasetError(message, self.path)
