"""Depth images of a drive, from its submaps or by stereo, made by worker processes."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Array, Floats
from relocbench.datasets.core import images
from relocbench.datasets.groundtruth.blocks.nodes import nearest_nodes
from relocbench.datasets.groundtruth.depth.depth import (
    DepthImage,
    DepthOptions,
    DepthScene,
    fit_sigma,
    make_scene,
    scene_depth,
)
from relocbench.datasets.groundtruth.depth.stereo import Agreement, StereoPair, cross_check
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.groundtruth.submaps.submaps import SubmapWindow
from relocbench.errors import ConfigError
from relocbench.execution import Run, chunks, run_units
from relocbench.geometry import Camera, invert
from relocbench.progress import Reporter

DepthSource = Literal["lidar", "stereo"]

_IMAGES_A_UNIT = 8
_SIGMA_FROM = 12
"""number of images, evenly along the drive, that the model of depth's sigma is fitted to"""


@dataclass(frozen=True)
class DepthFrame:
    """One image whose depth is wanted, and the path of its depth image."""

    time_ns: int
    path: Path


@dataclass(frozen=True, eq=False)
class DepthView:
    """One camera of a drive and the source of its depth."""

    drive: Drive
    camera: Camera
    T_rig_cam: Array
    source: DepthSource
    pair: StereoPair | None
    """None if the rig has none"""
    length_m: float
    """length of road of the submap that depth is drawn from"""
    options: DepthOptions
    enlarged: float = 1.0
    """how many times the metres of the drive, of ``T_rig_cam`` and of ``length_m`` are enlarged; depth is in metres"""

    def at(self, time_ns: int) -> DepthImage:
        """Depth of the image at a time."""
        return self.by_stereo(time_ns) if self.source == "stereo" else self.by_lidar(time_ns)

    def by_lidar(self, time_ns: int) -> DepthImage:
        """Depth drawn from the submap of the node nearest in time on the same piece of the odometry.

        Raises:
            ValueError: there is no such node.
        """
        drive, at = self.drive, np.array([time_ns], dtype=np.int64)
        node = int(nearest_nodes(drive.nodes, drive.recording.odometry, at)[0])
        if node < 0:
            raise ValueError(f"no node of {drive.name} is on the piece of odometry of {time_ns}")
        T_odom_rig = drive.recording.odometry.at(at)[0]
        T_cam_node = invert(T_odom_rig @ self.T_rig_cam) @ drive.nodes.T_odom_node[node]
        scene = _scene(_WindowKey(drive.blocks, self.length_m, self.options, drive), node)
        depth = scene_depth(scene, self.camera, T_cam_node, self.options)
        if self.enlarged == 1.0:
            return depth
        factor = np.float32(self.enlarged)
        return DepthImage(depth.depth / factor, depth.sigma / factor)

    def by_stereo(self, time_ns: int) -> DepthImage:
        """Depth by matching the two images of the stereo pair."""
        if self.pair is None:
            raise ConfigError(f"--depth stereo: {self.drive.name} has no camera that is rectified with this one")
        return self.pair.depth(time_ns)


@dataclass(frozen=True)
class _Task:
    frame: DepthFrame
    missing: bool
    sampled: bool
    """whether the model of depth's sigma is fitted to it"""


@dataclass(frozen=True, eq=False)
class _Unit:
    """Neighbouring images of one camera, as a unit of work."""

    view: DepthView
    tasks: tuple[_Task, ...]

    def __str__(self) -> str:
        return f"depth of {self.view.drive.name} at {self.tasks[0].frame.time_ns}"


@dataclass(frozen=True, eq=False)
class _Sample:
    depth: DepthImage
    by_other: Floats | None
    """depth from the other source, lidar or stereo; None if there is none"""


def make_depth(
    view: DepthView, frames: Sequence[DepthFrame], missing: Collection[int], reporter: Reporter, run: Run
) -> tuple[tuple[float, float, float], Agreement | None]:
    """Write depth images and estimate their standard deviation.

    Args:
        frames: all images that have depth, in the order of the road.
        missing: times of the images whose depth has yet to be made.

    Returns:
        (a, b, c) of ``sigma = a + b z + c z^2``, and the agreement of depth by lidar and by stereo if there are both;
        each from a sample of the images.
    """
    step = max(1, -(-len(frames) // _SIGMA_FROM))
    tasks = [_Task(frame, frame.time_ns in missing, k % step == 0) for k, frame in enumerate(frames)]
    units = [_Unit(view, tuple(part)) for part in chunks([t for t in tasks if t.missing or t.sampled], _IMAGES_A_UNIT)]
    samples: dict[int, list[_Sample]] = {}
    with reporter.stage(f"depth of {view.drive.name}", sum(len(unit.tasks) for unit in units)) as advance:
        for index, drawn in run_units(_draw, units, run):
            samples[index] = drawn
            advance(len(units[index].tasks))
    ordered = [sample for index in sorted(samples) for sample in samples[index]]
    if view.source == "stereo" and view.pair is not None:
        return view.pair.geometry.depth_sigma, _agreement(view, ordered)
    return fit_sigma(sample.depth for sample in ordered), _agreement(view, ordered)


def _draw(unit: _Unit) -> list[_Sample]:
    view, samples = unit.view, []
    common = view.pair.common_times() if view.pair is not None else frozenset[int]()
    for task in unit.tasks:
        time = task.frame.time_ns
        seen = view.at(time)
        if task.missing:
            images.write_depth(task.frame.path, seen.depth)
        if task.sampled:
            other = view.by_lidar if view.source == "stereo" else view.by_stereo
            samples.append(_Sample(seen, other(time).depth if time in common else None))
    return samples


def _agreement(view: DepthView, samples: Sequence[_Sample]) -> Agreement | None:
    both = [(sample.depth.depth, sample.by_other) for sample in samples if sample.by_other is not None]
    if not both or view.pair is None:
        return None
    own, other = np.stack([one for one, _ in both]), np.stack([two for _, two in both])
    lidar, stereo = (own, other) if view.source == "lidar" else (other, own)
    return cross_check(lidar, stereo, view.camera, view.pair.baseline_m)


@dataclass(frozen=True)
class _WindowKey:
    """A drive and settings, compared by value: the key under which a worker process caches windows and scenes."""

    blocks: Path
    length_m: float
    options: DepthOptions
    drive: Drive = field(compare=False)


@lru_cache(maxsize=2)
def _window(key: _WindowKey) -> SubmapWindow:
    return key.drive.window(key.length_m)


@lru_cache(maxsize=4)
def _scene(key: _WindowKey, node: int) -> DepthScene:
    return make_scene(_window(key).at(node), key.options)
