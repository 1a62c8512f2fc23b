"""Registration of all query drives against the reference by worker processes, with the results kept on disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from relocbench.datasets.groundtruth.alignment.two_drives import (
    AlignmentOptions,
    FirstPose,
    RegistrationUnit,
    register_query,
)
from relocbench.datasets.groundtruth.registration import files as track_files
from relocbench.datasets.groundtruth.registration.journal import Journal, journal_progress
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.execution import Run, run_units
from relocbench.progress import Reporter


@dataclass(frozen=True, eq=False)
class _Unit:
    drives: RegistrationUnit
    journal: Path

    def __str__(self) -> str:
        return str(self.drives)


def register_drives(
    reference: Drive,
    queries: Sequence[Drive],
    folder: Path,
    options: AlignmentOptions,
    first: FirstPose | None,
    reporter: Reporter,
    run: Run,
) -> dict[str, list[Registration]]:
    """Register each query drive; the registrations of an earlier run are read from disk.

    ``folder`` holds ``REF__QUERY.csv`` for drives that are complete and ``REF__QUERY.journal`` for those that are not.

    Returns:
        name of the query drive -> its registrations.
    """
    folder = folder.resolve()  # workers of a cluster run in other working directories
    tables = {q.name: folder / f"{reference.name}__{q.name}.csv" for q in queries}
    found = {name: track_files.read_registrations(path) for name, path in tables.items() if path.exists()}
    units = [
        _Unit(RegistrationUnit(reference, q, options, _of(q, first)), tables[q.name].with_suffix(".journal"))
        for q in queries
        if q.name not in found
    ]
    steps = [unit.drives.steps for unit in units]
    with (
        reporter.stage("registering drives", sum(steps)) as advance,
        journal_progress([unit.journal for unit in units], steps, advance) as complete,
    ):
        for index, (registrations, messages) in run_units(_track, units, run):
            unit = units[index]
            query = unit.drives.query
            for message in messages:
                reporter.note(f"{query.name}: {message}")
            track_files.write_registrations(tables[query.name], registrations, reference.nodes, query.nodes)
            complete(index)
            unit.journal.unlink(missing_ok=True)
            # Always use the file, so that a fresh build and a resumed one use the same numbers.
            found[query.name] = track_files.read_registrations(tables[query.name])
    return found


def _of(query: Drive, first: FirstPose | None) -> FirstPose | None:
    """The pose given by hand, if its time lies in this drive."""
    times = query.recording.odometry.times_ns
    return first if first is not None and times[0] <= first[1] <= times[-1] else None


def _track(unit: _Unit) -> tuple[list[Registration], list[str]]:
    messages: list[str] = []
    journal = Journal(unit.journal)
    try:
        return register_query(unit.drives, messages.append, journal.remember), messages
    finally:
        journal.close()
