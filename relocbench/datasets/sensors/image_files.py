"""The images of a camera as files, one an image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from relocbench.arrays import Array, Image, Times
from relocbench.datasets.core import images
from relocbench.datasets.sensors.undistortion import undistort
from relocbench.geometry import Camera


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

    def read(self, index: int) -> Image:
        """Read an undistorted image, (H, W) or (H, W, 3) RGB. Raises DatasetError with the file."""
        size = images.ExpectedSize(self.distorted.size, self.size_from)
        return undistort(images.read_image(self.files[index], size), self.distorted)

    def file(self, index: int) -> Path | None:
        """The image file if it needs no undistortion, else None."""
        return self.files[index] if self.distorted.model == "pinhole" else None
