"""What a chain of pairs says, in the form of the builder's own answers: outcomes of pairs, and poses of nodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relocbench.datasets.core.pairfile import UNCALIBRATED
from relocbench.datasets.groundtruth.pairs.outcome import PairOutcome, axis_sigmas
from relocbench.datasets.groundtruth.pose_graph.both_drives import BothDrives
from relocbench.datasets.groundtruth.pose_graph.files import PlacedDrive
from relocbench.datasets.groundtruth.recipe.chain import ChainUnit
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.geometry import adjoint, invert

SOURCE = f"Open3D: RANSAC or the last pair, point-to-plane ICP; not verified, {UNCALIBRATED}"
"""Open3D counts each pair of points as an independent measurement, so that its sigmas are many times too small"""


def outcomes_of(unit: ChainUnit, pairs: Sequence[Registration]) -> list[PairOutcome]:
    """The outcome of each query image, its covariance the inverse of Open3D's information matrix."""
    T_rig_refcam, T_rig_querycam = unit.images.T_rig_refcam, unit.images.T_rig_querycam
    out = []
    for pair in pairs:
        times = unit.images.ref_ns[pair.ref], unit.images.query_ns[pair.query]
        if not np.isfinite(pair.T_ref_query).all():
            out.append(PairOutcome(*times, reason=pair.reason, source=SOURCE))
            continue
        A = adjoint(invert(T_rig_querycam))
        covariance = A @ np.linalg.pinv(pair.information, hermitian=True) @ A.T
        T_query_ref = invert(pair.T_ref_query @ T_rig_querycam) @ T_rig_refcam
        sigmas = axis_sigmas(covariance, T_rig_querycam[:3, :3])
        out.append(PairOutcome(*times, T_query_ref, covariance, *sigmas, pair.reason, SOURCE))
    return out


def between_nodes(unit: ChainUnit, pairs: Sequence[Registration], reference: Drive, query: Drive) -> list[Registration]:
    """The pairs as registrations of the nearest nodes, one for a node at most, moved along by both odometries."""
    out: dict[int, Registration] = {}
    for pair in pairs:
        times = unit.images.ref_ns[pair.ref], unit.images.query_ns[pair.query]
        i, j = reference.nearest_node(times[0]), query.nearest_node(times[1])
        T, information = pair.T_ref_query, pair.information
        if np.isfinite(T).all():
            T_refnode_ref, T_querynode_query = reference.from_node(i, times[0]), query.from_node(j, times[1])
            T = T_refnode_ref @ T @ invert(T_querynode_query)
            # T exp(xi) inv(Q) = T inv(Q) exp(Ad_Q xi), so that xi_query = Ad_inv(Q) xi_node.
            A = adjoint(invert(T_querynode_query))
            information = A.T @ information @ A
        if j not in out or (pair.trusted and not out[j].trusted):
            out[j] = Registration(i, j, T, information, pair.evidence, pair.reason)
    return [out[j] for j in sorted(out)]


def placed(registrations: Sequence[Registration], reference: Drive, query: Drive) -> tuple[PlacedDrive, PlacedDrive]:
    """The nodes of both drives in the reference's odometry: those of the query by the nearest accepted pair."""
    good = [r for r in registrations if r.trusted]
    T_world_query = query.nodes.T_odom_node
    if good:
        ways = query.nodes.travelled_m[[r.query for r in good]]
        nearest = np.argmin(np.abs(query.nodes.travelled_m[:, None] - ways[None, :]), axis=1)
        T_world_odom = [
            reference.nodes.T_odom_node[r.ref] @ r.T_ref_query @ invert(query.nodes.T_odom_node[r.query]) for r in good
        ]
        T_world_query = np.array(T_world_odom)[nearest] @ query.nodes.T_odom_node
    count = len(reference.nodes)
    drives = BothDrives.of(reference.nodes, query.nodes)
    trusted = np.array([*(r.ref for r in good), *(r.query + count for r in good)], dtype=np.int64)
    way = drives.arc_length_to(trusted)
    verdicts = {r.query: r.reason for r in registrations}
    return (
        PlacedDrive(reference.name, reference.nodes.times_ns, reference.nodes.T_odom_node, way[:count], {}),
        PlacedDrive(query.name, query.nodes.times_ns, T_world_query, way[count:], verdicts),
    )
