"""The field of view of a camera that measures depth.

A lidar that turns sees all around it, so that a surface near it which it did not measure speaks against a pose. What
lies outside a camera's field of view says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, Delaunay, QhullError

from relocbench.arrays import Array, Mask
from relocbench.datasets.groundtruth.submaps.submaps import Submap

_WIDEST = 0.26
"""cosine of half the angle of the widest field of view of a camera, 150 degrees; what is wider is taken to be all
around"""


@dataclass(frozen=True, eq=False)
class FieldOfView:
    """The convex field of view of a sensor that did not move."""

    position: Array
    """(3,) of the sensor"""
    T_plane: Array
    """(3, 3) rows: two axes across the view and its middle direction"""
    outline: Delaunay
    """of the directions in view, where they meet a plane at distance 1"""

    @staticmethod
    def of(submap: Submap) -> FieldOfView | None:
        """The field of view that a submap's points fill; None if it is all around, or the sensor moved."""
        position = submap.origins[0].astype(np.float64)
        if np.abs(submap.origins - submap.origins[0]).max() > 1e-3:
            return None
        directions = _unit(submap.points.astype(np.float64) - position)
        middle = _unit(directions.mean(axis=0))
        if float((directions @ middle).min()) < _WIDEST:
            return None
        across = np.linalg.svd(middle[None])[2][1:]
        axes = np.vstack([across, middle])
        try:
            flat = _flat(directions @ axes.T)
            return FieldOfView(position, axes, Delaunay(flat[ConvexHull(flat).vertices]))
        except QhullError:
            return None

    def holds(self, points: Array) -> Mask:
        """(N,) whether points (N, 3) in the submap's frame lie in the field of view."""
        there = (points - self.position) @ self.T_plane.T
        ahead = there[:, 2] > 0
        out = np.zeros(len(points), dtype=bool)
        out[ahead] = self.outline.find_simplex(_flat(there[ahead])) >= 0
        return out


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


def _flat(directions: Array) -> Array:
    return np.asarray(directions[:, :2] / directions[:, 2:])
