"""Kind ``complex-urban``: drives in the layout of the Complex Urban dataset, with ground truth from their lidars."""

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
    """Options of ``relocbench build-dataset complex-urban``."""

    lidars: tuple[str, ...] = Field(
        (), description="lidars to use: VLP_left, VLP_right, SICK_back, SICK_middle; default: both VLP"
    )
    odometry: Literal["lidar", "poses"] = Field(
        "lidar", description="motion of the car: computed from the scans, or from global_pose.csv"
    )


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference drive (the first source) and one or more query drives.

    Raises:
        DatasetError, ConfigError: like :func:`build_drives`.
    """
    from relocbench.datasets.importers.complex_urban.recording import read_complex_urban
    from relocbench.datasets.importers.lidar_drives.building import build_drives
    from relocbench.datasets.importers.lidar_drives.drives import DriveFiles

    assert isinstance(options, Options)
    lidars, odometry = options.lidars, options.odometry

    def read(folder: Path, name: str) -> DriveFiles:
        return read_complex_urban(folder, name, lidars, odometry)

    return build_drives("complex-urban", sources, options, out, reporter, run, read)
