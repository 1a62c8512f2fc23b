"""Kind ``nclt``: drives in the layout of the NCLT dataset, with ground truth across drives from their lidar."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.execution import Run
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset


class Options(FieldOptions):
    """Options of ``relocbench build-dataset nclt``."""

    odometry: Literal["lidar", "wheels", "poses"] = Field(
        "lidar",
        description="motion of the robot: computed from the scans, odometry_mu_100hz.csv, or groundtruth_DATE.csv",
    )
    camera_parameters: Path | None = Field(
        None, description="folder of K_camN.csv, x_lb3_cN.csv and U2D_CamN_*.txt; default: cam_params beside the drives"
    )


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference drive (the first source) and one or more query drives.

    Raises:
        DatasetError, ConfigError: like :func:`build_drives`.
    """
    from relocbench.datasets.importers.lidar_drives.building import build_drives
    from relocbench.datasets.importers.lidar_drives.drives import DriveFiles
    from relocbench.datasets.importers.nclt.recording import read_nclt

    assert isinstance(options, Options)
    odometry, parameters = options.odometry, options.camera_parameters

    def read(folder: Path, name: str) -> DriveFiles:
        return read_nclt(folder, name, odometry, parameters)

    return build_drives("nclt", sources, options, out, reporter, run, read)
