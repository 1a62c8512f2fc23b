"""What a JPEG's Exif data tell: which way up the photograph is, and its focal length.

Format: CIPA DC-008 (Exif 2.32), sections 4.5 and 4.6; TIFF 6.0, section 2. Data that are damaged tell nothing: a
photograph is no worse without them.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import cv2
import numpy as np

from relocbench.arrays import Image

_HEAD = b"Exif\0\0"
_ORIENTATION, _EXIF_FOLDER, _FOCAL_35MM = 0x0112, 0x8769, 0xA405
_SHORT, _LONG = 3, 4
_MOST_ENTRIES = 512
_FILM_DIAGONAL_MM = math.hypot(36, 24)
_SENSIBLE_MM = 8, 400
"""35 mm equivalents of lenses that a pinhole camera describes"""


@dataclass(frozen=True)
class Exif:
    """Facts about a photograph."""

    orientation: int = 1
    """1 to 8; 1: as it is stored"""
    focal_35mm: int | None = None
    """focal length in mm for the field of view of 35 mm film"""

    def upright(self, image: Image) -> Image:
        """An image as stored, the right way up."""
        turned = {3: cv2.ROTATE_180, 4: cv2.ROTATE_180, 6: cv2.ROTATE_90_CLOCKWISE, 7: cv2.ROTATE_90_COUNTERCLOCKWISE}
        turned |= {8: cv2.ROTATE_90_COUNTERCLOCKWISE, 5: cv2.ROTATE_90_CLOCKWISE}
        if self.orientation in turned:
            image = np.asarray(cv2.rotate(image, turned[self.orientation]))
        return np.ascontiguousarray(image[:, ::-1]) if self.orientation in (2, 4, 5, 7) else image

    def size(self, stored: tuple[int, int]) -> tuple[int, int]:
        """(width, height) of the upright image."""
        return stored[::-1] if self.orientation >= 5 else stored

    def focal_px(self, size: tuple[int, int]) -> float | None:
        """Focal length in pixels of an image of this (width, height); None if it is not told or not sensible."""
        if self.focal_35mm is None or not _SENSIBLE_MM[0] <= self.focal_35mm <= _SENSIBLE_MM[1]:
            return None
        return self.focal_35mm / _FILM_DIAGONAL_MM * math.hypot(*size)


def read_exif(data: bytes) -> Exif:
    """The Exif data of an image file; the default of each fact that they do not tell."""
    at = 2
    if not data.startswith(b"\xff\xd8"):
        return Exif()
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != 0xDA:
        length = struct.unpack_from(">H", data, at + 2)[0]
        if data[at + 1] == 0xE1 and data[at + 4 : at + 10] == _HEAD:
            return _read_tiff(data[at + 10 : at + 2 + length])
        at += 2 + length
    return Exif()


def _read_tiff(data: bytes) -> Exif:
    first, order = tiff_entries(data)
    orientation = first.get(_ORIENTATION, 1)
    inner = _entries(data, first[_EXIF_FOLDER], order) if _EXIF_FOLDER in first else {}
    return Exif(orientation if 1 <= orientation <= 8 else 1, inner.get(_FOCAL_35MM))


def tiff_entries(data: bytes) -> tuple[dict[int, int], str]:
    """Tag -> value of the single whole numbers in the first folder of a TIFF, none if it is damaged; its byte order."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4], "")
    if not order or len(data) < 8:
        return {}, order
    return _entries(data, struct.unpack_from(order + "I", data, 4)[0], order), order


def _entries(data: bytes, at: int, order: str) -> dict[int, int]:
    """Tag -> value of the single whole numbers in a folder of a TIFF."""
    if at + 2 > len(data):
        return {}
    count = min(struct.unpack_from(order + "H", data, at)[0], _MOST_ENTRIES)
    found = {}
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        if entry + 12 > len(data):
            break
        tag, kind, number = struct.unpack_from(order + "HHI", data, entry)
        if number == 1 and kind in (_SHORT, _LONG):
            found[tag] = struct.unpack_from(order + ("H" if kind == _SHORT else "I"), data, entry + 8)[0]
    return found
