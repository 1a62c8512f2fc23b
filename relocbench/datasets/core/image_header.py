"""Headers of PNG and JPEG files, and checks that an image can safely be decoded.

A decoder allocates what the header asks for, so that a file of one kilobyte could make it allocate gigabytes. Formats:
W3C Portable Network Graphics (third edition), sections 5 and 11; JPEG, ITU-T T.81, annex B.
"""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from relocbench.errors import DatasetError

MOST_PIXELS = 2**26
"""67 million, more than the largest camera sensors have; a car's camera has one to eight million"""
MOST_DECODED_BYTES = 2**28
"""256 MiB that a decoder may allocate: 2^26 pixels of 8-bit RGBA, half as many with 16 bits. Including later copies,
reading an image takes less than a gigabyte."""
MOST_FILE_BYTES = 2**28
"""an image of at most so many pixels never needs a larger file, unless it is 16-bit noise"""
_MOST_SCANS = 100
"""scans of a JPEG. Encoders write about 10; a scan of a few bytes makes the decoder pass over the whole image."""
_MOST_SCANNED_PIXELS = 2**28
"""pixels times scans, which bounds the decoding time: 27 million pixels in the usual 10 scans. At this limit, noise at
the best quality takes one core about five seconds."""

PNG_START = b"\x89PNG\r\n\x1a\n"
PNG_END = b"IEND\xaeB`\x82"
JPEG_START = b"\xff\xd8\xff"

_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_PNG_BITS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_CRITICAL = (b"IHDR", b"PLTE", b"IDAT")
_DEFLATE_RATIO = 1032
"""greatest ratio of raw to deflated bytes (zlib's documentation)"""
_PIXELS_A_JPEG_BYTE = 512
"""each block of 64 pixels takes at least one bit, that of its DC coefficient"""
_FRAMES = {0xC0, 0xC1, 0xC2}
"""baseline, extended, progressive; Huffman coded"""
_OTHER_FRAMES = {0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF}
_BARE = {0x01, *range(0xD0, 0xD8)}
"""markers without a length"""
_OTHER_FORMATS = (
    (rb"II\*\0|MM\0\*|II\+\0|MM\0\+", "TIFF"), (rb"GIF8", "GIF"), (rb"BM", "BMP"), (rb"RIFF....WEBP", "WebP"),
    (rb"v/1\x01", "OpenEXR"), (rb"#\?R", "Radiance HDR"), (rb"P[1-7]\s", "PNM"), (rb"P[Ff]\s", "PFM"),
    (rb"\0\0\0\x0cjP|\xff\x4f\xff\x51", "JPEG 2000"), (rb"....ftyp", "AVIF or HEIF"),
    (rb"\xff\x0a|\0\0\0\x0cJXL", "JPEG XL"),    (rb"Y\xa6j\x95", "Sun raster"),
)  # fmt: skip


@dataclass(frozen=True)
class ImageHeader:
    """The header of a PNG or JPEG."""

    format: Literal["PNG", "JPEG"]
    width: int
    height: int
    bits: int
    """per sample"""
    channels: int
    """as stored: 1 for a palette"""
    decoded_bytes: int
    """least memory that a decoder allocates"""
    pixels_at: int = 0
    """JPEG: offset of the first byte after the header"""
    in_scans: bool = False
    """JPEG: whether the image is built up from several scans"""

    @property
    def size(self) -> tuple[int, int]:
        """Pixels, (width, height)."""
        return self.width, self.height


def read_header(data: bytes, path: Path) -> ImageHeader:
    """Parse the header of an image.

    Args:
        data: the whole file.
        path: the file's path, for messages.

    Raises:
        DatasetError: the file is neither PNG nor JPEG, is truncated, or has an impossible header.
    """
    if data.startswith(PNG_START):
        if not data.endswith(PNG_END):
            raise DatasetError("truncated or not an image; expected a whole PNG or JPEG", path)
        return _png_header(data, path)
    if data.startswith(JPEG_START):
        return _jpeg_header(data, path)
    if len(data) < 8:
        raise DatasetError("truncated or not an image; expected a whole PNG or JPEG", path)
    other = next((name for start, name in _OTHER_FORMATS if re.match(start, data[:16], re.DOTALL)), None)
    reason = f" (its content is {other})" if other else ""
    raise DatasetError(f"cannot be decoded{reason}; expected a PNG or JPEG", path)


def check_affordable(header: ImageHeader, path: Path) -> None:
    """Raise DatasetError if an image has too many pixels or would take too much memory."""
    size = f"is {header.width}x{header.height}"
    if header.width * header.height > MOST_PIXELS:
        raise DatasetError(f"{size}, more than the {MOST_PIXELS} pixels that an image may have", path)
    if header.decoded_bytes > MOST_DECODED_BYTES:
        raise DatasetError(f"{size} and takes {header.decoded_bytes} bytes, more than {MOST_DECODED_BYTES}", path)


def check_content(data: bytes, header: ImageHeader, path: Path) -> None:
    """Check what follows the header, without decoding it.

    Raises:
        DatasetError: the data are damaged, truncated or too few for the image's size, a PNG is animated, or a JPEG
            has too many scans.
    """
    if header.format == "PNG":
        _check_png(data, header, path)
    else:
        _check_jpeg(data, header, path)


