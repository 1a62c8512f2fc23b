"""The options of importers of published lidar datasets, which also read one drive, and the build by them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from pydantic import Field, field_validator

from relocbench.datasets.core.build_options import ImportOptions, LinkingOptions
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.importers.assembly import check_folder, check_several
from relocbench.datasets.sensors.trajectories import traversal_names
from relocbench.errors import ConfigError
from relocbench.execution import Run
from relocbench.files import check_name
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


class SequenceOptions(FieldOptions, LinkingOptions):
    """Options of a kind of ``relocbench build-dataset`` whose source is one folder of several sequences."""

    sequence: tuple[str, ...] = Field(
        (), description="two or more sequences, such as 00,01: the reference first, then the queries"
    )

    @field_validator("sequence")
    @classmethod
    def _each_once(cls, sequence: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(sequence)) != len(sequence):
            raise ValueError("names a sequence twice")
        return tuple(check_name(name, "sequence") for name in sequence)

    def check_source(self, kind: str, sources: Sequence[Path], expected: str) -> Path:
        """The folder with the sequences.

        Raises:
            ConfigError: there are several, or fewer than two sequences are named.
            DatasetError: it is not a folder.
        """
        if len(sources) != 1:
            raise ConfigError(f"{kind} takes one folder with all sequences, got {len(sources)}; see --sequence")
        check_folder(sources[0], expected)
        if len(self.sequence) < 2:
            raise ConfigError("--sequence: ground truth across drives needs two or more sequences, such as 00,01")
        return sources[0]


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference drive, the first source, and query drives. Raises as :class:`Importer`."""
    assert isinstance(options, DriveOptions)
    check_several(sources)
    for source in sources:
        check_folder(source, f"a drive in the layout of {options.kind}")
    from relocbench.datasets.importers.lidar_drives.building import build_from  # large

    names = traversal_names(sources)
    options.check_conditions(names)
    drives = [options.read(source, name, reporter) for source, name in zip(sources, names, strict=True)]
    return build_from(drives, options.kind, sources, options, out, reporter, run)
