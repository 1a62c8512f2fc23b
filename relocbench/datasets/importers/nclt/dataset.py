"""Kind ``nclt``: drives in the layout of the NCLT dataset, with ground truth across drives from their lidar."""

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
    """Options of ``relocbench build-dataset nclt``."""

    kind: ClassVar[str] = "nclt"

    odometry: Literal["lidar", "wheels", "poses"] = Field(
        "lidar",
        description="motion of the robot: computed from the scans, odometry_mu_100hz.csv, or groundtruth_DATE.csv",
    )
    camera_parameters: Path | None = Field(
        None, description="folder of K_camN.csv, x_lb3_cN.csv and U2D_CamN_*.txt; default: cam_params beside the drives"
    )

    def read(self, folder: Path, name: str, reporter: Reporter) -> DriveFiles:
        from relocbench.datasets.importers.nclt.recording import read_nclt

        return read_nclt(folder, name, self.odometry, self.camera_parameters, reporter)
