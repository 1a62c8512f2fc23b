"""The build of a dataset from drives of a published lidar dataset, which all their importers share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from relocbench.datasets.core.build import Build
from relocbench.datasets.groundtruth.jobs.build import build_ground_truth, check_recordings
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.groundtruth.odometry.deferred import later
from relocbench.datasets.importers.assembly import open_writer
from relocbench.datasets.importers.lidar_drives.drives import DriveFiles, on_one_map
from relocbench.execution import Run
from relocbench.files import fitting_name
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.core.writer import DatasetWriter


def build_from(
    drives: Sequence[DriveFiles],
    kind: str,
    sources: Sequence[Path],
    options: FieldOptions,
    out: Path,
    reporter: Reporter,
    run: Run,
    writer: DatasetWriter | None = None,
) -> Dataset:
    """Build a dataset from drives whose files but scans and images have been read, the reference first.

    All options are checked before odometry is computed from a lidar.

    Args:
        writer: that of the build; None: it is opened.

    Raises:
        DatasetError: with file and line: something in a recording is missing or wrong, or no pair can be accepted.
        ConfigError: the options do not fit the recordings.
    """
    check_recordings([drive.with_times_only() for drive in drives], options)
    if writer is None:
        writer = open_writer(kind, sources, options, out, fitting_name(f"{kind.replace('-', '_')}_{drives[0].name}"))
    # Odometry that is missing is computed by the build, after it has checked all drives.
    recordings = [drive.recording(later, reporter) for drive in on_one_map(drives, reporter)]
    return build_ground_truth(recordings, Build(writer, options, reporter, run))
