"""How much of an agreement is more than three planes.

Three planes fix a pose: any corner of any room can be laid into any other, without a residual and without a gap. Walls
and a floor that agree therefore say nothing for a pose. What speaks for it are the surfaces besides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.groundtruth.submaps.free_space import Patches
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap
from relocbench.datasets.groundtruth.verification.verification import compare_patches
from relocbench.geometry import invert

_PLANES = 3
"""planes that fix the six degrees of freedom of a pose"""
_TRIED = 600
"""patches through each of which a plane is tried"""
_ALIKE, _NEAR_M = 0.97, 0.4
"""cosine of the largest angle, and largest distance, within which patches lie in the plane of one of them"""
_OF_PLANE, _FROM_PLANE_M = 0.94, 0.5
"""the same for the plane that is fitted to these; more is allowed, so that no rim of a wall is left"""


@dataclass(frozen=True)
class Distinct:
    """Evidence from the surfaces outside of the three largest planes of each cloud; the lower of both sides."""

    share: float
    """share, of the surfaces that both clouds measured, that lies outside; 0 if they measured none"""
    overlap: float
    """of the surfaces outside that the other cloud could see, the share that it measured; nan if there are none"""


def distinct_evidence(a: PreparedSubmap, b: PreparedSubmap, T_a_b: Array) -> Distinct:
    """The distinct evidence for a pose of two clouds."""
    sides = [_one_way(a, b, invert(T_a_b)), _one_way(b, a, T_a_b)]
    return Distinct(min(s.share for s in sides), float(np.min([s.overlap for s in sides])))


def _one_way(this: PreparedSubmap, other: PreparedSubmap, T_other_this: Array) -> Distinct:
    compared = compare_patches(this, other, T_other_this)
    patches = this.space.patches
    outside, weights = outside_largest_planes(patches), patches.weights
    agree, expected = (float(weights[m & outside].sum()) for m in (compared.found, compared.expected))
    weight = float(weights[compared.found].sum())
    return Distinct(agree / weight if weight > 0 else 0.0, agree / expected if expected > 0 else float("nan"))


def outside_largest_planes(patches: Patches) -> Mask:
    """(V,) patches in none of the three planes that hold most patches, one after the other."""
    left = np.ones(len(patches), dtype=bool)
    for _ in range(_PLANES):
        rows = np.flatnonzero(left)
        if not len(rows):
            break
        tried = rows[np.linspace(0, len(rows) - 1, min(_TRIED, len(rows))).astype(np.int64)]
        normals, offsets = patches.normals[tried], np.einsum("ni,ni->n", patches.normals[tried], patches.middle[tried])
        held = np.abs(patches.normals[rows] @ normals.T) > _ALIKE
        held &= np.abs(patches.middle[rows] @ normals.T - offsets) < _NEAR_M
        members = rows[held[:, int(np.argmax(held.sum(axis=0)))]]
        middle = patches.middle[members].mean(axis=0)
        # The sum of outer products of normals does not depend on their sign.
        normal = np.linalg.eigh(patches.normals[members].T @ patches.normals[members])[1][:, -1]
        in_plane = np.abs(patches.normals @ normal) > _OF_PLANE
        in_plane &= np.abs((patches.middle - middle) @ normal) < _FROM_PLANE_M
        left[members] = False
        left &= ~in_plane
    return left
