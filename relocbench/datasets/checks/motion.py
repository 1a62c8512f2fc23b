"""Validation of motion: poses of a traversal that no drive can have, pairs that step over them, and shared worlds."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from relocbench.datasets.checks.faults import Findings, read_pair_table
from relocbench.datasets.checks.pair_sets import CheckedTraversal
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.names import read_names
from relocbench.datasets.motion.judging import Motion, judge
from relocbench.datasets.motion.orientation import doubts_of_axes
from relocbench.datasets.motion.words import jump_words, outlier_words
from relocbench.datasets.motion.worlds import doubt_of_world
from relocbench.datasets.sensors.times import unit_of_dates
from relocbench.errors import DatasetError
from relocbench.files import read_csv


def check_motion(
    layout: DatasetLayout,
    drives: Mapping[str, CheckedTraversal],
    pair_sets: Collection[str],
    findings: Findings,
) -> None:
    """Check each traversal whose images have times, and each pair set within one or across two of these.

    Outlier poses are faults; jumps, pairs across jumps and holes, and doubts about rotations and worlds are notes.
    """
    ordered = {name: drive for name, drive in drives.items() if _has_times(drive)}
    motions = {name: _check_poses(drive, findings) for name, drive in ordered.items()}
    for pair_set in pair_sets:
        reference, query = (*pair_set.split("__"), "", "")[:2]
        if reference not in ordered or query not in ordered:
            continue
        if reference == query:
            _check_steps(layout, pair_set, ordered[reference], motions[reference], findings)
        elif doubt := doubt_of_world(drives[reference].poses, drives[query].poses, starts=False):
            findings.note(f"{reference} and {query} {doubt}", layout.pair_file(pair_set))


def _has_times(drive: CheckedTraversal) -> bool:
    """Whether times mean anything: images with names are a collection in no order."""
    try:
        return len(drive.poses) > 1 and not read_names(drive.layout.names)
    except DatasetError:
        return False


def _check_poses(drive: CheckedTraversal, findings: Findings) -> Motion:
    times, T_world_rig = np.array(list(drive.poses), dtype=np.int64), np.array(list(drive.poses.values()))
    # Pairs that were made elsewhere keep their times as they stand, which may be microseconds.
    motion, path = judge(times * (unit_of_dates(drive.poses) or 1), T_world_rig), drive.layout.poses
    if motion.hopeless:
        findings.fault(motion.hopeless, path)
        return motion
    if motion.outliers or motion.jumps:
        line_of = {row[0]: line for line, row in read_csv(path, "poses", DatasetError) if row}
        lines = [line_of.get(str(time)) for time in times.tolist()]
        for one in motion.outliers:
            findings.fault(outlier_words(one, lambda row: f"line {lines[row]}"), path, lines[one.first])
        for jump in motion.jumps:
            findings.note(jump_words(jump), path, lines[jump.index])
    for doubt in doubts_of_axes(times[motion.kept], T_world_rig[motion.kept]):
        findings.note(doubt, path)
    return motion


def _check_steps(
    layout: DatasetLayout,
    pair_set: str,
    drive: CheckedTraversal,
    motion: Motion,
    findings: Findings,
) -> None:
    """Note pairs by the step rule that lie across a jump or a hole."""
    table = layout.pair_table(pair_set)
    if not motion.breaks or not table.exists():
        return
    after = np.array(list(drive.poses), dtype=np.int64)[list(motion.breaks)]
    for (ref, query), row in read_pair_table(table, Findings()).items():
        first, last = min(ref, query), max(ref, query)
        if row.group.startswith("step_") and bool(((after > first) & (after <= last)).any()):
            message = f"the pair lies across a jump or a hole of the poses, in {(last - first) / 1e9:.3g} s"
            findings.note(message, table, row.line)
