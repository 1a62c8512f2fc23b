"""Simulated recordings of several drives in the layout of a real data set.

There is one drive per split, condition, route and traversal. ``OUT/recording.yaml`` holds the configuration, and
``OUT/drives.csv``, which is written last, describes each drive. Importers need neither.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.datasets.core.recording_folder import RecordedDrive, RecordingFolder
from relocbench.datasets.core.writer import check_same_options
from relocbench.datasets.synthetic.conditions.condition import NamedCondition
from relocbench.datasets.synthetic.drives.routes import route
from relocbench.datasets.synthetic.jobs.plan import AskedDrive, AskedDrives
from relocbench.datasets.synthetic.jobs.recording import DriveOptions, prepare
from relocbench.datasets.synthetic.jobs.recording_jobs import DriveJob, carry_out
from relocbench.datasets.synthetic.layouts.recorded import Layout, TrueTrajectory
from relocbench.datasets.synthetic.town.network import Path as Route
from relocbench.datasets.synthetic.town.town import District, make_district
from relocbench.errors import DatasetError
from relocbench.execution import Run
from relocbench.files import dump_yaml, locked_output, parse_yaml, write_table, write_text
from relocbench.progress import Reporter

_CONFIGURATION = "recording.yaml"
_DRIVES = "drives.csv"


@dataclass(frozen=True, eq=False)
class PlannedDrive:
    """One drive, before it is recorded."""

    asked: AskedDrive
    number: int
    """number among all drives of the folder"""
    district: District
    path: Route


def plan_drives(asked: AskedDrives, length_m: float, extent_m: float, reporter: Reporter) -> list[PlannedDrive]:
    """Plan the drives, ordered by split, condition, route and traversal.

    Raises:
        ConfigError: a district has no such route of this length.
    """
    drives: list[PlannedDrive] = []
    with reporter.stage("laying out districts", len(asked.splits)) as advance:
        for split in asked.splits:
            town = make_district(asked.seed, split, extent_m)
            paths = {r: route(town.network, town.periodic.street, r, length_m, asked.seed) for r in asked.routes}
            for one in asked.of(split):
                drives.append(PlannedDrive(one, len(drives), town, paths[one.route]))
            advance(1)
    return drives


def record_all(
    drives: Sequence[PlannedDrive],
    conditions: Mapping[str, NamedCondition],
    options: DriveOptions,
    out: Path,
    configuration: Mapping[str, Any],
    reporter: Reporter,
    run: Run,
) -> RecordingFolder:
    """Record drives into a folder. A repeated call does only what is missing.

    Args:
        options: options of all drives; each gets its own ``number``.
        configuration: everything that determines the bytes, as plain values.

    Raises:
        ConfigError: the options are invalid; nothing is written.
        DatasetError: the folder holds something else, or another process is writing to it.
    """
    options.target(out)  # validates the options before anything is written
    with locked_output(out, DatasetError):
        check_folder(out, configuration)
        write_text(out / _CONFIGURATION, dump_yaml(dict(configuration)))
        jobs: list[DriveJob] = []
        rows: list[RecordedDrive] = []
        with reporter.stage("planning drives", len(drives)) as advance:
            for drive in drives:
                asked = drive.asked
                factors = conditions[asked.condition].factors
                recorded, job = prepare(drive.district, drive.path, factors, out, replace(options, number=drive.number))
                jobs.append(job)
                layout = job.drive.layout
                rows.append(
                    RecordedDrive(
                        recorded.name,
                        str(recorded.folder.relative_to(out.resolve())),
                        asked.split,
                        asked.condition,
                        asked.route,
                        asked.traversal,
                        sum(len(layout.times[name]) for name in layout.cameras),
                        sum(len(layout.times[name]) for name in layout.lidars),
                        round(driven_m(job.drive.trajectory, layout), 1),
                    )
                )
                advance(1)
        carry_out(jobs, reporter, run)
        columns = [field.name for field in fields(RecordedDrive)]
        write_table(out / _DRIVES, columns, (asdict(row).values() for row in rows))
    return RecordingFolder(out, options.layout, rows)


def driven_m(trajectory: TrueTrajectory, layout: Layout) -> float:
    """Metres driven between a drive's first and last image or scan."""
    times = np.concatenate(list(layout.times.values()))
    during = (trajectory.times_ns >= times.min()) & (trajectory.times_ns <= times.max())
    steps = np.diff(trajectory.T_world_rig[during, :3, 3], axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())


def check_folder(out: Path, configuration: Mapping[str, Any]) -> None:
    """Raise DatasetError if the folder holds something other than this recording."""
    mark = out / _CONFIGURATION
    if out.exists() and not out.is_dir():
        raise DatasetError("is a file; expected a folder to record to", out)
    if not out.is_dir() or not any(p != mark for p in out.iterdir()):
        return
    if not mark.exists():
        raise DatasetError("holds something else; --out must be new, empty, or an unfinished recording", out)
    check_same_options(mark, parse_yaml(dump_yaml(dict(configuration))), "a recording", "drives recorded")
