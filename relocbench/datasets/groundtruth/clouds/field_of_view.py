"""What a sensor has in view: the cone of the directions that it measured, as far as these fill no more than a cone.

A depth camera measures a pyramid, and a surface beside it says nothing about a pose. The convex hull of the measured
directions is used rather than the directions themselves: where a sensor measured nothing between others, on glass, on
black things or into the sky, it looked all the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from relocbench.arrays import Array, Mask

_WIDEST_DEG = 75.0
"""half angle of the widest cone; a sensor that measured further around is supposed to have everything in view"""
_FEWEST = 50


@dataclass(frozen=True, eq=False)
class FieldOfView:
    """A convex cone with its tip at a sensor."""

    position: Array
    """(3,) of the sensor"""
    sides: Array
    """(F, 3) outward unit normals of the planes through the sensor that bound the cone; none if all is in view"""

    def holds(self, points: Array) -> Mask:
        """(N,) whether points (N, 3) lie in the cone."""
        rays = points - self.position
        inside = np.ones(len(rays), dtype=bool)
        for side in self.sides:
            inside &= rays @ side <= 0
        return inside


def field_of_view(position: Array, points: Array) -> FieldOfView:
    """The field of view of a sensor at a position (3,) that measured points (N, 3)."""
    everything = FieldOfView(position, np.zeros((0, 3)))
    rays = points - position
    lengths = np.linalg.norm(rays, axis=1)
    rays = rays[lengths > 0] / lengths[lengths > 0, None]
    if len(rays) < _FEWEST:
        return everything
    axis = rays.mean(axis=0)
    axis /= max(float(np.linalg.norm(axis)), 1e-12)
    if float(np.min(rays @ axis)) < np.cos(np.radians(_WIDEST_DEG)):
        return everything
    # Planes through the sensor are lines on a plane across the axis, and the cone is a convex polygon on it.
    across = np.linalg.svd(axis[None])[2][1:]
    flat = (rays @ across.T) / (rays @ axis)[:, None]
    try:
        lines = ConvexHull(flat).equations
    except QhullError:  # all directions in one plane: a scanner of a single line
        return everything
    sides = lines[:, :2] @ across + lines[:, 2:] * axis
    return FieldOfView(position, sides / np.linalg.norm(sides, axis=1, keepdims=True))
