"""Edges of the pose graph: relative poses measured between two nodes, and their residuals.

The nodes of both drives share one numbering: first the reference's, then the query's. Errors are twists
``xi = (rho, phi)`` on the right, ``T_true = T_measured @ se3_exp(xi)``: metres and radians in the second node's frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum

import numpy as np

from relocbench.arrays import Array, Indices, Mask
from relocbench.geometry import invert, se3_log


class Kind(IntEnum):
    """The source of an edge."""

    REFERENCE_ODOMETRY = 0
    QUERY_ODOMETRY = 1
    REGISTRATION = 2


@dataclass(frozen=True, eq=False)
class Edges:
    """E measured relative poses, each between two nodes."""

    first: Indices
    """(E,) number of the first node"""
    second: Indices
    """(E,) number of the second node"""
    T_first_second: Array
    """(E, 4, 4) measured relative poses"""
    information: Array
    """(E, 6, 6) information matrices of the twist ``(rho, phi)``"""
    kind: Indices
    """(E,) :class:`Kind`"""

    def __len__(self) -> int:
        return len(self.first)

    def __getitem__(self, which: Mask | Indices) -> Edges:
        """The edges that a mask or indices select."""
        return Edges(*(getattr(self, field.name)[which] for field in fields(self)))

    @classmethod
    def join(cls, parts: Sequence[Edges]) -> Edges:
        """The edges of all parts, in their order."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    @classmethod
    def of_registrations(
        cls,
        first: Sequence[int] | Indices,
        second: Sequence[int] | Indices,
        T_first_second: Sequence[Array] | Array,
        information: Sequence[Array] | Array,
    ) -> Edges:
        """Edges by registrations, in their order."""
        return cls(
            np.array(first, dtype=np.int64),
            np.array(second, dtype=np.int64),
            np.array(T_first_second, dtype=np.float64).reshape(-1, 4, 4),
            np.array(information, dtype=np.float64).reshape(-1, 6, 6),
            np.full(len(first), Kind.REGISTRATION, dtype=np.int64),
        )

    def relative_poses(self, T_world_node: Array) -> Array:
        """(E, 4, 4) relative poses ``T_first_second`` by the node poses (N, 4, 4)."""
        return np.asarray(invert(T_world_node[self.first]) @ T_world_node[self.second])

    def residuals(self, T_world_node: Array) -> Array:
        """(E, 6) twists from the measured relative poses to those by the node poses (N, 4, 4)."""
        return np.asarray(se3_log(invert(self.T_first_second) @ self.relative_poses(T_world_node)))

    def chi2(self, T_world_node: Array) -> Array:
        """(E,) squared Mahalanobis norms of the residuals, given node poses (N, 4, 4)."""
        r = self.residuals(T_world_node)
        out: Array = np.einsum("ei,eij,ej->e", r, self.information, r)
        return out


def components(count: int, first: Indices, second: Indices) -> Indices:
    """(count,) for each of ``count`` nodes, the smallest number of the nodes that edges connect it with."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    labels = connected_components(links, directed=False)[1]
    smallest = np.full(labels.max(initial=-1) + 1, count, dtype=np.int64)
    np.minimum.at(smallest, labels, np.arange(count))
    return smallest[labels]
