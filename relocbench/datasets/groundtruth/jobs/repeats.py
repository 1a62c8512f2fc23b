"""Scans that repeat another one: a driver that sends its buffer again, or a lidar that has stopped, under new times.

What is measured is never the same twice to the last bit, since ranges are noisy, unless a simulated car without noise
stands. Repeated scans say that the car had moved where it had not, or the other way round; which of them has the right
time is not known from the scans.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.odometry.deferred import is_pending
from relocbench.datasets.sensors.recording import FieldRecording, LidarStream
from relocbench.errors import DatasetError

_PLACES = (0.0, 0.5, 1.0)
"""where along a drive scans are looked at, as shares of those that can be the first"""
_IN_A_ROW = 32
"""scans that are looked at in each place"""
_FEWEST_POINTS = 20
"""scans of fewer points may be alike"""
_STANDS_M = 0.02
"""least way of the car between two scans that must differ"""
_STOPS = 2 * len(_PLACES)
"""where the motion is not known yet, so many scans at most may be repeated because the car stands"""
_SHARE = 0.1
"""share of repeated scans from which on a recording is refused; single ones are left out of the blocks"""


@dataclass(frozen=True)
class _Repeat:
    index: int
    first: int
    """the scan that it repeats"""


def repeat_faults(recording: FieldRecording, lidar: LidarStream) -> list[DatasetError]:
    """The fault of a lidar of whose scans many repeat another one, while the car moves.

    Raises:
        DatasetError: a scan is damaged.
    """
    count = len(lidar.times_ns)
    starts = {round(place * max(count - _IN_A_ROW, 0)) for place in _PLACES}
    looked_at = sorted({row for start in starts for row in range(start, min(start + _IN_A_ROW, count))})
    first_of: dict[bytes, int] = {}
    repeats = []
    for index in looked_at:
        points = lidar.read(index).points
        if len(points) >= _FEWEST_POINTS:
            first = first_of.setdefault(np.ascontiguousarray(points).tobytes(), index)
            if first != index:
                repeats.append(_Repeat(index, first))
    repeats = _while_moving(recording, lidar, repeats, len(first_of))
    if len(repeats) < _SHARE * len(looked_at):
        return []
    one = repeats[0]
    first, again = (int(lidar.times_ns[row]) for row in (one.first, one.index))
    message = (
        f"{lidar.name} repeats itself: {len(repeats)} of {len(looked_at)} scans have the very points of an earlier "
        f"one, as scan {one.index} at {again} ns has those of scan {one.first} at {first} ns; expected scans that were "
        "each measured at their own time"
    )
    if len(first_of) == 1:
        message += "; the lidar measured nothing new during the whole drive"
    return [DatasetError(message, recording.folder)]


def _while_moving(
    recording: FieldRecording, lidar: LidarStream, repeats: Sequence[_Repeat], different: int
) -> list[_Repeat]:
    """Those between which the car moved: what is simulated without noise is the same while it stands.

    Args:
        different: number of different scans that were looked at.
    """
    if not repeats:
        return []
    if is_pending(recording):
        stops = different > 1 and len({one.first for one in repeats}) <= _STOPS
        return [] if stops else list(repeats)
    odometry = recording.odometry
    pairs = lidar.times_ns[[(one.first, one.index) for one in repeats]]
    known = odometry.covers(pairs.ravel()).reshape(pairs.shape).all(axis=1)
    moved = np.zeros(len(repeats))
    positions: Array = odometry.at(pairs[known].ravel())[:, :3, 3].reshape(-1, 2, 3)
    moved[known] = np.linalg.norm(positions[:, 1] - positions[:, 0], axis=1)
    return [one for one, metres in zip(repeats, moved, strict=True) if metres > _STANDS_M]
