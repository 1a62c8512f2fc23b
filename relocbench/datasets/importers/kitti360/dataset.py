"""Kind ``kitti-360``: sequences in the layout of KITTI-360, with ground truth across sequences from their lidar."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.importers.assembly import check_folder
from relocbench.datasets.importers.lidar_drives.options import SequenceOptions
from relocbench.execution import Run
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset


class Options(SequenceOptions):
    """Options of ``relocbench build-dataset kitti-360``."""

    odometry: Literal["lidar", "poses"] = Field(
        "lidar", description="motion of the car: computed from the scans, or from data_poses/DRIVE/poses.txt"
    )


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference sequence and one or more query sequences. Raises as :class:`Importer`."""
    from relocbench.datasets.importers.kitti360.recording import drive_name, read_kitti360
    from relocbench.datasets.importers.lidar_drives.building import build_from

    assert isinstance(options, Options)
    root = options.check_source("kitti-360", sources, "KITTI-360 (calibration, data_3d_raw)")
    names = [f"kitti360_{sequence}" for sequence in options.sequence]
    options.check_conditions(names)
    for sequence in options.sequence:
        check_folder(root / "data_3d_raw" / drive_name(sequence), "a sequence of KITTI-360")
    drives = [
        read_kitti360(root, sequence, name, options.odometry, reporter)
        for sequence, name in zip(options.sequence, names, strict=True)
    ]
    return build_from(drives, "kitti-360", sources, options, out, reporter, run)