def _png_header(data: bytes, path: Path) -> ImageHeader:
    length, kind = struct.unpack(">I4s", data[8:16])
    if (length, kind) != (13, b"IHDR") or len(data) < 33:
        raise _damaged("PNG", path)
    width, height, bits, colour, deflate, filtering, interlace = struct.unpack(">IIBBBBB", data[16:29])
    if zlib.crc32(data[12:29]) != struct.unpack(">I", data[29:33])[0]:
        raise _damaged("PNG", path)
    known = bits in _PNG_BITS.get(colour, ()) and (deflate, filtering) == (0, 0) and interlace in (0, 1)
    if not known or not 0 < width < 2**31 or not 0 < height < 2**31:
        raise _damaged("PNG", path)
    channels = _PNG_CHANNELS[colour]
    # Palettes and grey images with alpha are decoded to colours.
    held = width * height * (4 if colour in (3, 4) else channels) * (2 if bits == 16 else 1)
    return ImageHeader("PNG", width, height, bits, channels, held)


def _check_png(data: bytes, header: ImageHeader, path: Path) -> None:
    at, compressed, view = 8, 0, memoryview(data)
    while at < len(data):
        if at + 12 > len(data):
            raise _damaged("PNG", path)
        length, kind = struct.unpack_from(">I4s", data, at)
        if at + 12 + length > len(data):
            raise _damaged("PNG", path)
        if kind == b"acTL":
            raise DatasetError("is an animated PNG; expected a single image", path)
        if kind in _CRITICAL:
            stored = struct.unpack_from(">I", data, at + 8 + length)[0]
            if zlib.crc32(view[at + 4 : at + 8 + length]) != stored:
                raise DatasetError(f"cannot be decoded (its {kind.decode()} at byte {at} is damaged)", path)
            compressed += length if kind == b"IDAT" else 0
        at += 12 + length
        if kind == b"IEND" and at != len(data):
            raise _damaged("PNG", path)
    row = 1 + (header.width * header.channels * header.bits + 7) // 8
    if row * header.height > _DEFLATE_RATIO * (compressed + 1):
        reason = f"{compressed} bytes of pixels are too few for {header.width}x{header.height}"
        raise DatasetError(f"cannot be decoded ({reason})", path)


def _jpeg_header(data: bytes, path: Path) -> ImageHeader:
    segments = _jpeg_segments(data, path)
    if any(marker in _OTHER_FRAMES for marker, _, _ in segments):
        what = "a lossless, hierarchical or arithmetic-coded JPEG"
        raise DatasetError(f"cannot be decoded ({what}); expected a PNG or JPEG", path)
    frames = [segment for segment in segments if segment[0] in _FRAMES]
    if len(frames) != 1 or frames[0][2] < 6:
        raise _damaged("JPEG", path)
    marker, start, length = frames[0]
    bits, height, width, channels = struct.unpack_from(">BHHB", data, start)
    _, scan, scan_length = segments[-1]
    known = bits == 8 and channels in (1, 3, 4) and length == 6 + 3 * channels
    if not known or width == 0 or height == 0 or scan_length == 0:
        raise _damaged("JPEG", path)
    # If the first scan does not bring the whole image, the decoder keeps all coefficients, 2 bytes each.
    in_scans = marker == 0xC2 or data[scan] < channels
    held = width * height * max(3, channels) * (2 if in_scans else 1)
    return ImageHeader("JPEG", width, height, bits, channels, held, scan, in_scans)


def _check_jpeg(data: bytes, header: ImageHeader, path: Path) -> None:
    """Check the scans. In entropy-coded data 0xFF is always followed by 0, so that a search finds the markers."""
    begin = header.pixels_at
    if data.rfind(b"\xff\xd9", begin) < 0:
        raise DatasetError("truncated: it has no end; expected a whole PNG or JPEG", path)
    pixels = header.width * header.height
    if pixels > _PIXELS_A_JPEG_BYTE * (len(data) - begin):
        reason = f"{len(data) - begin} bytes of pixels are too few for {header.width}x{header.height}"
        raise DatasetError(f"cannot be decoded ({reason})", path)
    scans = 1 + data.count(b"\xff\xda", begin, data.find(b"\xff\xd9", begin)) if header.in_scans else 1
    if scans > _MOST_SCANS or pixels * scans > _MOST_SCANNED_PIXELS:
        raise DatasetError(f"cannot be decoded (a JPEG of {scans} scans, which would take too long)", path)


def _jpeg_segments(data: bytes, path: Path) -> list[tuple[int, int, int]]:
    """Marker, offset and length of each segment's content, up to the first scan."""
    out = []
    at = 2
    while True:
        while at + 1 < len(data) and data[at : at + 2] == b"\xff\xff":  # fill bytes
            at += 1
        if at + 4 > len(data) or data[at] != 0xFF:
            raise _damaged("JPEG", path)
        marker = data[at + 1]
        if marker in _BARE:
            at += 2
            continue
        length = struct.unpack_from(">H", data, at + 2)[0]
        if marker == 0xD9 or length < 2 or at + 2 + length > len(data):
            raise _damaged("JPEG", path)
        out.append((marker, at + 4, length - 2))
        if marker == 0xDA:
            return out
        at += 2 + length


def _damaged(kind: str, path: Path) -> DatasetError:
    return DatasetError(f"cannot be decoded (its {kind} header is damaged); expected a PNG or JPEG", path)
