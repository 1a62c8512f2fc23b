"""The registration of one pair of submaps: ICP from a prediction, followed by verification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Protocol

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.icp.backends import Backend, icp_by_backend
from relocbench.datasets.groundtruth.icp.icp import IcpOptions, IcpResult
from relocbench.datasets.groundtruth.registration.global_registration import Features, GlobalOptions, describe
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.groundtruth.verification.evidence import Evidence, Registration
from relocbench.datasets.groundtruth.verification.verification import Thresholds, verdict, verification_evidence
from relocbench.geometry import invert

Guess = tuple[int, int, Array]
"""reference node, query node, ``T_ref_query``"""

_KEPT_FEATURES = 128
"""submaps whose features are kept in memory, a megabyte each"""
_NAN = float("nan")
NOTHING_JUDGED = Evidence(_NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, (_NAN, _NAN, _NAN), _NAN)


@dataclass(frozen=True)
class RegisterOptions:
    """Options of the registration of two submaps."""

    backend: Backend = "own"
    icp: IcpOptions = field(default_factory=IcpOptions)
    thresholds: Thresholds = field(default_factory=Thresholds)


class Window(Protocol):
    """The submaps of any node: :class:`relocbench.datasets.groundtruth.submaps.submaps.SubmapWindow`."""

    def at(self, node: int, /) -> Submap: ...

    def stretched(self, factor: float, /) -> Window: ...


class PreparedDrive:
    """The nodes and prepared submaps of one drive; the submaps used last are kept in memory."""

    def __init__(self, window: Window, nodes: Nodes, kept: int = 12) -> None:
        self.nodes = nodes
        self._window = window
        self._prepare = lru_cache(maxsize=kept)(lambda node: PreparedSubmap(window.at(node)))
        self._describe = lru_cache(maxsize=_KEPT_FEATURES)(
            lambda node, voxel_m: describe(self.at(node).submap, GlobalOptions(voxel_m=voxel_m))
        )

    def __len__(self) -> int:
        return len(self.nodes)

    def at(self, node: int) -> PreparedSubmap:
        """The prepared submap of a node."""
        return self._prepare(node)

    def features(self, node: int, options: GlobalOptions) -> Features:
        """The features of a node's submap, which several searches share."""
        return self._describe(node, options.voxel_m)

    def stretched(self, factor: float) -> PreparedDrive:
        """The drive by odometry that is ``factor`` times as long."""
        return PreparedDrive(self._window.stretched(factor), self.nodes.stretched(factor))


def nodes_every(nodes: Nodes, step_m: float) -> list[int]:
    """Nodes at least ``step_m`` apart along a drive, beginning with the first one."""
    chosen: list[int] = []
    for node, travelled in enumerate(nodes.travelled_m.tolist()):
        if not chosen or travelled - nodes.travelled_m[chosen[-1]] >= step_m - 1e-6:
            chosen.append(node)
    return chosen


def register(
    ref: PreparedDrive,
    query: PreparedDrive,
    pair: tuple[int, int],
    T_ref_query: Array,
    options: RegisterOptions,
    levels: Sequence[int] | None = None,
) -> Registration:
    """Register a pair (reference node, query node) from a prediction. The result is trusted or states why it is not.

    Args:
        levels: of ICP; see :func:`relocbench.datasets.groundtruth.icp.icp.run_icp`.
    """
    a, b = ref.at(pair[0]), query.at(pair[1])
    refined: IcpResult = icp_by_backend(options.backend, a, b, T_ref_query, options.icp, levels)
    if refined.count < options.icp.least_matches:
        reason = f"too little overlap: {refined.count} matched points, at least {options.icp.least_matches} needed"
        return unregistered(pair, refined.T_ref_query, reason)
    evidence = verification_evidence(a, b, refined.T_ref_query, refined.information)
    return Registration(
        *pair, refined.T_ref_query, refined.information, evidence, verdict(evidence, options.thresholds)
    )


def unregistered(pair: tuple[int, int], T_ref_query: Array, reason: str) -> Registration:
    """A pair that could not be registered; its information is zero, and its pose may be a prediction or nan."""
    return Registration(*pair, T_ref_query, np.zeros((6, 6)), NOTHING_JUDGED, reason)


def predict(known: Registration, ref: Nodes, query: Nodes, pair: tuple[int, int]) -> Array:
    """``T_ref_query`` of another pair of nodes, predicted from a known one by both odometries."""
    T_r_known = invert(ref.T_odom_node[pair[0]]) @ ref.T_odom_node[known.ref]
    T_known_q = invert(query.T_odom_node[known.query]) @ query.T_odom_node[pair[1]]
    return np.asarray(T_r_known @ known.T_ref_query @ T_known_q)


def predict_in_reference(known: Registration, ref: Nodes, query: Nodes, node: int) -> Array:
    """Pose (4, 4) of a query node in the reference's odometry, predicted from a known registration."""
    T_odom_known = ref.T_odom_node[known.ref] @ known.T_ref_query
    return np.asarray(T_odom_known @ invert(query.T_odom_node[known.query]) @ query.T_odom_node[node])
