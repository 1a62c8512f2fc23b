"""The options of importers of published lidar datasets, which also read one drive, and the build by them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.execution import Run
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.importers.lidar_drives.drives import DriveFiles


class DriveOptions(FieldOptions):
    """Options of a kind of ``relocbench build-dataset`` whose sources are the folders of drives."""

    kind: ClassVar[str]

    def read(self, folder: Path, name: str, reporter: Reporter) -> DriveFiles:
        """The files of the drive in a folder, by the name that it gets. Raises DatasetError, ConfigError."""
        raise NotImplementedError


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference drive (the first source) and one or more query drives.

    Raises:
        DatasetError, ConfigError: like :func:`build_drives`.
    """
    from relocbench.datasets.importers.lidar_drives.building import build_drives

    assert isinstance(options, DriveOptions)
    return build_drives(options.kind, sources, options, out, reporter, run, options.read)
