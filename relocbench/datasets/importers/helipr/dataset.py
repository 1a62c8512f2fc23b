"""Kind ``helipr``: drives in the layout of the HeLiPR dataset, with ground truth across drives from their lidar."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from relocbench.datasets.importers.lidar_drives.options import DriveOptions, build
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.importers.lidar_drives.drives import DriveFiles

__all__ = ["Options", "build"]


class Options(DriveOptions):
    """Options of ``relocbench build-dataset helipr``."""

    kind: ClassVar[str] = "helipr"

    lidars: tuple[str, ...] = Field((), description="lidars to use: Ouster, Velodyne, Aeva, Avia; default: two")
    odometry: Literal["lidar", "poses"] = Field(
        "lidar", description="motion of the car: computed from the scans, or from LiDAR_GT/NAME_gt.txt"
    )

    def read(self, folder: Path, name: str, reporter: Reporter) -> DriveFiles:
        from relocbench.datasets.importers.helipr.recording import read_helipr

        return read_helipr(folder, name, self.lidars, self.odometry, reporter)
