"""Polylines and polygons in the plane."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array


def turns_of(points: Array) -> Array:
    """Turns (P - 2,) at the inner points of a polyline (P, 2), in radians, left positive."""
    step = np.diff(points, axis=0)
    return np.asarray(
        np.arctan2(step[:-1, 0] * step[1:, 1] - step[:-1, 1] * step[1:, 0], (step[:-1] * step[1:]).sum(axis=1))
    )


def loop_turns(polygon: Array) -> Array:
    """Turns (P,) at the points of a closed polygon (P, 2), in radians, left positive."""
    return turns_of(np.concatenate([polygon[-1:], polygon, polygon[:1]]))


def edge_frame(start: Array, end: Array) -> tuple[Array, Array, float]:
    """Unit direction (2,), unit normal to the left (2,) and length of the edge between two points (2,)."""
    direction = end - start
    length = float(np.linalg.norm(direction))
    direction = direction / length
    return direction, np.array([-direction[1], direction[0]]), length


def arc_lengths(points: Array) -> Array:
    """Distances (P,) along a polyline (P, D) from its start to its points."""
    return np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def points_at(points: Array, lengths: Array, s: NDArray[np.floating[Any]]) -> Array:
    """Points (N, 2) at distances s (N,) along a polyline (P, 2) with the given :func:`arc_lengths`."""
    return np.stack([np.interp(s, lengths, points[:, k]) for k in range(2)], axis=1)


def _offset_corner(before: Array, corner: Array, after: Array, first: float, second: float) -> Array:
    """Intersection of the lines before-corner and corner-after, moved left by ``first`` and ``second``."""
    d = np.stack([corner - before, after - corner])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    normal = np.stack([-d[:, 1], d[:, 0]], axis=1)
    if abs(first - second) < 1e-9:
        return np.asarray(corner + first * (normal[0] + normal[1]) / (1 + normal[0] @ normal[1]))
    return np.asarray(corner + np.linalg.solve(normal, [first, second]))


def offset_line(points: Array, offsets: Sequence[float]) -> Array:
    """An open polyline (P, 2) moved left, each segment by its own offset (P - 1), with mitred corners."""
    step = np.diff(points, axis=0)
    normal = np.stack([-step[:, 1], step[:, 0]], axis=1) / np.linalg.norm(step, axis=1, keepdims=True)
    inner = [
        _offset_corner(points[i - 1], points[i], points[i + 1], offsets[i - 1], offsets[i])
        for i in range(1, len(points) - 1)
    ]
    return np.array([points[0] + offsets[0] * normal[0], *inner, points[-1] + offsets[-1] * normal[-1]])


def offset_loop(points: Array, offsets: Sequence[float]) -> Array:
    """A closed polygon (P, 2) moved left; ``offsets[i]`` is for the edge from point i to the next."""
    count = len(points)
    return np.array(
        [
            _offset_corner(points[i - 1], points[i], points[(i + 1) % count], offsets[i - 1], offsets[i])
            for i in range(count)
        ]
    )


def arc_at(before: Array, corner: Array, after: Array, radius: float) -> Array:
    """Points (K, 2) of an arc that rounds a corner; a radius too large for the sides is reduced."""
    turn = float(turns_of(np.stack([before, corner, after]))[0])
    if abs(turn) < 1e-4:
        return corner[None]
    sides = np.linalg.norm(np.stack([corner - before, after - corner]), axis=1)
    tangent = min(abs(radius * np.tan(turn / 2)), 0.48 * float(sides.min()))
    radius = tangent / abs(np.tan(turn / 2))
    forward = (corner - before) / sides[0]
    start = corner - tangent * forward
    centre = start + np.sign(turn) * radius * np.array([-forward[1], forward[0]])
    count = max(3, int(np.ceil(abs(turn) / np.radians(9))) + 1)
    angle = np.linspace(0, turn, count)
    spoke = start - centre
    return np.stack(
        [
            centre[0] + np.cos(angle) * spoke[0] - np.sin(angle) * spoke[1],
            centre[1] + np.sin(angle) * spoke[0] + np.cos(angle) * spoke[1],
        ],
        axis=1,
    )


def rounded(points: Array, radii: Sequence[float]) -> Array:
    """An open polyline with its inner corners rounded by the radii (P - 2)."""
    arcs = [arc_at(points[i - 1], points[i], points[i + 1], radii[i - 1]) for i in range(1, len(points) - 1)]
    return np.concatenate([points[:1], *arcs, points[-1:]])


def resampled(points: Array, step: float) -> Array:
    """Points every ``step`` metres along a polyline (P, 2)."""
    at = arc_lengths(points)
    return points_at(points, at, np.arange(0, at[-1], step))


def area(polygon: Array) -> float:
    """Signed area of a polygon (P, 2), positive if counter-clockwise."""
    x, y = polygon[:, 0], polygon[:, 1]
    return float(0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def inside(polygon: Array, point: Array) -> bool:
    """Whether a point is inside a polygon (P, 2), by ray crossing."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    spans = (a[:, 1] > point[1]) != (b[:, 1] > point[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        x = a[:, 0] + (point[1] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return bool((spans & (x > point[0])).sum() % 2)


def inset(outline: Array, distance: Array | float) -> Array:
    """A closed, finely rounded outline (P, 2) with each point moved left along its own normal, by (P, 1) or alike."""
    ahead, behind = np.roll(outline, -1, axis=0) - outline, outline - np.roll(outline, 1, axis=0)
    unit = ahead / np.linalg.norm(ahead, axis=1, keepdims=True) + behind / np.linalg.norm(behind, axis=1, keepdims=True)
    unit /= np.maximum(np.linalg.norm(unit, axis=1, keepdims=True), 1e-9)
    return outline + distance * np.stack([-unit[:, 1], unit[:, 0]], axis=1)
