"""Kind ``complex-urban``: drives in the layout of the Complex Urban dataset, with ground truth from their lidars."""

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
    """Options of ``relocbench build-dataset complex-urban``."""

    kind: ClassVar[str] = "complex-urban"

    lidars: tuple[str, ...] = Field(
        (), description="lidars to use: VLP_left, VLP_right, SICK_back, SICK_middle; default: both VLP"
    )
    odometry: Literal["lidar", "poses"] = Field(
        "lidar", description="motion of the car: computed from the scans, or from global_pose.csv"
    )

    def read(self, folder: Path, name: str, reporter: Reporter) -> DriveFiles:
        from relocbench.datasets.importers.complex_urban.recording import read_complex_urban

        return read_complex_urban(folder, name, self.lidars, self.odometry, reporter)
