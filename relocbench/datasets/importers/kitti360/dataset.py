"""Kind ``kitti-360``: sequences in the layout of KITTI-360, with ground truth across sequences from their lidar."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field, field_validator

from relocbench.datasets.core.build_options import ImportOptions, LinkingOptions
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.importers.assembly import check_folder
from relocbench.errors import ConfigError
from relocbench.execution import Run
from relocbench.files import check_name
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset


class Options(FieldOptions, LinkingOptions):
    """Options of ``relocbench build-dataset kitti-360``."""

    sequence: tuple[str, ...] = Field(
        (), description="two or more sequences, such as 0000,0002: the reference first, then the queries"
    )
    odometry: Literal["lidar", "poses"] = Field(
        "lidar", description="motion of the car: computed from the scans, or from data_poses/DRIVE/poses.txt"
    )

    @field_validator("sequence")
    @classmethod
    def _each_once(cls, sequence: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(sequence)) != len(sequence):
            raise ValueError("names a sequence twice")
        return tuple(check_name(name, "sequence") for name in sequence)


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference sequence and one or more query sequences.

    Raises:
        DatasetError: with file and line: something in a sequence is missing or wrong, or no pair can be accepted.
        ConfigError: the options do not fit the recordings.
    """
    from relocbench.datasets.importers.kitti360.recording import drive_name, read_kitti360
    from relocbench.datasets.importers.lidar_drives.building import build_from

    assert isinstance(options, Options)
    if len(sources) != 1:
        raise ConfigError(f"kitti-360 takes one folder with data_3d_raw in it, got {len(sources)}; see --sequence")
    check_folder(sources[0], "KITTI-360 (calibration, data_3d_raw)")
    if len(options.sequence) < 2:
        raise ConfigError("--sequence: ground truth across drives needs two or more sequences, such as 0000,0002")
    names = [f"kitti360_{sequence}" for sequence in options.sequence]
    options.check_conditions(names)
    for sequence in options.sequence:
        check_folder(sources[0] / "data_3d_raw" / drive_name(sequence), "a sequence of KITTI-360")
    drives = [
        read_kitti360(sources[0], sequence, name, options.odometry)
        for sequence, name in zip(options.sequence, names, strict=True)
    ]
    return build_from(drives, "kitti-360", sources, options, out, reporter, run)
