"""Making blocks from scans: each block from its own beams and those of its neighbours.

The contents of a block depend on the drive and the options alone, not on which blocks are made along with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from relocbench.arrays import Indices
from relocbench.datasets.groundtruth.blocks.blocks import Block, Nodes
from relocbench.datasets.groundtruth.blocks.deskewing import BeamReader, Beams
from relocbench.datasets.groundtruth.blocks.dynamic_points import DynamicPointOptions, static_scores
from relocbench.datasets.groundtruth.blocks.nodes import ArcLength
from relocbench.datasets.groundtruth.blocks.surfaces import SurfaceOptions, classify, fit_normals, level_under, towards
from relocbench.datasets.groundtruth.voxels.thinning import thin
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.geometry import apply, invert

_PATH_M = 100.0
"""ground is classified against the poses of the rig within this distance along the drive, both ways"""
_LEVELS = 16
"""the height of the road under the rig is estimated at so many nodes"""


@dataclass(frozen=True)
class BlockOptions:
    """Options for making blocks from scans."""

    voxel_m: float = 0.1
    """size of the voxels; one point is kept in each"""
    min_range_m: float = 1.0
    """nearer points are left out, since they belong to the car itself"""
    max_range_m: float = 60.0
    """points further away are left out: their range noise and the error of their direction are large"""
    min_step_m: float = 0.02
    """a scan is used if the car has moved by so much since the last one"""
    reach: int = 3
    """number of blocks on both sides whose points normals are fitted to, and whose beams vote on dynamic points"""
    surfaces: SurfaceOptions = field(default_factory=SurfaceOptions)
    steady: DynamicPointOptions = field(default_factory=DynamicPointOptions)


def make_blocks(
    reader: BeamReader,
    nodes: Nodes,
    wanted: Sequence[int],
    wheel_height_m: float,
    options: BlockOptions,
) -> Iterator[tuple[int, Block]]:
    """Yield (node, block) for some nodes, in order. Scans that neighbouring nodes share are read once.

    Args:
        reader: of the drive, by :func:`reader_of`.
        wanted: nodes, in increasing order.
        wheel_height_m: height of the road in the rig's frame; nan if it is not known.

    Raises:
        DatasetError: a scan is damaged.
    """
    ready: dict[int, Beams] = {}
    for node in wanted:
        around = range(max(node - options.reach, 0), min(node + options.reach, len(nodes) - 1) + 1)
        ready = {k: ready[k] if k in ready else _thinned(reader, nodes, k, options) for k in around}
        yield node, _finish(node, ready, nodes, wheel_height_m, options)


def wheel_height(recording: FieldRecording, arc_length: ArcLength, nodes: Nodes, options: BlockOptions) -> float:
    """Height of the road under the rig, in its frame: the median over the drive; nan if no road is seen."""
    reader = reader_of(recording, arc_length, options)
    chosen = np.unique(np.linspace(0, len(nodes) - 1, _LEVELS).astype(int))
    levels = np.array([level_under(beams_of(reader, nodes, int(k)).points) for k in chosen])
    seen = levels[np.isfinite(levels)]
    return float(np.median(seen)) if len(seen) else float("nan")


def reader_of(recording: FieldRecording, arc_length: ArcLength, options: BlockOptions) -> BeamReader:
    """The reader of the beams that blocks are made of."""
    return BeamReader(recording, arc_length, options.min_range_m, options.max_range_m, options.min_step_m)


def beams_of(reader: BeamReader, nodes: Nodes, node: int) -> Beams:
    """The beams that were fired while the car drove along a node's block, in the frame of the node."""
    begin, end = nodes.begins_and_ends()
    return reader.between(int(begin[node]), int(end[node]), nodes.T_odom_node[node])


def _thinned(reader: BeamReader, nodes: Nodes, node: int, options: BlockOptions) -> Beams:
    """The beams of a node's block, thinned to one point a voxel, in single precision as they are stored."""
    beams = beams_of(reader, nodes, node)
    keep = thin(beams.points, options.voxel_m)
    return beams.rows(keep)._replace(
        points=beams.points[keep].astype(np.float32), origins=beams.origins[keep].astype(np.float32)
    )


def _finish(node: int, around: dict[int, Beams], nodes: Nodes, wheel_height_m: float, options: BlockOptions) -> Block:
    """A node's block: normals, surfaces and static scores from the thinned beams of the blocks around it."""
    own = around[node]
    segments = nodes.segments()
    near = [k for k in around if segments[k] == segments[node]]
    T_node_odom = invert(nodes.T_odom_node[node])
    poses = {k: T_node_odom @ nodes.T_odom_node[k] for k in near}
    beams = Beams(
        np.concatenate([apply(poses[k], around[k].points.astype(np.float64)) for k in near]),
        np.concatenate([apply(poses[k], around[k].origins.astype(np.float64)) for k in near]),
        np.concatenate([around[k].times_ns for k in near]),
        np.concatenate([around[k].lidar for k in near]),
    )
    before = sum(len(around[k].points) for k in near if k < node)
    wanted = np.arange(before, before + len(own.points))
    normals = fit_normals(beams.points, wanted, options.surfaces)
    normals = towards(normals, own.points, own.origins)
    along = np.abs(nodes.travelled_m - nodes.travelled_m[node]) <= _PATH_M
    path = T_node_odom @ nodes.T_odom_node[along & (segments == segments[node])]
    surface = classify(own.points, normals, path, wheel_height_m, options.surfaces)
    voting = _voting([len(around[k].points) for k in near], options)
    steady = static_scores(beams, normals, wanted, voting, options.steady)
    return Block(own.points, normals, own.origins, surface, steady, lidar=own.lidar)


def _voting(sizes: Sequence[int], options: BlockOptions) -> Indices:
    """Rows of the beams that vote, where blocks of these sizes are laid end to end."""
    starts = np.cumsum([0, *sizes[:-1]])
    steps = [-(-size // options.steady.most_beams) or 1 for size in sizes]
    return np.concatenate([start + np.arange(0, n, step) for start, n, step in zip(starts, sizes, steps, strict=True)])
