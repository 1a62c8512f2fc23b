"""Clouds that are no second measurement: a file given twice, its points in another order, or a copy that was moved."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from relocbench.arrays import Array
from relocbench.geometry import apply, make_transform, project_to_rotation

_SAMPLED, _ROUNDS = 2000, 4
_PAIRED, _SAME = 0.4, 0.05
"""distances, in spacings of points, within which points are taken for partners, and for the same point"""
_LEAST_SHARE = 0.5


def copied_share(a: Array, b: Array, T_a_b: Array) -> float:
    """Share of the points of B (M, 3) that are points of A (N, 3), moved by about ``T_a_b`` (4, 4); 0 below a half.

    Two measurements of a surface have no point in common: the nearest are a spacing apart. Of a copy, the motion that
    brings sampled points onto their nearest ones is exact.
    """
    tree = cKDTree(a, balanced_tree=False, compact_nodes=False)
    nearest: Array = np.asarray(tree.query(_sample(a), k=2, workers=1)[0])
    spacing = float(np.median(nearest[:, 1]))
    points = _sample(b)
    T = np.array(T_a_b, dtype=np.float64)
    for _ in range(_ROUNDS):
        away, rows = tree.query(apply(T, points), workers=1)
        near = away < _PAIRED * max(spacing, 1e-12)
        if np.count_nonzero(near) < _LEAST_SHARE * len(points):
            return 0.0
        T = _rigid_fit(points[near], a[np.asarray(rows)[near]])
    share = float(np.mean(tree.query(apply(T, points), workers=1)[0] <= _SAME * max(spacing, 1e-9)))
    return share if share >= _LEAST_SHARE else 0.0


def _sample(points: Array) -> Array:
    return points[np.linspace(0, len(points) - 1, min(_SAMPLED, len(points))).astype(np.int64)]


def _rigid_fit(source: Array, target: Array) -> Array:
    """(4, 4) the rigid motion that brings source (N, 3) closest to target (N, 3) (Kabsch, 1976)."""
    middles = source.mean(axis=0), target.mean(axis=0)
    R = project_to_rotation((target - middles[1]).T @ (source - middles[0]))
    return make_transform(R, middles[1] - R @ middles[0])
