"""What the images of a drive share where its motion changes most: the tracks that tell the clock of its poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from relocbench.arrays import Array, Indices, Times
from relocbench.datasets.clock.offset import REACH_S, CameraMotion
from relocbench.datasets.clock.tracks import Tracks, features_of, match
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.sensors.recording import Trajectory

_WINDOW = 10
"""images in a row that are compared with each other"""
_WINDOWS = 12
_LAGS = (1, 2, 4, 7)
"""images apart of the pairs in a window"""
_FEWEST_IMAGES = 5
_LEAST_SIGNAL_PX = 1.0
"""pixels by which an offset of 0.1 s must move points, or the motion is too even to tell it"""
_FAR_M = 5.0
"""metres to what is seen, where nothing is known of depth"""


class Work(Protocol):
    """Does a step for each unit, in order, perhaps in parallel, with a title for the progress bar."""

    def __call__(
        self, title: str, step: Callable[[_Window], list[Tracks]], units: Sequence[_Window]
    ) -> list[list[Tracks]]: ...


@dataclass(frozen=True, eq=False)
class _Window:
    """Images in a row, whose pairs are matched."""

    traversal: Traversal
    camera: str
    times_ns: tuple[int, ...]
    first: int
    """number of its first image among all that are used"""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What images of a drive share."""

    camera: str
    fx: float
    T_rig_cam: Array
    times_ns: Times
    """(F,) of the images"""
    parts: Indices
    """(F,) the part of the drive that each image belongs to"""
    tracks: tuple[Tracks, ...]


def own_trajectory(traversal: Traversal) -> Trajectory:
    """The poses of a dataset's drive as a trajectory."""
    times: Times = np.array(list(traversal.poses), dtype=np.int64)
    return Trajectory(times, np.array(list(traversal.poses.values())).reshape(-1, 4, 4))


def gather(traversal: Traversal, camera: str, trajectory: Trajectory, work: Work) -> Evidence | str:
    """Match images where the poses say that motion changes most; why that tells nothing, where it does not.

    Raises:
        DatasetError: an image or a depth image is damaged.
    """
    times = np.array(traversal.timestamps(camera), dtype=np.int64)
    if len(times):
        times = times[trajectory.covers(times)]
    if len(times) < _FEWEST_IMAGES or len(trajectory.times_ns) < _FEWEST_IMAGES:
        return f"{len(times)} images have a pose, at least {_FEWEST_IMAGES} are needed"
    T_rig_cam, fx = traversal.T_rig_cam(camera), traversal.camera(camera).fx
    windows = _windows(CameraMotion.of(trajectory, T_rig_cam, times), fx)
    if not windows:
        return "the camera moves too evenly, so that no offset would change what it sees"
    starts = np.cumsum([0, *(len(rows) for rows in windows)])[:-1].tolist()
    units = [
        _Window(traversal, camera, tuple(times[rows].tolist()), first)
        for rows, first in zip(windows, starts, strict=True)
    ]
    tracks = tuple(one for of_window in work(f"clock of {traversal.name}", matched, units) for one in of_window)
    parts = np.repeat(np.arange(len(windows)), [len(rows) for rows in windows])
    return Evidence(camera, fx, T_rig_cam, times[np.concatenate(windows)], parts, tracks)


def matched(window: _Window) -> list[Tracks]:
    """The tracks between images of a window."""
    features = [features_of(window.traversal, window.camera, time) for time in window.times_ns]
    model = window.traversal.camera(window.camera)
    pairs = [(i, i + lag) for lag in _LAGS for i in range(len(features) - lag)]
    tracks = [match(window.first + i, features[i], window.first + j, features[j], model) for i, j in pairs]
    return [one for one in tracks if one is not None]


def _windows(motion: CameraMotion, fx: float) -> list[Indices]:
    """Rows of images in a row: all, or in each of equal parts of the drive those between which motion changes most."""
    twists, known = motion.twists(0.0)
    pixels = fx * np.column_stack([twists[:, 3:], twists[:, :3] / _FAR_M])
    pixels[~known] = 0.0
    count = len(motion.times_ns)
    starts = np.arange(0, max(count - _WINDOW, 0) + 1)
    if count <= _WINDOW * _WINDOWS:
        starts = np.arange(0, count, _WINDOW)
    chosen: list[Indices] = []
    signal: list[float] = []
    for part in np.array_split(starts, min(_WINDOWS, len(starts))):
        spread = [float(np.sqrt(np.sum(np.var(pixels[s : s + _WINDOW], axis=0)))) for s in part]
        best = int(part[int(np.argmax(spread))])
        if chosen and best < chosen[-1][-1] + 1:
            best = int(chosen[-1][-1]) + 1
        rows = np.arange(best, min(best + _WINDOW, count))
        if len(rows) >= 2:
            chosen.append(rows)
            signal.append(max(spread))
    return chosen if signal and max(signal) * REACH_S >= _LEAST_SIGNAL_PX else []
