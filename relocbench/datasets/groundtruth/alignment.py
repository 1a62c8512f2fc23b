"""Two drives brought together: blocks, registrations, pose graph, local edges, in this order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.block_fits import BlockFits
from relocbench.datasets.groundtruth.block_making import BlockOptions
from relocbench.datasets.groundtruth.block_store import BlockStore, build_blocks
from relocbench.datasets.groundtruth.blocks import Nodes
from relocbench.datasets.groundtruth.evidence import Registration
from relocbench.datasets.groundtruth.graph import Solution, optimise
from relocbench.datasets.groundtruth.local_edges import LocalOptions, refine_locally
from relocbench.datasets.groundtruth.nodes import make_nodes
from relocbench.datasets.groundtruth.placefinding import MapPrior
from relocbench.datasets.groundtruth.recording import FieldRecording
from relocbench.datasets.groundtruth.registering import nodes_every
from relocbench.datasets.groundtruth.selection import GraphOptions
from relocbench.datasets.groundtruth.submaps import SubmapWindow
from relocbench.datasets.groundtruth.tracking import Remember, TrackingOptions, track
from relocbench.execution import Run
from relocbench.geometry import invert
from relocbench.progress import Reporter

Array = NDArray[np.float64]
FirstPose = tuple[int, int, Array]
"""(reference time, query time, ``T_ref_query`` rig to rig), nanoseconds"""


@dataclass(frozen=True)
class AlignmentOptions:
    """Of everything between two recordings and the poses of one in the other."""

    block_m: float = 2.0
    submap_m: float = 60.0
    """length of road that a submap shows"""
    blocks: BlockOptions = field(default_factory=BlockOptions)
    tracking: TrackingOptions = field(default_factory=TrackingOptions)
    graph: GraphOptions = field(default_factory=GraphOptions)
    local: LocalOptions = field(default_factory=LocalOptions)


@dataclass(frozen=True, eq=False)
class Drive:
    """One drive, cut into blocks that lie on disk."""

    recording: FieldRecording
    """without its cameras"""
    nodes: Nodes
    blocks: Path

    @property
    def name(self) -> str:
        return self.recording.name

    def store(self) -> BlockStore:
        return BlockStore(self.blocks)

    def window(self, length_m: float, T_world_node: Array | None = None) -> SubmapWindow:
        """Submaps of so many metres of road."""
        return SubmapWindow(self.nodes, self.store(), length_m / 2, T_odom_node=T_world_node)


def make_drive(
    recording: FieldRecording, folder: Path, options: AlignmentOptions, reporter: Reporter, run: Run
) -> Drive:
    """Cut a drive into blocks; what is there already is kept.

    Raises:
        DatasetError: a scan is damaged, the odometry knows nothing of the scans' times, or ``folder`` holds the blocks
            of another drive.
    """
    nodes = make_nodes(recording, options.block_m)
    build_blocks(recording, nodes, folder, run, reporter, options.blocks)
    return Drive(replace(recording, cameras={}), nodes, folder)


@dataclass(frozen=True, eq=False)
class TrackUnit:
    """One query drive against the reference, as a worker needs it."""

    reference: Drive
    query: Drive
    options: AlignmentOptions
    first: FirstPose | None = None

    def __str__(self) -> str:
        return f"registration of {self.query.name} against {self.reference.name}"

    @property
    def steps(self) -> int:
        """Nodes of the query that are registered."""
        return len(nodes_every(self.query.nodes, self.options.tracking.step_m))


def track_drive(
    unit: TrackUnit,
    say: Callable[[str], None] = lambda message: None,
    remember: Remember = lambda asked, work: work(),
) -> list[Registration]:
    """Registrations of a query drive's nodes, in the order of its road.

    Args:
        say, remember: as :func:`relocbench.datasets.groundtruth.tracking.track` has them.
    """
    reference, query, length = unit.reference, unit.query, unit.options.submap_m
    return track(
        reference.window(length),
        query.window(length),
        reference.nodes,
        query.nodes,
        map_prior(reference, query),
        unit.options.tracking,
        first=None if unit.first is None else at_nodes(reference, query, unit.first),
        say=say,
        remember=remember,
    )


def map_prior(reference: Drive, query: Drive) -> MapPrior | None:
    """Where GNSS puts both drives' nodes; None where one of them has none."""
    poses = []
    for drive in (reference, query):
        prior, times = drive.recording.prior, drive.nodes.times_ns
        if prior is None:
            return None
        known = prior.covers(times)
        T_map_node = np.full((len(times), 4, 4), np.nan)
        T_map_node[known] = prior.at(times[known])
        poses.append(T_map_node)
    return MapPrior(poses[0], poses[1], max(reference.recording.prior_sigma_m, query.recording.prior_sigma_m))


def at_nodes(reference: Drive, query: Drive, first: FirstPose) -> tuple[int, int, Array]:
    """A pose of two moments, carried along both odometries to the nodes nearest in time."""
    out, moved = [], []
    for drive, time in ((reference, first[0]), (query, first[1])):
        node = int(np.argmin(np.abs(drive.nodes.times_ns - time)))
        at = np.clip(time, *drive.recording.odometry.times_ns[[0, -1]])
        T_odom_then = drive.recording.odometry.at(np.array([at], dtype=np.int64))[0]
        moved.append(invert(drive.nodes.T_odom_node[node]) @ T_odom_then)
        out.append(node)
    T_ref_query = moved[0] @ first[2] @ invert(moved[1])
    return out[0], out[1], T_ref_query


def solve_drive(
    reference: Drive, query: Drive, registrations: Sequence[Registration], options: AlignmentOptions
) -> Solution:
    """Both drives' nodes by all registrations at once, then block by block."""
    solution = optimise(reference.nodes, query.nodes, registrations, options=options.graph)
    if not solution.trusted.any():
        return solution
    return refine_locally(solution, BlockFits(reference.store(), query.store()), options.local)
