"""Exact correspondences by ray casting.

Stored depth is rounded to 1/256 m, which moves a near point by up to a tenth of a pixel in the query. Here nothing is
rounded: the depth of a reference pixel is that of its ray, and a point is visible if the ray from the query's centre
towards it ends at it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Image, Mask
from relocbench.datasets.core.images import MOST_DEPTH_M
from relocbench.datasets.pairs.correspondences import PairCorrespondences, exact_pair, sampled_pixels
from relocbench.datasets.pairs.visibility import warp
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.datasets.synthetic.town.moving import Moving
from relocbench.geometry import Camera, apply, invert
from relocbench.tracking import Reference

_ROUNDINGS = 4
"""tolerance perpendicular to the surface, in units of single-precision rounding of the district's coordinates, since
rays are cast in single precision (at most 2.3 were observed)"""
_TOLERANCE_M = 0.002
_RELATIVE_TOLERANCE = 5e-4
"""tolerance along the ray, for rays that meet the surface at a grazing angle"""
_GRID = (20, 15)
"""columns and rows of pixels by which an overlap is guessed"""


@dataclass(frozen=True, eq=False)
class View:
    """One camera at one moment of one traversal."""

    place: DistrictSpec
    factors: Factors
    camera: Camera
    T_world_cam: Array
    moving: tuple[Moving, ...] = ()

    def cast(self, origins: Array, directions: Array) -> tuple[Array, Mask]:
        """Distances (N,) along unit rays (N, 3) to the first surface, inf if none, and whether it moves (N,)."""
        distance = scenes.static_scene(self.place, self.factors).hits(origins, directions).range
        others = scenes.moving_scene(self.moving)
        if others is None:
            return distance, np.zeros(len(distance), dtype=bool)
        to_other = others.hits(origins, directions).range
        return np.minimum(distance, to_other), to_other < distance

    def depth(self, pixels: Array) -> tuple[Array, Mask]:
        """Depth along z (N,) of pixels (N, 2), inf if there is none, and whether they show what moves (N,)."""
        origins, directions, lengths = scenes.pixel_rays(self.camera, self.T_world_cam, pixels)
        distance, moves = self.cast(origins, directions)
        return distance / lengths, moves

    def points(self, pixels: Array, depth: Array) -> Array:
        """The world points (N, 3) of pixels (N, 2) with depth (N,) along z."""
        rays, _ = self.camera.unproject(pixels)
        return apply(self.T_world_cam, rays * depth[:, None])

    def sees(self, points: Array) -> Mask:
        """Whether each world point (N, 3) lies on a surface and nothing is in front of it."""
        offset = points - self.T_world_cam[:3, 3]
        far = np.linalg.norm(offset, axis=1)
        directions = offset / far[:, None]
        origins = np.broadcast_to(self.T_world_cam[:3, 3], offset.shape).copy()
        hits = scenes.static_scene(self.place, self.factors).hits(origins, directions)
        met = np.isfinite(hits.range)
        slant = np.abs(np.sum(hits.normal * directions, axis=1))
        off = np.abs(np.where(met, hits.range, 0.0) - far)
        across = _ROUNDINGS * float(np.spacing(np.float32(self.place.extent_m)))
        seen = met & (off * slant <= across) & (off <= _TOLERANCE_M + _RELATIVE_TOLERANCE * far)
        others = scenes.moving_scene(self.moving)
        if others is not None:
            seen &= hits.range <= others.hits(origins, directions).range
        return np.asarray(seen)


def exact_correspondences(
    views: tuple[View, View],
    reference: Reference,
    query_image: Image,
    T_query_ref: Array,
    count: int,
    rng: np.random.Generator,
) -> PairCorrespondences:
    """Up to ``count`` correspondences of a pair, spread over the reference image, and the pair's measures.

    They are sampled from the pixels whose point is static and projects into the query's image, visible or hidden.

    Args:
        views: of the keyframe and of the query.
        reference: the keyframe as the dataset has it.
    """
    keyframe, query = views
    camera = keyframe.camera
    pixels = sampled_pixels(camera, count, rng)
    depth, moves = keyframe.depth(pixels)
    known = (depth <= MOST_DEPTH_M) & ~moves
    pixels, depth = pixels[known], depth[known]
    uv_query, _, valid = warp(np.column_stack([pixels, depth]), camera, query.camera, T_query_ref)
    inside = valid & query.camera.contains(uv_query)
    visible = inside.copy()
    visible[inside] = query.sees(keyframe.points(pixels, depth)[inside])
    back = _overlap_of_query(keyframe, query, sampled_pixels(query.camera, 0, np.random.default_rng(0)))
    found = pixels, depth, uv_query, inside, visible
    return exact_pair(reference, *found, count, rng, query.camera, T_query_ref, back, query_image)


def guessed_overlap_of_query(keyframe: View, query: View) -> float:
    """The share of the query's static points that the keyframe sees, by a grid of some hundred pixels; 0 for none."""
    columns, rows = _GRID
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    pixels = np.floor(np.column_stack([u.ravel() * query.camera.width, v.ravel() * query.camera.height]))
    return _overlap_of_query(keyframe, query, pixels) or 0.0


def _overlap_of_query(keyframe: View, query: View, pixels: Array) -> float | None:
    """The share of the query's pixels (N, 2) with static points that the keyframe sees; None where it shows none."""
    depth, moves = query.depth(pixels)
    known = (depth <= MOST_DEPTH_M) & ~moves
    if not known.any():
        return None
    points = query.points(pixels[known], depth[known])
    uv, in_front = keyframe.camera.project(apply(invert(keyframe.T_world_cam), points))
    inside = in_front & keyframe.camera.contains(uv)
    return float(np.count_nonzero(keyframe.sees(points[inside])) / len(points))
