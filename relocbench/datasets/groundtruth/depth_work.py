"""Depth images of a drive's frames from its submaps, made by workers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets import images
from relocbench.datasets.groundtruth.alignment import Drive
from relocbench.datasets.groundtruth.depth import (
    DepthImage,
    DepthOptions,
    Scenery,
    fit_sigma,
    make_scenery,
    scenery_depth,
)
from relocbench.datasets.importers import Run
from relocbench.execution import chunks, run_units
from relocbench.geometry import Camera, invert
from relocbench.progress import Reporter

Array = NDArray[np.float64]

_IMAGES_A_UNIT = 8
_SIGMA_FROM = 12
"""images, evenly along the drive, that the model of depth's sigma is fitted to"""


@dataclass(frozen=True)
class DepthFrame:
    """One image that wants depth."""

    time_ns: int
    path: Path


@dataclass(frozen=True, eq=False)
class DepthUnit:
    """Images of one camera side by side along the road."""

    drive: Drive
    camera: Camera
    T_rig_cam: Array
    frames: tuple[DepthFrame, ...]
    length_m: float
    options: DepthOptions

    def __str__(self) -> str:
        return f"depth of {self.drive.name} at {self.frames[0].time_ns}"


def make_depth(
    drive: Drive,
    camera: Camera,
    T_rig_cam: Array,
    frames: Sequence[DepthFrame],
    length_m: float,
    options: DepthOptions,
    reporter: Reporter,
    run: Run,
) -> None:
    """Write the depth images that are asked for.

    Args:
        frames: those that are missing.
        length_m: of the submap that each is drawn from.
    """
    units = [
        DepthUnit(drive, camera, T_rig_cam, tuple(part), length_m, options) for part in chunks(frames, _IMAGES_A_UNIT)
    ]
    with reporter.stage(f"depth of {drive.name}", len(frames)) as advance:
        for _, done in run_units(write_depth_unit, units, workers=run.workers, scheduler=run.scheduler):
            advance(done)


def write_depth_unit(unit: DepthUnit) -> int:
    """Draw and write the depth of a unit; how many images."""
    for frame in unit.frames:
        found = depth_at(unit.drive, unit.camera, unit.T_rig_cam, frame.time_ns, unit.length_m, unit.options)
        images.write_depth(frame.path, found.depth)
    return len(unit.frames)


def depth_at(
    drive: Drive, camera: Camera, T_rig_cam: Array, time_ns: int, length_m: float, options: DepthOptions
) -> DepthImage:
    """Depth of an image of a drive, from the submap of the node nearest in time."""
    node = int(np.argmin(np.abs(drive.nodes.times_ns - time_ns)))
    T_odom_rig = drive.recording.odometry.at(np.array([time_ns], dtype=np.int64))[0]
    T_cam_node = invert(T_odom_rig @ T_rig_cam) @ drive.nodes.T_odom_node[node]
    return scenery_depth(_scenery(_Around(drive, length_m, options), node), camera, T_cam_node, options)


class _Around:
    """The submaps of a drive, alike for the same drive and settings: a worker's windows are told apart by this."""

    def __init__(self, drive: Drive, length_m: float, options: DepthOptions) -> None:
        self.drive, self.length_m, self.options = drive, length_m, options
        self._key = (str(drive.blocks), length_m, repr(options))

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Around) and self._key == other._key


@lru_cache(maxsize=4)
def _scenery(around: _Around, node: int) -> Scenery:
    return make_scenery(around.drive.window(around.length_m).at(node), around.options)


def depth_sigma(
    drive: Drive, camera: Camera, T_rig_cam: Array, times_ns: Sequence[int], length_m: float, options: DepthOptions
) -> tuple[float, float, float]:
    """(a, b, c) of ``sigma = a + b z + c z^2``, fitted to some of a drive's images."""
    step = max(1, -(-len(times_ns) // _SIGMA_FROM))
    some = times_ns[::step]
    return fit_sigma(depth_at(drive, camera, T_rig_cam, time, length_m, options) for time in some)
