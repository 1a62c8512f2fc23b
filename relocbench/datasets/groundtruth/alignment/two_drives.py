"""The alignment of two drives: registrations between their submaps, and the pose graph that they are solved in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.odometry.length import length_ratio
from relocbench.datasets.groundtruth.pose_graph.block_fits import BlockFits
from relocbench.datasets.groundtruth.pose_graph.graph import Solution, optimise
from relocbench.datasets.groundtruth.pose_graph.local_edges import refine_locally
from relocbench.datasets.groundtruth.registration.along_drive import DriveRegistrationOptions, Remember, register_along
from relocbench.datasets.groundtruth.registration.files import read_registrations
from relocbench.datasets.groundtruth.registration.journal import JournaledUnit, register_missing
from relocbench.datasets.groundtruth.registration.lengths import is_stretched
from relocbench.datasets.groundtruth.registration.mounts import wrong_mount
from relocbench.datasets.groundtruth.registration.place_recognition import MapPrior
from relocbench.datasets.groundtruth.registration.submap_pair import nodes_every
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.execution import Run
from relocbench.geometry import invert
from relocbench.progress import Reporter

FirstPose = tuple[int, int, Array]
"""(reference time, query time, ``T_ref_query`` between the rigs), times in nanoseconds"""


@dataclass(frozen=True)
class AlignmentOptions:
    """Options of all steps from two recordings to the poses of one drive relative to the other."""

    block_m: float = 2.0
    """length of road of a block"""
    submap_m: float = 60.0
    """length of road of a submap"""
    registration: DriveRegistrationOptions = field(default_factory=DriveRegistrationOptions)


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
    prior, options = map_prior(reference, query), unit.options.registration
    within = options.search, options.hypotheses, options.register
    registrations = register_along(
        reference.window(length),
        query.window(length),
        reference.nodes,
        query.nodes,
        prior,
        options,
        first=None if unit.first is None else at_nodes(reference, query, unit.first),
        say=say,
        remember=remember,
        explain=partial(wrong_mount, reference, query, prior, length, *within),
    )
    if is_stretched(registrations):
        for message in filter(None, map(_length_by_gnss, (reference, query))):
            say(message)
    return registrations


def register_drives(
    reference: Drive,
    queries: Sequence[Drive],
    folder: Path,
    options: AlignmentOptions,
    first: FirstPose | None,
    reporter: Reporter,
    run: Run,
) -> dict[str, list[Registration]]:
    """Register each query drive by worker processes; the registrations of an earlier run are read from disk.

    ``folder`` holds ``REF__QUERY.csv`` for drives that are complete and ``REF__QUERY.journal`` for those that are not.

    Returns:
        name of the query drive -> its registrations.
    """
    folder = folder.resolve()  # workers of a cluster run in other working directories
    tables = {query.name: folder / f"{reference.name}__{query.name}.csv" for query in queries}
    known = {name: read_registrations(path) for name, path in tables.items() if path.exists()}
    units = []
    for query in queries:
        drives = RegistrationUnit(reference, query, options, if_within(query.recording, first))
        work, nodes = partial(register_query, drives), (reference.nodes, query.nodes)
        units.append(JournaledUnit(str(drives), work, drives.steps, tables[query.name], nodes, query.name))
    register_missing("registering drives", units, reporter, run)
    # Always use the file, so that a fresh build and a resumed one use the same numbers.
    return {name: known[name] if name in known else read_registrations(path) for name, path in tables.items()}


def if_within(query: FieldRecording, first: FirstPose | None) -> FirstPose | None:
    """The pose given by hand, if its time lies in this drive."""
    times = query.odometry.times_ns
    return first if first is not None and times[0] <= first[1] <= times[-1] else None


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
        at = int(np.clip(time, *drive.recording.odometry.times_ns[[0, -1]]))
        node = drive.nearest_node(at)
        moved.append(drive.from_node(node, at))
        out.append(node)
    T_ref_query = moved[0] @ first[2] @ invert(moved[1])
    return out[0], out[1], T_ref_query


def solve_drive(reference: Drive, query: Drive, registrations: Sequence[Registration]) -> Solution:
    """Poses of both drives' nodes: a pose graph of all registrations, then of edges between single blocks."""
    solution = optimise(reference.nodes, query.nodes, registrations)
    if not solution.trusted.any():
        return solution
    return refine_locally(solution, BlockFits(reference.store(), query.store()))
