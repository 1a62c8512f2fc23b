"""The poses of a drive without those that it cannot have had: outliers are left out, and jumps and holes are marked.

Every door whose poses are those of a drive passes here; unordered photographs have no motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from relocbench.datasets.motion.judging import Motion, judge
from relocbench.datasets.motion.orientation import doubts_of_axes
from relocbench.datasets.motion.words import hole_words, jump_words, outlier_words
from relocbench.datasets.sensors.pose_tables import PoseTable, short_name
from relocbench.errors import DatasetError
from relocbench.progress import SILENT, Reporter

_NAMED = 3
"""outliers, jumps and holes that are named one by one"""


def plausible(
    table: PoseTable,
    reporter: Reporter = SILENT,
    *,
    jumps: bool = True,
    holes: bool = True,
    axes: bool = True,
) -> PoseTable:
    """The table without outlier poses, which are named, and with breaks where nobody knows the way.

    Args:
        jumps: tell of jumps, and break the drive there; others judge them.
        holes: tell of holes, and break the drive there.
        axes: tell of doubtful rotations.

    Raises:
        DatasetError: the poses cannot be those of one drive.
    """
    motion = judge(table.times_ns, table.transforms)
    if motion.hopeless:
        raise DatasetError(motion.hopeless, table.path)
    motion = replace(motion, jumps=motion.jumps if jumps else (), holes=motion.holes if holes else ())
    for message in _messages(table, motion):
        reporter.note(message)
    kept = np.flatnonzero(motion.kept)
    out = PoseTable(
        table.path,
        table.times_ns[kept],
        table.transforms[kept],
        [table.lines[row] for row in kept.tolist()] if len(table.lines) else (),
        tuple(np.searchsorted(kept, motion.breaks).tolist()),
    )
    for doubt in doubts_of_axes(out.times_ns, out.transforms) if axes else ():
        reporter.note(f"{short_name(table.path)}: {doubt}")
    return out


def _messages(table: PoseTable, motion: Motion) -> Iterator[str]:
    """What is implausible, a line each: of each kind the first outliers, and the largest jumps and holes."""
    row = partial(_row, table)
    outliers = [(one.first, f"{outlier_words(one, row)}; left out") for one in motion.outliers]
    jumps = [(one.index, jump_words(one)) for one in sorted(motion.jumps, key=lambda jump: -jump.metres)]
    holes = [(one.index, hole_words(one)) for one in sorted(motion.holes, key=lambda hole: -hole.seconds)]
    for kind, found in (("outliers", outliers), ("jumps", jumps), ("holes", holes)):
        for at, words in found[:_NAMED]:
            yield f"{_place(table, at)}: {words}{'' if kind == 'outliers' else '; nothing is interpolated there'}"
        if more := found[_NAMED:]:
            yield f"{short_name(table.path)}: {len(more)} more {kind} of the poses, the first at {row(min(more)[0])}"


def _place(table: PoseTable, row: int) -> str:
    name = short_name(table.path)
    return f"{name}:{table.lines[row]}" if len(table.lines) else f"{name}, {table.times_ns[row]} ns"


def _row(table: PoseTable, row: int) -> str:
    return f"line {table.lines[row]}" if len(table.lines) else f"{table.times_ns[row]} ns"
