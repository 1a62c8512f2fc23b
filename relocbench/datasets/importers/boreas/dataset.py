"""Kind ``boreas``: drives in the layout of the Boreas dataset, with ground truth across drives from their lidar."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from relocbench.datasets.core.build_options import LinkingOptions
from relocbench.datasets.importers.lidar_drives.options import DriveOptions, build
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.importers.lidar_drives.drives import DriveFiles

__all__ = ["Options", "build"]


class Options(DriveOptions, LinkingOptions):
    """Options of ``relocbench build-dataset boreas``."""

    kind: ClassVar[str] = "boreas"

    odometry: Literal["auto", "applanix", "lidar-poses", "lidar"] = Field(
        "auto",
        description="motion of the car: applanix/gps_post_process.csv, applanix/lidar_poses.csv, or computed from the "
        "scans; default: the first of these that there is",
    )

    def read(self, folder: Path, name: str, reporter: Reporter) -> DriveFiles:
        from relocbench.datasets.importers.boreas.recording import read_boreas

        return read_boreas(folder, name, self.odometry, reporter)
