"""The poses of a drive without those that it cannot have had: outliers are left out, and jumps and holes are marked.

Every door whose poses are those of a drive passes here; unordered photographs have no motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from relocbench.datasets.motion.judging import Motion, judge
from relocbench.datasets.motion.orientation import doubts_of_axes
from relocbench.datasets.motion.outliers import Outlier
from relocbench.datasets.sensors.pose_tables import PoseTable, short_name
from relocbench.errors import DatasetError
from relocbench.progress import Reporter, Silent

_NAMED = 3
"""outliers that are named one by one"""


def plausible(
    table: PoseTable,
    reporter: Reporter | None = None,
    *,
    jumps: bool = True,
    holes: bool = True,
    axes: bool = True,
) -> PoseTable:
    """The table without outlier poses, which are named, and with breaks where nobody knows the way.

    Args:
        jumps: tell of jumps, and break the drive there; others judge them.
        holes: break the drive at holes.
        axes: tell of doubtful rotations.

    Raises:
        DatasetError: the poses cannot be those of one drive.
    """
    report = reporter or Silent()
    motion = judge(table.times_ns, table.transforms)
    if motion.hopeless:
        raise DatasetError(motion.hopeless, table.path)
    motion = replace(motion, jumps=motion.jumps if jumps else (), holes=motion.holes if holes else ())
    for message in _messages(table, motion):
        report.note(message)
    kept = np.flatnonzero(motion.kept)
    out = PoseTable(
        table.path,
        table.times_ns[kept],
        table.transforms[kept],
        [table.lines[row] for row in kept.tolist()] if len(table.lines) else (),
        tuple(np.searchsorted(kept, motion.breaks).tolist()),
    )
    for doubt in doubts_of_axes(out.times_ns, out.transforms) if axes else ():
        report.note(f"{short_name(table.path)}: {doubt}")
    return out


def _messages(table: PoseTable, motion: Motion) -> Sequence[str]:
    """What is implausible, a line each."""
    lines = [_outlier(table, one) for one in motion.outliers[:_NAMED]]
    if more := motion.outliers[_NAMED:]:
        count = sum(one.last - one.first + 1 for one in more)
        lines.append(f"{short_name(table.path)}: {count} more poses, in {len(more)} places, are as far off; left out")
    if motion.jumps:
        worst = max(motion.jumps, key=lambda jump: jump.metres)
        steps = f"{len(motion.jumps)} of its {motion.count - 1} steps, most" if len(motion.jumps) > 1 else "one step,"
        seconds = (table.times_ns[worst.index] - table.times_ns[worst.index - 1]) / 1e9
        lines.append(
            f"{_place(table, worst.index)}: the poses jump in {steps} by {distance(worst.metres)} and "
            f"{worst.degrees:.1f} deg within {seconds:.3g} s here; nothing is interpolated there"
        )
    return lines


def _outlier(table: PoseTable, one: Outlier) -> str:
    count = one.last - one.first + 1
    poses = "this pose is" if count == 1 else f"{count} poses, to {_row(table, one.last)}, are"
    ends = [_row(table, row) for row in (one.before, one.after) if row is not None]
    way = f"the way between those of {' and '.join(ends)}" if len(ends) == 2 else f"the way from that of {ends[0]}"
    angle = f" and {one.degrees:.0f} deg" if one.degrees >= 1 else ""
    left_out = "it is left out" if count == 1 else "they are left out"
    return f"{_place(table, one.first)}: {poses} {distance(one.metres)}{angle} off {way}; {left_out}"


def _place(table: PoseTable, row: int) -> str:
    name = short_name(table.path)
    return f"{name}:{table.lines[row]}" if len(table.lines) else f"{name}, {table.times_ns[row]} ns"


def _row(table: PoseTable, row: int) -> str:
    return f"line {table.lines[row]}" if len(table.lines) else f"{table.times_ns[row]} ns"


def distance(metres: float) -> str:
    """Metres, or kilometres, with three digits."""
    return f"{metres / 1000:,.0f} km" if metres >= 10_000 else f"{metres:.3g} m"
