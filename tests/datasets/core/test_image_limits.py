"""Images are refused by their headers, in one line and before a decoder takes memory for them."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from refusals import refused

from relocbench.datasets.core import images
from relocbench.datasets.core.image_header import (
    MOST_DECODED_BYTES,
    MOST_PIXELS,
    check_affordable,
    check_content,
    read_header,
)
from relocbench.errors import DatasetError


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(
    width: int,
    height: int,
    bits: int = 8,
    colour: int = 0,
    interlace: int = 0,
    *,
    pixels: bytes | None = None,
    extra: bytes = b"",
) -> bytes:
    row = 1 + (width * {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}.get(colour, 1) * bits + 7) // 8
    content = zlib.compress(bytes(row * height) if pixels is None else pixels, 9)
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, interlace))
    return b"\x89PNG\r\n\x1a\n" + head + extra + chunk(b"IDAT", content) + chunk(b"IEND", b"")


def jpeg(image: np.ndarray, *options: int) -> bytes:
    return bytes(cv2.imencode(".jpg", image, list(options))[1])


def with_frame(data: bytes, marker: int | None = None, height: int | None = None, width: int | None = None) -> bytes:
    """The same JPEG with another frame header."""
    out = bytearray(data)
    at = next(i for i in range(len(data)) if data[i] == 0xFF and data[i + 1] in (0xC0, 0xC2))
    out[at + 1] = marker or out[at + 1]
    if height is not None:
        out[at + 5 : at + 7] = struct.pack(">H", height)
    if width is not None:
        out[at + 7 : at + 9] = struct.pack(">H", width)
    return bytes(out)


def flipped(data: bytes, at: int) -> bytes:
    out = bytearray(data)
    out[at] ^= 1
    return bytes(out)


NOISE = np.random.default_rng(0).integers(0, 255, (40, 60, 3), dtype=np.uint8)
JPEG = jpeg(NOISE)
PROGRESSIVE = jpeg(NOISE, cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
LAST_SCAN = PROGRESSIVE[PROGRESSIVE.rfind(b"\xff\xda") : -2]
EXIF_TURNED = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"

REFUSED: dict[str, tuple[bytes, str]] = {
    "20000x20000": (png(20000, 20000, 1, pixels=bytes(1 << 20)), f"20000x20000, more than the {MOST_PIXELS} pixels"),
    "a million squared": (png(10**6, 10**6, pixels=b"\0"), "1000000x1000000, more than"),
    "2^31 wide": (png(2**31, 1, pixels=b"\0"), "PNG header"),
    "16 bits of four channels": (png(8192, 8192, 16, 6, pixels=b"\0"), f"{MOST_DECODED_BYTES}"),
    "no width": (png(0, 5, pixels=b"\0"), "PNG header"),
    "no height": (png(5, 0, pixels=b"\0"), "PNG header"),
    "no such depth": (png(5, 4, 3), "PNG header"),
    "no such colour": (png(5, 4, 8, 5), "PNG header"),
    "no such interlacing": (png(5, 4, interlace=2), "PNG header"),
    "wrong sum of the header": (flipped(png(5, 4), 29), "PNG header"),
    "wrong sum of the pixels": (flipped(png(50, 40), 45), "IDAT at byte 33"),
    "no header": (b"\x89PNG\r\n\x1a\n" + chunk(b"IDAT", b"") + chunk(b"IEND", b""), "PNG header"),
    "a part longer than the file": (
        png(5, 4)[:33] + struct.pack(">I", 2**31) + b"tEXt" + chunk(b"IEND", b""), "PNG header"
    ),
    "too few pixels for its size": (png(8000, 8000, pixels=bytes(100)), "8000x8000"),
    "some pixels missing": (png(50, 40, pixels=bytes(100)), "cannot be decoded"),
    "no palette": (png(5, 4, 8, 3), "cannot be decoded"),
    "animated": (png(5, 4, extra=chunk(b"acTL", struct.pack(">II", 2, 0))), "animated PNG"),
    "cut PNG": (png(50, 40)[:-20], "truncated"),
    "cut JPEG": (JPEG[: len(JPEG) // 2], "truncated"),
    "cut JPEG header": (JPEG[:100], "JPEG header"),
    "no height, JPEG": (with_frame(JPEG, height=0), "JPEG header"),
    "65535x65535": (with_frame(JPEG, height=65535, width=65535), "65535x65535"),
    "too few pixels, JPEG": (with_frame(JPEG, height=8000, width=8000), "8000x8000"),
    "progressive, all kept": (with_frame(PROGRESSIVE, height=8192, width=8192), f"{MOST_DECODED_BYTES}"),
    "lossless JPEG": (with_frame(JPEG, marker=0xC3), "lossless"),
    "arithmetic JPEG": (with_frame(JPEG, marker=0xC9), "lossless"),
    "a JPEG of 1000 scans": (PROGRESSIVE[:-2] + LAST_SCAN * 1000 + b"\xff\xd9", "scans"),
    "43 million pixels in 10 scans": (
        with_frame(PROGRESSIVE, height=5376, width=8000)[:-2] + bytes(90_000) + b"\xff\xd9",
        "10 scans",
    ),
    "empty": (b"", ""),
    "four bytes": (b"\xff\xd8\xff\xe0", "JPEG header"),
    "text": (b"not an image at all", "PNG or JPEG"),
    "TIFF": (b"II*\0" + bytes(100), "TIFF"),
    "OpenEXR": (b"v/1\x01" + bytes(100), "OpenEXR"),
    "Radiance HDR": (b"#?RADIANCE\n" + bytes(100), "Radiance HDR"),
    "GIF": (b"GIF89a" + bytes(100), "GIF"),
    "WebP": (b"RIFF\x10\0\0\0WEBPVP8 " + bytes(100), "WebP"),
    "BMP": (b"BM" + bytes(100), "BMP"),
    "PGM": (b"P5\n5 4\n255\n" + bytes(20), "PNM"),
    "JPEG 2000": (b"\0\0\0\x0cjP  \r\n\x87\n" + bytes(100), "JPEG 2000"),
}  # fmt: skip
UP_TO_THE_DECODER = {"some pixels missing", "no palette"}


@pytest.fixture
def no_decoder(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise AssertionError("the decoder was called")

    monkeypatch.setattr(cv2, "imdecode", refuse)


@pytest.mark.parametrize("case", sorted(REFUSED.keys() - UP_TO_THE_DECODER))
def test_a_damaged_or_huge_image_is_refused_in_one_line_before_it_is_decoded(
    tmp_path: Path, case: str, no_decoder: None
) -> None:
    _assert_refused(tmp_path, case)


@pytest.mark.parametrize("case", sorted(UP_TO_THE_DECODER))
def test_what_the_decoder_alone_finds_is_one_line(tmp_path: Path, case: str) -> None:
    _assert_refused(tmp_path, case)


def _assert_refused(tmp_path: Path, case: str) -> None:
    data, words = REFUSED[case]
    path = tmp_path / "0.png"
    path.write_bytes(data)
    for read in (images.read_image, images.read_depth):
        with pytest.raises(DatasetError) as caught:
            read(path)
        assert words in str(caught.value)
        assert str(caught.value).startswith(str(path))
        assert "\n" not in str(caught.value)


def test_an_error_of_the_decoder_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any) -> None:
        raise cv2.error("OpenCV: several\nlines")

    path = tmp_path / "0.png"
    path.write_bytes(png(5, 4))
    monkeypatch.setattr(cv2, "imdecode", broken)
    with refused(DatasetError, "0.png"):
        images.read_image(path)


def test_the_size_is_checked_before_anything_is_decoded(tmp_path: Path, no_decoder: None) -> None:
    path = tmp_path / "0.png"
    for data, size in ((png(30000, 30000, pixels=b"\0"), (30000, 30000)), (JPEG, (60, 40))):
        path.write_bytes(data)
        for read in (images.read_image, images.read_depth):
            with refused(DatasetError, "0.png", None, f"{size[0]}x{size[1]}", "1x1"):
                read(path, images.ExpectedSize((1, 1), "a test"))


def a_folder(path: Path) -> None:
    path.mkdir()


def a_pipe(path: Path) -> None:
    os.mkfifo(path)


def a_device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def a_loop(path: Path) -> None:
    path.symlink_to(path)


def a_dead_link(path: Path) -> None:
    path.symlink_to(path.parent / "gone.png")


def a_sparse_file(path: Path) -> None:
    path.touch()
    os.truncate(path, 1 << 40)


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (a_folder, ("folder",)),
        (a_pipe, ("pipe",)),
        (a_device, ("device",)),
        (a_loop, ()),
        (a_dead_link, ("link",)),
        (a_sparse_file, ("1099511627776",)),
    ],
)
def test_what_is_no_plain_file_is_refused_without_waiting(
    tmp_path: Path, make: Callable[[Path], None], names: tuple[str, ...]
) -> None:
    path = tmp_path / "0.png"
    make(path)
    assert not images.is_whole(path)
    with refused(DatasetError, "0.png", None, *names):
        images.read_image(path)


PALETTE = chunk(b"PLTE", bytes([10, 20, 30, 40, 50, 60]))
ADAM_7 = b"".join(
    bytes(1 + columns) * rows for columns, rows in ((1, 1), (1, 1), (2, 1), (1, 1), (3, 1), (2, 2), (5, 2))
)


@pytest.mark.parametrize(
    ("data", "shape"),
    [
        *((png(5, 4, bits), (4, 5)) for bits in (1, 2, 4, 8, 16)),
        *((png(5, 4, bits, 2), (4, 5, 3)) for bits in (8, 16)),
        *((png(5, 4, bits, 3, extra=PALETTE), (4, 5, 3)) for bits in (1, 2, 4, 8)),
        *((png(5, 4, bits, 4), (4, 5, 3)) for bits in (8, 16)),
        *((png(5, 4, bits, 6), (4, 5, 3)) for bits in (8, 16)),
        (png(5, 4, interlace=1, pixels=ADAM_7), (4, 5)),
        (JPEG, (40, 60, 3)),
        (PROGRESSIVE, (40, 60, 3)),
        (jpeg(NOISE[..., 0]), (40, 60)),
        (JPEG + b"what a camera adds behind the image", (40, 60, 3)),
        (JPEG[:2] + b"\xff\xe1" + struct.pack(">H", len(EXIF_TURNED) + 2) + EXIF_TURNED + JPEG[2:], (40, 60, 3)),
    ],
)  # fmt: skip
def test_every_kind_of_png_and_jpeg_is_read_as_it_is_stored(
    tmp_path: Path, data: bytes, shape: tuple[int, ...]
) -> None:
    """Also where its metadata ask for it to be turned."""
    path = tmp_path / "0.png"
    path.write_bytes(data)
    image = images.read_image(path)
    assert image.shape == shape
    assert image.dtype == np.uint8
    assert read_header(data, path).size == shape[1::-1]


def test_cmyk_is_read_as_rgb(tmp_path: Path) -> None:
    from PIL import Image

    path = tmp_path / "0.jpg"
    Image.fromarray(np.full((8, 16, 4), 100, np.uint8), "CMYK").save(path)
    assert images.read_image(path).shape == (8, 16, 3)


def test_a_photograph_of_24_million_pixels_in_the_scans_of_an_encoder_is_affordable(tmp_path: Path) -> None:
    data = with_frame(PROGRESSIVE, height=4000, width=6000)[:-2] + bytes(50_000) + b"\xff\xd9"
    header = read_header(data, tmp_path)
    assert header.in_scans
    check_affordable(header, tmp_path)
    check_content(data, header, tmp_path)
