"""Whether the poses of one drive are plausible, by its own motion and by limits of anything that carries a sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Mask, Times
from relocbench.datasets.motion.holes import Hole, find_holes
from relocbench.datasets.motion.jumps import Jump, steps_beside
from relocbench.datasets.motion.outliers import FASTEST, Outlier, sort_out

_LARGEST_M = 1e12
"""farther away, products overflow"""
_COUNTER_NS = 1e5
"""times that are closer are numbers of frames: a second for each is reckoned with, more than is usual"""
_CONTRADICT = 0.2
"""share of the steps that are jumps above which the drive is none: systems that lose track do so less often"""
_SCATTER_M = (0.1, 5.0)
_SCATTER = (100.0, 1000.0)
"""Where rows are in a wrong order, most steps differ from those beside them by more than 100 m/s^2, and by more than
5 m, which is more than the noise of GNSS, or more than 0.1 m and 1000 m/s^2: motion capture at 1 kHz has such
accelerations by noise of 1 mm"""


@dataclass(frozen=True)
class Motion:
    """What is implausible about the poses of a drive, by their rows."""

    count: int
    """number of the poses"""
    outliers: tuple[Outlier, ...] = ()
    jumps: tuple[Jump, ...] = ()
    """whose both sides stay"""
    holes: tuple[Hole, ...] = ()
    """between poses that are no outliers"""
    hopeless: str = ""
    """why the poses cannot be those of a drive at all; empty if they can"""

    @property
    def kept(self) -> Mask:
        """(N,) which poses are no outliers."""
        kept = np.ones(self.count, dtype=np.bool_)
        for one in self.outliers:
            kept[one.first : one.last + 1] = False
        return kept

    @property
    def breaks(self) -> tuple[int, ...]:
        """Rows of poses that are reached by a jump, or across a hole or an outlier: nothing is known before them."""
        rows = {jump.index for jump in self.jumps} | {hole.index for hole in self.holes}
        return tuple(sorted(rows | {one.after for one in self.outliers if one.before is not None and one.after}))


def judge(times_ns: Times, T_world_rig: Array) -> Motion:
    """What is implausible about the poses of one drive.

    Args:
        times_ns: (N,) strictly increasing; numbers of frames if they are closer than 0.1 ms.
        T_world_rig: (N, 4, 4)
    """
    count = len(times_ns)
    if count < 2:
        return Motion(count)
    timed = float(np.median(np.diff(times_ns))) >= _COUNTER_NS
    times = times_ns if timed else np.arange(count, dtype=np.int64) * 1_000_000_000
    T = T_world_rig.copy()
    T[:, :3, 3] = np.clip(T[:, :3, 3], -_LARGEST_M, _LARGEST_M)
    if timed and (hopeless := _why_hopeless(times, T)):
        return Motion(count, hopeless=hopeless)
    outliers, jumps = sort_out(times, T)
    motion = Motion(count, outliers, jumps)
    rows = np.flatnonzero(motion.kept)
    if 2 * len(rows) < count or len(jumps) > max(3.0, _CONTRADICT * len(rows)):
        message = (
            f"has {count} poses that are not those of one drive: {len(jumps)} jumps, and {count - len(rows)} poses"
        )
        return Motion(count, hopeless=f"{message} beside the others")
    # Across a jump or an outlier nothing is known anyway.
    known = set(motion.breaks)
    holes = [Hole(int(rows[h.index]), h.seconds, h.metres, h.usual_s) for h in find_holes(times[rows], T[rows])]
    return Motion(count, outliers, jumps, tuple(h for h in holes if h.index not in known))


def _why_hopeless(times_ns: Times, T: Array) -> str:
    """Why most of the poses cannot be those of a drive; empty if they can."""
    if len(times_ns) < 3:
        return ""
    seconds = np.diff(times_ns) / 1e9
    speed = float(np.median(np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1) / seconds))
    if speed > FASTEST[1]:
        return (
            f"moves at {speed:.4g} m/s in the median, faster than sound: expected positions in metres, at right times"
        )
    off = steps_beside(times_ns, T)
    least = np.maximum(_SCATTER[0] * seconds**2, np.clip(_SCATTER[1] * seconds**2, *_SCATTER_M))
    if float(np.mean(off > least)) > 0.5:
        return (
            f"goes to and fro by {float(np.median(off)):.3g} m in most of its {len(seconds)} steps: are poses in "
            "a wrong order, joined to times of others, or of several drives that are mixed?"
        )
    return ""
