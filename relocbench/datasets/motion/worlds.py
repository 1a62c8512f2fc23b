"""Whether two drives that are paired by their coordinates share a world, or have one each.

Odometry and SLAM begin wherever they were started, often at the origin. Drives of one road then look alike, begin at
one point to the last digit, and are turned against each other; pairs by their numbers are wrong, and none
of them tells.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from relocbench.arrays import Array
from relocbench.geometry import path_lengths, rotation_angle

_SAME_M = 1e-3
"""metres between the first poses of two drives below which they are one: nobody parks as exactly"""
_PARTS = 100
"""of the way that two drives have in common, if they begin at the same place of the road"""
_ALIKE = 0.006
"""share of the way by which one shape deviates from the other where they are one. Of 400 pairs of stretches of KITTI 00
in different streets, none deviates less; of as many that are turned and drift, 371 are found"""
_APART = 5.0
"""times as far the drives are apart as they are"""
_LEAST_M = 5.0
"""metres that they are apart at least: GNSS errs by as much"""
_BENT = 0.01
"""share of the way by which it deviates from a straight line at least: any two straight roads are alike"""


def doubt_of_world(reference: Mapping[int, Array], query: Mapping[int, Array], *, starts: bool = True) -> str:
    """What speaks against a world that the drives share, in words after their names; empty if nothing does.

    Args:
        reference, query: timestamp_ns -> (4, 4) ``T_world_rig``.
        starts: doubt drives that begin at one point; rendered ones may.
    """
    if not reference or not query:
        return ""
    turned = _same_shape(reference, query)
    if turned is not None:
        degrees, metres = turned
        return (
            f"have one shape, turned by {degrees:.1f} deg and up to {metres:.3g} m apart: each is probably in a world "
            "of its own, and pairs across them are wrong unless they share one"
        )
    first, second = (next(iter(poses.values()))[:3, 3] for poses in (reference, query))
    if starts and np.linalg.norm(first - second) <= _SAME_M:
        return (
            "begin at the same point to a millimetre, as drives do that have a world of their own: pairs across them "
            "are right only if they share one"
        )
    return ""


def _same_shape(reference: Mapping[int, Array], query: Mapping[int, Array]) -> tuple[float, float] | None:
    """Degrees and metres by which the query must be moved to lie on the reference; None if it lies there, or never."""
    ways = [_way(poses) for poses in (reference, query)]
    common = min(way[-1, 3] for way in ways)
    if common <= _LEAST_M:
        return None
    a, b = (_sampled(way, common) for way in ways)
    centred_a, centred_b = a - a.mean(axis=0), b - b.mean(axis=0)
    u, sizes, vt = np.linalg.svd(centred_b.T @ centred_a)
    R = vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    off = np.linalg.norm(centred_b @ R.T - centred_a, axis=1)
    if np.sqrt(sizes[1] / _PARTS) < _BENT * common or np.sqrt(np.mean(off**2)) > _ALIKE * common:
        return None
    apart = _nearest(b, ways[0][:, :3])
    if np.median(apart) < max(_LEAST_M, _APART * float(np.median(off))):
        return None
    return float(np.degrees(rotation_angle(R))), float(np.linalg.norm(a - b, axis=1).max())


def _way(poses: Mapping[int, Array]) -> Array:
    """(N, 4) positions, and metres along the way to each."""
    positions = np.array([T[:3, 3] for T in poses.values()])
    return np.column_stack([positions, path_lengths(positions)])


def _sampled(way: Array, metres: float) -> Array:
    """(P, 3) positions at equal distances along the first metres of a way."""
    at = np.linspace(0.0, metres, _PARTS)
    return np.column_stack([np.interp(at, way[:, 3], way[:, axis]) for axis in range(3)])


def _nearest(points: Array, others: Array) -> Array:
    """(N,) distances from points (N, 3) to the nearest of others (M, 3)."""
    from scipy.spatial import cKDTree  # imported late: loading takes half a second

    return np.asarray(cKDTree(others).query(points)[0])
