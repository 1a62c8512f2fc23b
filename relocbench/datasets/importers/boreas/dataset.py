"""Kind ``boreas``: drives in the layout of the Boreas dataset, with ground truth across drives from their lidar."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from relocbench.datasets.core.build_options import ImportOptions, LinkingOptions
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.execution import Run
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset


class Options(FieldOptions, LinkingOptions):
    """Options of ``relocbench build-dataset boreas``."""

    odometry: Literal["auto", "applanix", "lidar-poses", "lidar"] = Field(
        "auto",
        description="motion of the car: applanix/gps_post_process.csv, applanix/lidar_poses.csv, or computed from the "
        "scans; default: the first of these that there is",
    )


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference drive (the first source) and one or more query drives.

    Raises:
        DatasetError, ConfigError: like :func:`build_drives`.
    """
    from relocbench.datasets.importers.boreas.recording import read_boreas
    from relocbench.datasets.importers.lidar_drives.building import build_drives

    assert isinstance(options, Options)
    odometry = options.odometry
    return build_drives(
        "boreas", sources, options, out, reporter, run, lambda folder, name: read_boreas(folder, name, odometry)
    )
