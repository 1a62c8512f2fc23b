"""Made-up surfaces behind the pixels of a photograph, and where rays of any camera meet them first.

Rays and points are in the frame of the camera that took the photograph; rays have z = 1, so that 1 / depth of a pixel
is that of its ray.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.moved_views.relief_kernel import first_meeting, spline
from relocbench.geometry import Camera, invert

_STEP = 1 / 12
"""of a ray through a relief, as a share of the distance between two of the relief's numbers"""
_MOST_STEPS = 2000


class Surface(Protocol):
    """The surface that a photograph shows."""

    def inverse_depth(self, rays: Array) -> Array:
        """1 / depth (N,) of the photograph's rays (N, 3) with z = 1; not positive where they meet nothing."""
        ...

    def meet(self, centre: Array, directions: Array) -> Array:
        """The first points (N, 3) of rays from a centre (3,) in front of the surface; NaN where they meet nothing.

        Args:
            directions: (N, 3), with z = 1 in the frame of the camera whose rays they are.
        """
        ...


@dataclass(frozen=True, eq=False)
class Planes:
    """The inside of a convex room: a plane, or several such as a road, a house in front and houses at the sides.

    Everything inside a convex room sees all its walls, so that nothing hides anything.
    """

    inverse: Array
    """(P, 3) n / d of each plane: its points X have n . X = d, and the camera is where n . X < d"""

    def inverse_depth(self, rays: Array) -> Array:
        """The plane that a ray meets first is that of the greatest inverse depth."""
        return np.asarray(np.max(rays @ self.inverse.T, axis=-1))

    def meet(self, centre: Array, directions: Array) -> Array:
        """The rays' first points; all NaN if the centre is behind a plane."""
        room = 1.0 - self.inverse @ centre
        if np.any(room <= 0):
            return np.full(directions.shape, np.nan)
        nearness = np.max(directions @ self.inverse.T / room, axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            points = centre + directions / nearness[..., None]
        return np.where(nearness[..., None] > 0, points, np.nan)


@dataclass(frozen=True, eq=False)
class Relief:
    """A smooth surface: its inverse depth is a uniform cubic B-spline over the photograph's image plane.

    Such a spline is smooth to the second derivative and stays within the range of its numbers (de Boor, A Practical
    Guide to Splines, chapter IX). Seen from elsewhere, the surface may hide parts of itself.
    """

    numbers: Array
    """(R, C) positive inverse depths, 1 / metres"""
    origin: tuple[float, float]
    """x and y of the ray of the first number"""
    spacing: float
    """between two numbers, in the same units; the outermost numbers go on beyond the photograph"""

    def inverse_depth(self, rays: Array) -> Array:
        flat = np.ascontiguousarray(rays.reshape(-1, 3), dtype=np.float64)
        return np.asarray(spline(self.numbers, *self.origin, self.spacing, flat)).reshape(rays.shape[:-1])

    def meet(self, centre: Array, directions: Array) -> Array:
        """Rays are followed from where they are nearest to the camera, in steps far below what the spline resolves."""
        flat = np.ascontiguousarray(directions.reshape(-1, 3), dtype=np.float64)
        # A moved camera is so close that depths of the same point differ by less than a factor of two.
        near, far = 2.0 * float(self.numbers.max()), 0.5 * float(self.numbers.min())
        across = float(np.linalg.norm(centre)) * (near - far)
        steps = int(np.clip(np.ceil(across / (_STEP * self.spacing)), 8, _MOST_STEPS))
        found = first_meeting(
            self.numbers, *self.origin, self.spacing, np.ascontiguousarray(centre), flat, near, far, steps
        )
        points = centre + flat / found[:, None]
        return np.asarray(points.reshape(directions.shape))


def points_seen(surface: Surface, camera_query: Camera, T_query_ref: Array, pixels: Array) -> Array:
    """The points (..., 3), in the reference's frame, that the query sees at its pixels (..., 2); NaN if there is none.

    The surface goes on around the reference's image.
    """
    rays, _ = camera_query.unproject(pixels)
    T_ref_query = invert(T_query_ref)
    return surface.meet(T_ref_query[:3, 3], rays @ T_ref_query[:3, :3].T)


def seen_at(surface: Surface, camera_ref: Camera, camera_query: Camera, T_query_ref: Array, pixels: Array) -> Array:
    """The pixels (..., 2) of the reference, or around its image, of :func:`points_seen`; NaN behind its camera."""
    return camera_ref.project(points_seen(surface, camera_query, T_query_ref, pixels))[0]


def shown_at(
    surface: Surface, camera_ref: Camera, camera_query: Camera, T_query_ref: Array, pixels: Array
) -> tuple[Array, Array, Array]:
    """Where the query shows the points of the reference's pixels (N, 2), hidden or not.

    Returns:
        pixels (N, 2) of the query, NaN behind it; depths (N,) in the reference and (N,) in the query, metres.
    """
    rays, _ = camera_ref.unproject(pixels)
    depth = 1.0 / surface.inverse_depth(rays)
    moved = (rays * depth[..., None]) @ T_query_ref[:3, :3].T + T_query_ref[:3, 3]
    return camera_query.project(moved)[0], depth, moved[..., 2]
