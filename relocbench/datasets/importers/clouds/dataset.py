"""Kind ``clouds``: folders of point clouds with times, with ground truth across drives from them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field, field_validator

from relocbench.datasets.core.build_options import LinkingOptions
from relocbench.datasets.importers.lidar_drives.options import DriveOptions, build
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.importers.lidar_drives.drives import DriveFiles

__all__ = ["Options", "build"]


class Options(DriveOptions, LinkingOptions):
    """Options of ``relocbench build-dataset clouds``."""

    kind: ClassVar[str] = "clouds"

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

    def read(self, folder: Path, name: str, reporter: Reporter) -> DriveFiles:
        from relocbench.datasets.importers.clouds.recording import read_clouds

        return read_clouds(
            folder,
            name,
            reporter,
            odometry=self.odometry,
            motion=self.motion,
            columns=self.columns,
            rate_hz=self.rate_hz,
            pattern=self.pattern,
            max_range=self.max_range,
        )
