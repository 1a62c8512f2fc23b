"""One pair of submaps: refined from a prediction, judged, and said in a :class:`Registration`."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.icp.backends import Backend, icp_by_backend
from relocbench.datasets.groundtruth.icp.icp import IcpOptions, IcpResult
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.groundtruth.verification.evidence import Evidence, Registration
from relocbench.datasets.groundtruth.verification.verification import Thresholds, gather_evidence, verdict
from relocbench.geometry import invert

Array = NDArray[np.float64]

_NAN = float("nan")
NOTHING_JUDGED = Evidence(_NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, (_NAN, _NAN, _NAN), _NAN)


@dataclass(frozen=True)
class RegisterOptions:
    """Options of one registration of two submaps."""

    backend: Backend = "own"
    icp: IcpOptions = field(default_factory=IcpOptions)
    thresholds: Thresholds = field(default_factory=Thresholds)


class Window(Protocol):
    """Gives the submap of any node: :class:`relocbench.datasets.groundtruth.submaps.submaps.SubmapWindow`."""

    def at(self, node: int, /) -> Submap: ...


class PreparedDrive:
    """One drive's nodes and prepared submaps; the last few are kept."""

    def __init__(self, window: Window, nodes: Nodes, kept: int = 12) -> None:
        self.nodes = nodes
        self._window = window
        self._kept = kept
        self._prepared: OrderedDict[int, PreparedSubmap] = OrderedDict()

    def __len__(self) -> int:
        return len(self.nodes)

    def at(self, node: int) -> PreparedSubmap:
        """The submap of a node, prepared."""
        if node in self._prepared:
            self._prepared.move_to_end(node)
        else:
            self._prepared[node] = PreparedSubmap(self._window.at(node))
            if len(self._prepared) > self._kept:
                self._prepared.popitem(last=False)
        return self._prepared[node]

    def every(self, step_m: float) -> list[int]:
        """Nodes about ``step_m`` apart along the drive, the first one first."""
        return nodes_every(self.nodes, step_m)


def nodes_every(nodes: Nodes, step_m: float) -> list[int]:
    """Nodes about ``step_m`` apart along a drive, the first one first."""
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
    """The registration of one (reference node, query node) from a prediction, trusted or with the reason why not.

    Args:
        levels: of the refinement; see :func:`relocbench.datasets.groundtruth.icp.icp.refine`.
    """
    a, b = ref.at(pair[0]), query.at(pair[1])
    refined: IcpResult = icp_by_backend(options.backend, a, b, T_ref_query, options.icp, levels)
    if refined.count < options.icp.least_matches:
        reason = f"nothing to hold on to: {refined.count} points of both found a surface of the other"
        return unregistered(pair, refined.T_ref_query, reason)
    evidence = gather_evidence(a, b, refined.T_ref_query, refined.information)
    return Registration(
        *pair, refined.T_ref_query, refined.information, evidence, verdict(evidence, options.thresholds)
    )


def unregistered(pair: tuple[int, int], T_ref_query: Array, reason: str) -> Registration:
    """A pair that was not registered: the pose is a prediction and holds no information."""
    return Registration(*pair, T_ref_query, np.zeros((6, 6)), NOTHING_JUDGED, reason)


def predict(known: Registration, ref: Nodes, query: Nodes, pair: tuple[int, int]) -> Array:
    """``T_ref_query`` of another pair of nodes by both odometries from a known one."""
    T_r_known = invert(ref.T_odom_node[pair[0]]) @ ref.T_odom_node[known.ref]
    T_known_q = invert(query.T_odom_node[known.query]) @ query.T_odom_node[pair[1]]
    return np.asarray(T_r_known @ known.T_ref_query @ T_known_q)
