"""Small pictures of single images, one file each, whichever pages and queries show them."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from relocbench.arrays import Image
from relocbench.datasets.core.images import jpeg_bytes
from relocbench.execution import run_units
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.data import write_data
from relocbench.progress import Reporter
from relocbench.retrieval import ImageView

_PIXELS = 280 * 210
"""pixels of a picture at most"""
_QUALITY = 80
_DIGITS = 16


@dataclass(frozen=True)
class Thumbnail:
    """A picture that is to be written."""

    site: Path
    of_set: str
    """id of the set on whose pages it is shown"""
    view: ImageView = field(compare=False)

    @property
    def name(self) -> str:
        """What payloads call it."""
        return thumbnail_name(self.view.key)

    @property
    def key(self) -> str:
        """The key of its payload."""
        return f"thumbnails/{self.of_set}/{self.name}"

    @property
    def path(self) -> Path:
        """The file that it is written to."""
        return self.site / links.data_file(self.key)


def thumbnail_name(key: str) -> str:
    """The name of an image's picture: a digest, since the key of an image is a path."""
    return hashlib.sha256(key.encode(errors="surrogatepass")).hexdigest()[:_DIGITS]


def write_thumbnails(thumbnails: Iterable[Thumbnail], reporter: Reporter) -> set[Path]:
    """Write pictures, each once; returns their files.

    Raises:
        DatasetError: an image cannot be read.
    """
    jobs = list({one.path: one for one in thumbnails}.values())
    written: set[Path] = set()
    with reporter.stage("pictures of queries", len(jobs)) as advance:
        for _, path in run_units(_write, jobs):
            written.add(path)
            advance(1)
    return written


def small(image: Image) -> Image:
    """An image (H, W[, 3]) of at most so many pixels as a small picture has."""
    height, width = image.shape[:2]
    factor = math.sqrt(_PIXELS / (height * width))
    if factor >= 1:
        return image
    size = max(1, round(width * factor)), max(1, round(height * factor))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _write(job: Thumbnail) -> Path:
    image = small(job.view.read())  # not .image, which would keep the whole of each
    data = base64.b64encode(jpeg_bytes(image, _QUALITY)).decode()
    payload = {"src": f"data:image/jpeg;base64,{data}", "width": image.shape[1], "height": image.shape[0]}
    return write_data(job.site, job.key, payload)
