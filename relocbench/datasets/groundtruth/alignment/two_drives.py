"""The alignment of two drives: registrations between their submaps, and the pose graph that they are solved in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.making import BlockOptions
from relocbench.datasets.groundtruth.blocks.nodes import nearest_nodes
from relocbench.datasets.groundtruth.odometry.length import length_ratio
from relocbench.datasets.groundtruth.pose_graph.block_fits import BlockFits
from relocbench.datasets.groundtruth.pose_graph.graph import Solution, optimise
from relocbench.datasets.groundtruth.pose_graph.local_edges import LocalOptions, refine_locally
from relocbench.datasets.groundtruth.pose_graph.selection import GraphOptions
from relocbench.datasets.groundtruth.registration.along_drive import DriveRegistrationOptions, Remember, register_along
from relocbench.datasets.groundtruth.registration.lengths import is_stretched
from relocbench.datasets.groundtruth.registration.place_recognition import MapPrior
from relocbench.datasets.groundtruth.registration.submap_pair import nodes_every
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.geometry import invert

FirstPose = tuple[int, int, Array]
"""(reference time, query time, ``T_ref_query`` between the rigs), times in nanoseconds"""


@dataclass(frozen=True)
class AlignmentOptions:
    """Options of all steps from two recordings to the poses of one drive relative to the other."""

    block_m: float = 2.0
    """length of road of a block"""
    submap_m: float = 60.0
    """length of road of a submap"""
    blocks: BlockOptions = field(default_factory=BlockOptions)
    registration: DriveRegistrationOptions = field(default_factory=DriveRegistrationOptions)
    graph: GraphOptions = field(default_factory=GraphOptions)
    local: LocalOptions = field(default_factory=LocalOptions)


@dataclass(frozen=True, eq=False)
class RegistrationUnit:
    """One query drive and the reference: what a worker needs to register them."""

    reference: Drive
    query: Drive
    options: AlignmentOptions
    first: FirstPose | None = None

    def __str__(self) -> str:
        return f"registration of {self.query.name} against {self.reference.name}"

    @property
    def steps(self) -> int:
        """Number of query nodes that are registered."""
        return len(nodes_every(self.query.nodes, self.options.registration.step_m))


def register_query(
    unit: RegistrationUnit,
    say: Callable[[str], None] = lambda message: None,
    remember: Remember = lambda key, work: work(),
) -> list[Registration]:
    """Register the nodes of a query drive. Returns the registrations in the order of the drive.

    Args:
        say, remember: see :func:`relocbench.datasets.groundtruth.registration.along_drive.register_along`.
    """
    reference, query, length = unit.reference, unit.query, unit.options.submap_m
    registrations = register_along(
        reference.window(length),
        query.window(length),
        reference.nodes,
        query.nodes,
        map_prior(reference, query),
        unit.options.registration,
        first=None if unit.first is None else at_nodes(reference, query, unit.first),
        say=say,
        remember=remember,
    )
    if is_stretched(registrations):
        for told in filter(None, map(_length_by_gnss, (reference, query))):
            say(told)
    return registrations


def _length_by_gnss(drive: Drive) -> str:
    """What GNSS says of the length of a drive by its odometry; empty if there is too little of it."""
    recording = drive.recording
    if recording.prior is None:
        return ""
    ratio = length_ratio(recording.odometry, recording.prior, recording.prior_sigma_m)
    if ratio is None:
        return ""
    return f"{drive.name} is {ratio.words(1)} by odometry than by GNSS (known to {100 * ratio.margin:.1f} %)"


def map_prior(reference: Drive, query: Drive) -> MapPrior | None:
    """The positions of both drives' nodes by GNSS; None if one of the drives has none."""
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
    """A pose between two times, transferred by both odometries to the nodes nearest in time.

    A time without a node on its piece of the odometry gets the nearest node of all, whose pose is as uncertain as the
    one that was given.
    """
    out, moved = [], []
    for drive, time in ((reference, first[0]), (query, first[1])):
        odometry = drive.recording.odometry
        at = np.array([np.clip(time, *odometry.times_ns[[0, -1]])], dtype=np.int64)
        nearest = int(nearest_nodes(drive.nodes, odometry, at)[0])
        node = nearest if nearest >= 0 else int(np.argmin(np.abs(drive.nodes.times_ns - time)))
        T_odom_then = odometry.at(at)[0]
        moved.append(invert(drive.nodes.T_odom_node[node]) @ T_odom_then)
        out.append(node)
    T_ref_query = moved[0] @ first[2] @ invert(moved[1])
    return out[0], out[1], T_ref_query


def solve_drive(
    reference: Drive, query: Drive, registrations: Sequence[Registration], options: AlignmentOptions
) -> Solution:
    """Poses of both drives' nodes: a pose graph of all registrations, then of edges between single blocks."""
    solution = optimise(reference.nodes, query.nodes, registrations, options=options.graph)
    if not solution.trusted.any():
        return solution
    return refine_locally(solution, BlockFits(reference.store(), query.store()), options.local)
