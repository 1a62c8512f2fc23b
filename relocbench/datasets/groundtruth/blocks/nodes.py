"""Nodes at equal arc length along a drive, whatever its speed and however long it stood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Indices, Mask, Times
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.sensors.recording import FieldRecording, Trajectory
from relocbench.errors import ConfigError, DatasetError
from relocbench.kernels import njit

_ANCHOR_M = 0.25
"""arc length is measured between anchor poses so far apart, so that it does not grow by the odometry's noise while the
car stands"""


@dataclass(frozen=True, eq=False)
class ArcLength:
    """Metres driven up to each time of a drive."""

    times_ns: Times
    """(N,)"""
    travelled_m: Array
    """(N,) metres, never decreasing; constant while the car stands and across gaps of the odometry"""
    segment: Indices
    """(N,) number of the segment, a part of the odometry without a gap, that each time lies in"""

    def at(self, times_ns: Times) -> Array:
        """(M,) metres driven up to each time; times before and after the drive get the values of its ends."""
        if not len(self.times_ns):
            return np.zeros(len(times_ns))
        origin = self.times_ns[0]
        out: Array = np.interp((times_ns - origin) / 1e9, (self.times_ns - origin) / 1e9, self.travelled_m)
        return out


def make_nodes(recording: FieldRecording, block_m: float = 2.0) -> Nodes:
    """Cut a drive into blocks of equal arc length. A shorter rest at the end of a segment belongs to no block.

    Args:
        block_m: length of each block, metres.

    Raises:
        ConfigError: ``block_m`` is too small.
        DatasetError: the drive is shorter than a block, or odometry and lidars have no time in common.
    """
    if block_m < _ANCHOR_M:
        raise ConfigError(f"blocks are at least {_ANCHOR_M} m long, got {block_m} m")
    total = arc_length_along(recording)
    begin, middle, end, travelled, segment = [], [], [], [], []
    for number in np.unique(total.segment):
        mine = total.segment == number
        times, metres = total.times_ns[mine], total.travelled_m[mine]
        # The tolerance makes a segment of exactly n blocks give n in spite of rounding.
        count = int(np.floor((metres[-1] - metres[0]) / block_m + 1e-9))
        cuts = _times_at(times, metres, metres[0] + block_m * np.arange(count + 1))
        centres = metres[0] + block_m * (np.arange(count) + 0.5)
        begin.append(cuts[:-1])
        end.append(cuts[1:])
        middle.append(_times_at(times, metres, centres))
        travelled.append(centres)
        segment.append(np.full(count, number, dtype=np.int64))
    times_ns = np.concatenate(middle)
    if not len(times_ns):
        raise DatasetError(f"the drive is shorter than one block of {block_m} m", recording.folder)
    return Nodes(
        times_ns,
        recording.odometry.at(times_ns),
        np.concatenate(travelled),
        np.concatenate(segment),
        np.concatenate(begin),
        np.concatenate(end),
    )


def nearest_nodes(nodes: Nodes, odometry: Trajectory, times_ns: Times) -> Indices:
    """(M,) the node nearest to each time (M,), among those of its piece of the odometry; -1 if it has none.

    Across a gap or a break the odometry says nothing, however near a node is in time.
    """
    piece, own = odometry.pieces(times_ns), odometry.pieces(nodes.times_ns)
    out = np.full(len(times_ns), -1, dtype=np.int64)
    for number in np.unique(piece).tolist():
        members, of_piece = np.flatnonzero(own == number), piece == number
        if len(members):
            apart = np.abs(nodes.times_ns[members][None, :] - times_ns[of_piece][:, None])
            out[of_piece] = members[np.argmin(apart, axis=1)]
    return out


def arc_length_along(recording: FieldRecording) -> ArcLength:
    """Arc length driven while a lidar measured. Raises DatasetError if odometry and lidars have no time in common."""
    spans = [(int(lidar.times_ns[0]), int(lidar.times_ns[-1])) for lidar in recording.lidars if len(lidar.times_ns)]
    if not spans:
        raise DatasetError("has no lidar scans, which the ground truth is made from", recording.folder)
    odometry = recording.odometry
    first, last = min(s[0] for s in spans), max(s[1] for s in spans)
    between = odometry.times_ns[(odometry.times_ns > first) & (odometry.times_ns < last)]
    knots = np.unique(np.concatenate([[first], between, [last]]).astype(np.int64))
    knots = knots[odometry.covers(knots)]
    if not len(knots):
        raise DatasetError("the odometry covers no time at which a lidar measured", recording.folder)
    positions = odometry.at(knots)[:, :3, 3]
    starts = np.concatenate([[True], ~_joined(odometry, knots)])
    segment = np.cumsum(starts, dtype=np.int64) - 1
    return ArcLength(knots, _travelled(np.ascontiguousarray(positions), starts, _ANCHOR_M), segment)


def _joined(odometry: Trajectory, knots: Times) -> Mask:
    """(N - 1,) whether the odometry covers the time between neighbouring knots."""
    return odometry.covers(knots[:-1] + (knots[1:] - knots[:-1]) // 2)


@njit(cache=True, nogil=True, error_model="numpy")
def _travelled(positions: Array, starts: Mask, anchor_m: float) -> Array:
    """(N,) arc length along positions (N, 3).

    Between anchors, which are ``anchor_m`` apart, it grows by the motion in the direction of the next anchor.

    Args:
        starts: (N,) whether each position begins a new segment.
    """
    n = len(positions)
    total = np.zeros(n)
    anchor = 0
    for i in range(1, n):
        if starts[i]:
            for k in range(anchor + 1, i):
                total[k] = total[anchor]
            total[i] = total[anchor]
            anchor = i
            continue
        leg = positions[i] - positions[anchor]
        length = np.sqrt(np.sum(leg * leg))
        if length < anchor_m:
            continue
        for k in range(anchor + 1, i):
            come = np.sum((positions[k] - positions[anchor]) * leg) / length
            total[k] = max(total[k - 1], total[anchor] + min(max(come, 0.0), length))
        total[i] = total[anchor] + length
        anchor = i
    for k in range(anchor + 1, n):
        total[k] = total[anchor]
    return total


def _times_at(times_ns: Times, metres: Array, wanted: Array) -> Times:
    """(M,) times at which the arc lengths wanted (M,) were first reached."""
    right = np.clip(np.searchsorted(metres, wanted, side="left"), 0, len(metres) - 1)
    left = np.maximum(right - 1, 0)
    step = metres[right] - metres[left]
    share = np.where(step > 0, (wanted - metres[left]) / np.where(step > 0, step, 1.0), 1.0)
    spent = (times_ns[right] - times_ns[left]).astype(np.float64)
    return times_ns[left] + np.rint(np.clip(share, 0.0, 1.0) * spent).astype(np.int64)
