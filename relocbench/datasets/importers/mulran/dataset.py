"""Kind ``mulran``: drives in the layout of the MulRan dataset, with ground truth across drives from their lidar."""

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
    """Options of ``relocbench build-dataset mulran``."""

    odometry: Literal["lidar", "poses"] = Field(
        "lidar", description="motion of the car: computed from the scans, or from global_pose.csv"
    )
    scan_time: Literal["start", "middle", "end"] = Field(
        "start",
        description="moment of a turn of the lidar that the names of scans state; not documented by the dataset",
    )


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference drive (the first source) and one or more query drives.

    Raises:
        DatasetError, ConfigError: like :func:`build_drives`.
    """
    from relocbench.datasets.importers.lidar_drives.building import build_drives
    from relocbench.datasets.importers.lidar_drives.drives import DriveFiles
    from relocbench.datasets.importers.mulran.recording import read_mulran

    assert isinstance(options, Options)
    odometry, scan_time = options.odometry, options.scan_time

    def read(folder: Path, name: str) -> DriveFiles:
        return read_mulran(folder, name, odometry, scan_time)

    return build_drives("mulran", sources, options, out, reporter, run, read)
