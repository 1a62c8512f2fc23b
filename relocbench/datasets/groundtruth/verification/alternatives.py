"""Alternative poses, made by the typical errors of registration on streets: shifted along, and turned by 180 degrees.

Facades repeat. The fit of a query is measured at shifts along the whole street, and each shift that fits about as well
as the best one gives another guess. A good fit is no proof, so verification decides between the guesses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap
from relocbench.geometry import apply, make_transform, so3_exp

_LEVEL = 1
_COSINE = 0.7


@dataclass(frozen=True)
class ShiftOptions:
    """Options of the search for alternative poses."""

    reach_m: float = 30.0
    """largest shift along the street, both ways"""
    step_m: float = 0.4
    """distance between the shifts that are tried"""
    near_m: float = 0.4
    """largest distance between a point and the surface that it matches"""
    apart_m: float = 1.5
    """least distance between two alternatives"""
    share: float = 0.75
    """share of the best fit that an alternative must reach"""
    most: int = 6
    """largest number of alternatives of each kind"""
    points: int = 500
    """number of points that the fit is measured with"""


def street_direction(planes: PlaneMap) -> Array:
    """(3,) unit vector in the submap's frame in which the car drove; the x axis if it hardly moved."""
    origins = planes.submap.origins.astype(np.float64)
    centred = origins - origins.mean(axis=0)
    values, vectors = np.linalg.eigh(centred.T @ centred / len(origins))
    direction = vectors[:, -1] if values[-1] > 1.0 else np.array([1.0, 0.0, 0.0])
    return np.asarray(direction * (1.0 if direction[0] >= 0 else -1.0))


def fit(ref: PlaneMap, query: PlaneMap, T_ref_query: Array, options: ShiftOptions) -> float:
    """Share of the query's planes, sampled evenly over directions, that match a plane of the reference."""
    sample, planes = query.sample(_LEVEL), ref.level(_LEVEL)
    rows = np.arange(0, len(sample), max(len(sample) // options.points, 1))
    moved = apply(T_ref_query, sample.points[rows])
    match = planes.nearest(moved, sample.normals[rows] @ T_ref_query[:3, :3].T, options.near_m, _COSINE)
    return float(np.mean(match >= 0)) if len(rows) else 0.0


def shifted_poses(
    ref: PlaneMap, query: PlaneMap, T_ref_query: Array, options: ShiftOptions | None = None, along: Array | None = None
) -> list[Array]:
    """Poses shifted along the street at which the query fits about as well as at the best one, best fit first.

    Args:
        along: (3,) another unit vector to shift along, in the reference's frame.
    """
    o = options or ShiftOptions()
    along = street_direction(ref) if along is None else along
    steps = np.arange(-round(o.reach_m / o.step_m), round(o.reach_m / o.step_m) + 1) * o.step_m
    moved = [make_transform(np.eye(3), s * along) @ T_ref_query for s in steps]
    fits = np.array([fit(ref, query, T, o) for T in moved])
    kept: list[int] = []
    for i in np.argsort(-fits, kind="stable"):
        if len(kept) == o.most or fits[i] < o.share * fits.max():
            break
        if all(abs(steps[i] - steps[k]) >= o.apart_m for k in kept):
            kept.append(int(i))
    return [moved[i] for i in kept]


def turned_around(T_ref_query: Array) -> Array:
    """The pose turned by 180 degrees about the query's vertical axis."""
    return np.asarray(T_ref_query @ make_transform(so3_exp([0.0, 0.0, np.pi]), [0.0, 0.0, 0.0]))


def alternatives(
    ref: PlaneMap, query: PlaneMap, T_ref_query: Array, options: ShiftOptions | None = None
) -> list[Array]:
    """A guess, its shifts along the street, and the shifts of the guess turned by 180 degrees."""
    slid = shifted_poses(ref, query, T_ref_query, options)
    return [T_ref_query, *slid, *shifted_poses(ref, query, turned_around(T_ref_query), options)]
