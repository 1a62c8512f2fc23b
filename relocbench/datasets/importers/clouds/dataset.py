"""Kind ``clouds``: folders of point clouds with times, with ground truth across drives from them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field, field_validator

from relocbench.datasets.core.build_options import ImportOptions, LinkingOptions
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.execution import Run
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset


class Options(FieldOptions, LinkingOptions):
    """Options of ``relocbench build-dataset clouds``."""

    odometry: Literal["auto", "poses", "lidar"] = Field(
        "auto", description="motion of the lidar: from poses.txt, or by registering the clouds; default: poses if there"
    )
    motion: Literal["auto", "compensated", "distorted"] = Field(
        "auto", description="whether clouds without times of points are motion-compensated; auto: told from the clouds"
    )
    pattern: Literal["spinning", "push-broom"] = Field("spinning", description="how the lidar scans")
    columns: tuple[str, ...] = Field((), description="columns of .bin and plain .npy files; default: found")
    rate_hz: float | None = Field(None, gt=0, description="clouds a second, if they are numbered and have no times")
    max_range: float = Field(100.0, gt=1, description="metres; farther points are left out")

    @field_validator("columns")
    @classmethod
    def _has_axes(cls, columns: tuple[str, ...]) -> tuple[str, ...]:
        if columns and (not set("xyz") <= set(columns) or len(set(columns)) != len(columns)):
            raise ValueError("must contain x, y and z, and each once")
        return columns


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference drive (the first source) and one or more query drives.

    Raises:
        DatasetError, ConfigError: like :func:`build_drives`.
    """
    from relocbench.datasets.importers.clouds.recording import read_clouds
    from relocbench.datasets.importers.lidar_drives.building import build_drives
    from relocbench.datasets.importers.lidar_drives.drives import DriveFiles

    assert isinstance(options, Options)
    chosen = options

    def read(folder: Path, name: str) -> DriveFiles:
        return read_clouds(
            folder,
            name,
            reporter,
            odometry=chosen.odometry,
            motion=chosen.motion,
            columns=chosen.columns,
            rate_hz=chosen.rate_hz,
            pattern=chosen.pattern,
            max_range=chosen.max_range,
        )

    return build_drives("clouds", sources, options, out, reporter, run, read)
