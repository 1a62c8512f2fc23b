"""What E57 files promise of themselves, compared with the file before a library reads it.

Format: ASTM E2807: a header of 48 bytes, pages that each end with a checksum, and an XML text that says where the
points of each setup are, how many they are and of what numbers.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import BinaryIO

from relocbench.errors import DatasetError

_HEADER = struct.Struct("<8sIIQQQQ")
_SECTION = struct.Struct("<B7xQQQ")
_CHECKSUM = 4
_PAGES = (64, 2**20)
"""least and greatest size of a page; writers use 1024 bytes"""
_MOST_XML = 2**26
_INT64 = (-(2**63), 2**63 - 1)


def check_header(path: Path) -> None:
    """Check sizes, offsets and numbers of points of an E57 file.

    Raises:
        DatasetError: the file is no E57, or does not hold what it promises.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(_HEADER.size)
        if head[:8] != b"ASTM-E57" or len(head) < _HEADER.size:
            raise DatasetError("is not an E57 file: it does not begin with ASTM-E57 and the rest of a header", path)
        _, _, _, length, xml_at, xml_bytes, page = _HEADER.unpack(head)
        if length != size:
            what = "is truncated" if length > size else "is damaged"
            raise DatasetError(f"{what}: its header promises {length} bytes, but it holds {size}", path)
        if not _PAGES[0] <= page <= _PAGES[1] or size % page:
            raise DatasetError(f"its {size} bytes are not a whole number of pages of {page} bytes", path)
        pages = _Pages(stream, size, page)
        if not _HEADER.size <= xml_at < size or xml_bytes > min(_MOST_XML, pages.left(xml_at)):
            message = f"its header promises {xml_bytes} bytes of XML at byte {xml_at}, beyond its {size} bytes"
            raise DatasetError(message, path)
        for number, points in enumerate(_vectors(pages.read(xml_at, xml_bytes), path)):
            _check_points(points, number, pages, path)


class _Pages:
    """A file whose pages each end with a checksum, which is no part of the content."""

    def __init__(self, stream: BinaryIO, size: int, page: int) -> None:
        self.stream, self.size, self.page = stream, size, page

    def left(self, at: int) -> int:
        """Bytes of content from a place in the file on."""
        return self._content(self.size) - self._content(at)

    def _content(self, at: int) -> int:
        whole, rest = divmod(at, self.page)
        return whole * (self.page - _CHECKSUM) + min(rest, self.page - _CHECKSUM)

    def read(self, at: int, count: int) -> bytes:
        """``count`` bytes of content from a place in the file on, or fewer at its end."""
        first = at // self.page * self.page
        many = -(-(count + at - first) // (self.page - _CHECKSUM)) + 1
        self.stream.seek(first)
        raw = self.stream.read(many * self.page)
        content = b"".join(raw[k : k + self.page - _CHECKSUM] for k in range(0, len(raw), self.page))
        return content[at - first :][:count]


def _vectors(xml: bytes, path: Path) -> list[ET.Element]:
    """The elements ``points`` of the setups."""
    if b"<!DOCTYPE" in xml or b"<!ENTITY" in xml:
        raise DatasetError("its XML declares entities, which E57 does not have", path)
    try:
        root = ET.fromstring(xml)
    except (ET.ParseError, ValueError) as bad:
        raise DatasetError(f"its XML is damaged ({bad})", path) from None
    return [node for node in root.iter() if _plain(node) == "points" and node.get("type") == "CompressedVector"]


def _check_points(points: ET.Element, number: int, pages: _Pages, path: Path) -> None:
    at, count = _whole(points, "fileOffset", 0, path), _whole(points, "recordCount", 0, path)
    if not count:
        return
    section = pages.read(at, _SECTION.size) if _HEADER.size <= at < pages.size else b""
    kind, length = _SECTION.unpack(section)[:2] if len(section) == _SECTION.size else (0, 0)
    if kind != 1 or length > pages.left(at):
        message = f"its points of setup {number} are promised at byte {at} with {length} bytes"
        raise DatasetError(f"{message}; the file of {pages.size} bytes does not hold them there", path)
    prototype = next((node for node in points if _plain(node) == "prototype"), ())
    bits = sum(_bits(node, path) for node in prototype)
    if count * max(bits, 1) > 8 * length:
        message = f"its XML promises {count} points of setup {number}, of {bits} bits each"
        raise DatasetError(f"{message}; the file holds {length} bytes of them", path)


def _bits(node: ET.Element, path: Path) -> int:
    """Bits of a number of one point."""
    kind = node.get("type")
    if kind == "Float":
        return 32 if node.get("precision") == "single" else 64
    if kind in ("Integer", "ScaledInteger"):
        low, high = (
            _whole(node, name, limit, path) for name, limit in zip(("minimum", "maximum"), _INT64, strict=True)
        )
        return max(high - low, 0).bit_length()
    return 0


def _whole(node: ET.Element, name: str, otherwise: int, path: Path) -> int:
    text = node.get(name, str(otherwise)).strip()
    if not text.lstrip("+-").isdecimal() or not text.isascii() or len(text) > 20:
        raise DatasetError(f"its XML has {name} '{text[:40]}', expected a whole number", path)
    return int(text)


def _plain(node: ET.Element) -> str:
    """The name of an element without its namespace."""
    return node.tag.rpartition("}")[2]
