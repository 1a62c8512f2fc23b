"""Kind ``mulran``: drives in the layout of the MulRan dataset, with ground truth across drives from their lidar."""

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
    """Options of ``relocbench build-dataset mulran``."""

    kind: ClassVar[str] = "mulran"

    odometry: Literal["lidar", "poses"] = Field(
        "lidar", description="motion of the car: computed from the scans, or from global_pose.csv"
    )
    scan_time: Literal["start", "middle", "end"] = Field(
        "start",
        description="moment of a turn of the lidar that the names of scans state; not documented by the dataset",
    )

    def read(self, folder: Path, name: str, reporter: Reporter) -> DriveFiles:
        from relocbench.datasets.importers.mulran.recording import read_mulran

        return read_mulran(folder, name, self.odometry, self.scan_time, reporter)
