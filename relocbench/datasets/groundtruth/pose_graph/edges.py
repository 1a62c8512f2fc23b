"""Edges of the pose graph: what was measured between two nodes, and how far an estimate is from it.

Nodes of both drives are numbered through: first the reference's, then the query's. Errors are twists
``xi = (rho, phi)`` on the right, ``T_true = T_measured @ se3_exp(xi)``: metres and radians in the second node's axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from relocbench.geometry import invert, se3_log

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class Kind(IntEnum):
    """Where an edge comes from."""

    REFERENCE_ODOMETRY = 0
    QUERY_ODOMETRY = 1
    REGISTRATION = 2


@dataclass(frozen=True, eq=False)
class Edges:
    """E measurements between two nodes each."""

    first: Indices
    """(E,)"""
    second: Indices
    """(E,)"""
    T_first_second: Array
    """(E, 4, 4) as measured"""
    information: Array
    """(E, 6, 6) of the twist ``(rho, phi)``"""
    kind: Indices
    """(E,) :class:`Kind`"""

    def __len__(self) -> int:
        return len(self.first)

    def __getitem__(self, which: NDArray[np.bool_] | Indices) -> Edges:
        """Those that a mask or indices select."""
        return Edges(
            self.first[which], self.second[which], self.T_first_second[which], self.information[which], self.kind[which]
        )

    @classmethod
    def join(cls, parts: Sequence[Edges]) -> Edges:
        """One after the other."""
        return cls(
            np.concatenate([p.first for p in parts]),
            np.concatenate([p.second for p in parts]),
            np.concatenate([p.T_first_second for p in parts]),
            np.concatenate([p.information for p in parts]),
            np.concatenate([p.kind for p in parts]),
        )

    def apart(self, T_world_node: Array) -> Array:
        """(E, 4, 4) ``T_first_second`` as the poses (N, 4, 4) say."""
        return np.asarray(invert(T_world_node[self.first]) @ T_world_node[self.second])

    def residuals(self, T_world_node: Array) -> Array:
        """(E, 6) twists from what was measured to what the poses (N, 4, 4) say."""
        return np.asarray(se3_log(invert(self.T_first_second) @ self.apart(T_world_node)))

    def chi2(self, T_world_node: Array) -> Array:
        """(E,) squared residuals in units of their standard deviations."""
        r = self.residuals(T_world_node)
        return np.einsum("ei,eij,ej->e", r, self.information, r)


def components(count: int, first: Indices, second: Indices) -> Indices:
    """(count,) for each node the smallest number of a node that edges connect it with."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    labels = connected_components(links, directed=False)[1]
    smallest = np.full(labels.max(initial=-1) + 1, count, dtype=np.int64)
    np.minimum.at(smallest, labels, np.arange(count))
    return smallest[labels]
