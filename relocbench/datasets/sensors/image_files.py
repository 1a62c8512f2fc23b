"""The images of a camera as files, one an image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from relocbench.arrays import Array, Floats, Image, Times
from relocbench.datasets.core import images
from relocbench.datasets.sensors.undistortion import undistort
from relocbench.geometry import Camera

_BAYER = {"GBRG": cv2.COLOR_BayerGBRG2RGB, "RGGB": cv2.COLOR_BayerRGGB2RGB}


@dataclass(frozen=True, eq=False)
class ImageFiles:
    """The images of one camera, undistorted when read; those of a pinhole camera can be linked unchanged."""

    name: str
    distorted: Camera
    """the camera that took the files"""
    T_rig_cam: Array
    files: tuple[Path, ...]
    times_ns: Times
    size_from: str
    """where the size of the images comes from, for messages"""

    @property
    def camera(self) -> Camera:
        return self.distorted.pinhole()

    @property
    def size(self) -> images.ExpectedSize:
        """The size that the images must have."""
        return images.ExpectedSize(self.distorted.size, self.size_from)

    def read(self, index: int) -> Image:
        """Read an undistorted image, (H, W) or (H, W, 3) RGB. Raises DatasetError with the file."""
        return undistort(images.read_image(self.files[index], self.size), self.distorted)

    def file(self, index: int) -> Path | None:
        """The image file if it needs no undistortion, else None."""
        return self.files[index] if self.distorted.model == "pinhole" else None


class ConvertedImages(ImageFiles):
    """Images that are no files of the dataset as they are."""

    def file(self, index: int) -> Path | None:
        """Always None: every image has to be converted."""
        return None


@dataclass(frozen=True, eq=False)
class BayerImages(ConvertedImages):
    """Images that are stored as Bayer mosaics, or in some copies of a dataset in colour."""

    bayer: Literal["GBRG", "RGGB"] = "RGGB"
    """colours of the top left 2x2 pixels"""

    def read(self, index: int) -> Image:
        """Read an undistorted image, (H, W, 3) RGB. Raises DatasetError with the file."""
        image = images.read_image(self.files[index], self.size)
        colour = image if image.ndim == 3 else np.asarray(cv2.cvtColor(image, _BAYER[self.bayer]), dtype=np.uint8)
        return undistort(colour, self.distorted)


def remapped(image: Image, table: Path, read: Callable[[Path, int, int], tuple[Floats, Floats]]) -> Image:
    """An image (H, W, 3) that a table undistorts, black outside the lens's view.

    Args:
        read: u and v (H, W) in the recorded image of each pixel, by the table's path and the image's width and height.
    """
    u, v = read(table, image.shape[1], image.shape[0])
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR), dtype=np.uint8)
