"""Kind ``helipr``: drives in the layout of the HeLiPR dataset, with ground truth across drives from their lidar."""

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
    """Options of ``relocbench build-dataset helipr``."""

    lidars: tuple[str, ...] = Field((), description="lidars to use: Ouster, Velodyne, Aeva, Avia; default: two")
    odometry: Literal["lidar", "poses"] = Field(
        "lidar", description="motion of the car: computed from the scans, or from LiDAR_GT/NAME_gt.txt"
    )


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference drive (the first source) and one or more query drives.

    Raises:
        DatasetError, ConfigError: like :func:`build_drives`.
    """
    from relocbench.datasets.importers.helipr.recording import read_helipr
    from relocbench.datasets.importers.lidar_drives.building import build_drives
    from relocbench.datasets.importers.lidar_drives.drives import DriveFiles

    assert isinstance(options, Options)
    lidars, odometry = options.lidars, options.odometry

    def read(folder: Path, name: str) -> DriveFiles:
        return read_helipr(folder, name, lidars, odometry)

    return build_drives("helipr", sources, options, out, reporter, run, read)
