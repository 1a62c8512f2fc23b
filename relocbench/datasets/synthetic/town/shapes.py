"""Shapes in local coordinates, made of triangles, quads, boxes and tubes, and their placement as objects of a mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relocbench.arrays import Array, Bytes, Floats, Indices
from relocbench.datasets.synthetic.town.mesh import Mesh, Semantic


@dataclass(frozen=True, eq=False)
class Shape:
    """T triangles over V vertices in metres, counter-clockwise seen from outside."""

    vertices: Array
    """(V, 3)"""
    triangles: Indices
    """(T, 3) rows of vertices"""
    uv: Array
    """(T, 3, 2) surface coordinates in metres"""
    material: Bytes
    """(T,)"""
    variant: NDArray[np.uint32]
    """(T,) combined with the object's variant by XOR, so that for example the windows of a house differ"""
    rank: Floats
    """(T,) as in :class:`Mesh`"""

    def __len__(self) -> int:
        return len(self.triangles)


def cross(a: Array, b: Array) -> Array:
    """Cross products (N, 3); faster than numpy's for the many small arrays here."""
    x, y, z = a.T
    u, v, w = b.T
    return _columns(y * w - z * v, z * u - x * w, x * v - y * u)


def _columns(*columns: Array) -> Array:
    """Arrays (N,) side by side (N, C)."""
    result = np.empty((len(columns[0]), len(columns)))
    for k, column in enumerate(columns):
        result[:, k] = column
    return result


def _lengths(vectors: Array) -> Array:
    """Lengths (N, 1) of vectors (N, 3)."""
    return np.asarray(np.sqrt(np.add.reduce(vectors * vectors, axis=1, keepdims=True)))


def at_height(points: Array, z: float) -> Array:
    """Points (..., 2) of the plane at height z: (..., 3)."""
    return np.concatenate([points, np.full((*points.shape[:-1], 1), z)], axis=-1)


def planar_uv(corners: Array) -> Array:
    """Surface coordinates (T, 3, 2) in metres of triangles (T, 3, 3): u horizontal, v up the slope.

    Triangles in the same plane have the same coordinate system, so that a texture continues across them.
    """
    normal = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(_lengths(normal), 1e-12)
    across = _columns(-normal[:, 1], normal[:, 0], np.zeros(len(normal)))
    level = _lengths(across)[:, 0] < 1e-3
    across[level] = (1.0, 0.0, 0.0)
    across /= _lengths(across)
    uv = np.empty((len(corners), 3, 2))
    uv[..., 0] = np.einsum("tci,ti->tc", corners, across)
    uv[..., 1] = np.einsum("tci,ti->tc", corners, cross(normal, across))
    return uv


def triangle_shape(
    vertices: ArrayLike,
    triangles: ArrayLike,
    material: ArrayLike,
    uv: Array | None = None,
    variant: ArrayLike = 0,
    rank: ArrayLike = 0.0,
) -> Shape:
    """A shape of triangles, with planar coordinates unless ``uv`` is given; the other attributes broadcast to (T,)."""
    points = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    rows = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    count = len(rows)
    return Shape(
        points,
        rows,
        planar_uv(points[rows]) if uv is None else uv,
        np.full(count, material, dtype=np.uint8),
        np.full(count, variant, dtype=np.uint32),
        np.full(count, rank, dtype=np.float32),
    )


def quads(points: ArrayLike, material: ArrayLike, uv: Array | None = None, variant: ArrayLike = 0) -> Shape:
    """A shape of quadrilaterals (..., 4, 3), two triangles each; ``uv`` is (Q, 4, 2), the rest broadcast to (Q,)."""
    corners = np.asarray(points, dtype=np.float64).reshape(-1, 4, 3)
    count = len(corners)
    split = np.array([[0, 1, 2], [0, 2, 3]])
    rows = (4 * np.arange(count)[:, None, None] + split).reshape(-1, 3)
    look, other = (np.repeat(a, 2) if np.ndim(a) else a for a in (material, variant))
    corner_uv = None if uv is None else uv.reshape(count, 4, 2)[:, split].reshape(-1, 3, 2)
    return triangle_shape(corners.reshape(-1, 3), rows, look, corner_uv, other)


def join(shapes: Sequence[Shape]) -> Shape:
    """Concatenate shapes."""
    offsets = np.cumsum([0, *(len(s.vertices) for s in shapes)])[:-1]
    return Shape(
        np.concatenate([s.vertices for s in shapes]),
        np.concatenate([s.triangles + o for s, o in zip(shapes, offsets, strict=True)]),
        *(np.concatenate([getattr(s, name) for s in shapes]) for name in ("uv", "material", "variant", "rank")),
    )


def moved(shape: Shape, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Shape:
    """The shape shifted."""
    return replace(shape, vertices=shape.vertices + np.array([x, y, z]))


_BOX_FACES = {
    "front": ((0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)),
    "right": ((1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)),
    "back": ((1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1)),
    "left": ((0, 1, 0), (0, 0, 0), (0, 0, 1), (0, 1, 1)),
    "top": ((0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)),
    "bottom": ((0, 1, 0), (1, 1, 0), (1, 0, 0), (0, 0, 0)),
}


def boxes(low: ArrayLike, high: ArrayLike, material: ArrayLike, without: str = "", variant: ArrayLike = 0) -> Shape:
    """Axis-aligned boxes between corners (N, 3), without the faces named in ``without`` (front is -y, right +x)."""
    lower, upper = np.atleast_2d(np.asarray(low, dtype=float)), np.atleast_2d(np.asarray(high, dtype=float))
    faces = np.array([f for name, f in _BOX_FACES.items() if name not in without.split()], dtype=float)
    points = lower[:, None, None] + faces[None] * (upper - lower)[:, None, None]
    spread = [np.repeat(np.broadcast_to(np.asarray(a), (len(lower),)), len(faces)) for a in (material, variant)]
    return quads(points, spread[0], variant=spread[1])


def boxes_of(rows: ArrayLike, material: ArrayLike, without: str = "", variant: ArrayLike = 0) -> Shape:
    """Like :func:`boxes`, for rows (N, 6) of x0, y0, z0, x1, y1, z1."""
    corners = np.asarray(rows, dtype=float)
    return boxes(corners[:, :3], corners[:, 3:], material, without, variant)


def tube(points: ArrayLike, radii: ArrayLike, sides: int, material: int) -> Shape:
    """A closed tube along a polyline (P, 3) with a radius at each point; along a straight line, a solid of revolution.

    Surface coordinates are the arc lengths around and along it, and on its ends those of the plane.
    """
    axis = np.asarray(points, dtype=float)
    radius = np.broadcast_to(np.asarray(radii, dtype=float), (len(axis),))
    step = axis[1:] - axis[:-1]
    along = np.empty_like(axis)
    along[0], along[-1], along[1:-1] = step[0], step[-1], (step[1:] + step[:-1]) / 2
    chord = axis[-1] - axis[0]
    off = cross(axis - axis[0], chord[None])
    if np.sqrt((off * off).sum()) < 1e-9:
        along[:] = chord  # the profile of a solid of revolution may go back and forth along its axis
    along /= _lengths(along)
    start = np.eye(3)[np.abs(along).max(axis=0).argmin()]
    side = cross(along, start[None])
    side /= _lengths(side)
    other = cross(along, side)
    turn = 2 * np.pi * np.arange(sides) / sides
    circle = _columns(np.cos(turn), np.sin(turn))
    ring = circle[None, :, :1] * side[:, None] + circle[None, :, 1:] * other[:, None]
    vertices = (axis[:, None] + radius[:, None, None] * ring).reshape(-1, 3)
    rows, around, at = _tube_rows(len(axis), sides)
    length = np.concatenate([[0], np.cumsum(_lengths(step))])
    arc = 2 * np.pi * radius.mean() / sides
    walls = len(rows) - 2 * (sides - 2)
    uv = np.empty((len(rows), 3, 2))
    uv[:walls, :, 0], uv[:walls, :, 1] = around * arc, length[at]
    uv[walls:] = circle[rows[walls:] % sides]
    uv[walls : walls + sides - 2] *= radius[0]
    uv[walls + sides - 2 :] *= radius[-1]
    return triangle_shape(vertices, rows, material, uv)


@cache
def _tube_rows(points: int, sides: int) -> tuple[Indices, Indices, Indices]:
    """Of a tube's triangles, first those around and then those of both ends: rows of vertices (T, 3), and of those
    around it the number of the side and of the point (., 3) at each corner."""
    i, j = np.meshgrid(np.arange(points - 1), np.arange(sides), indexing="ij")
    a, b = i * sides + j, i * sides + (j + 1) % sides
    c, d = b + sides, a + sides
    rows = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2).reshape(-1, 3)
    around = np.stack([np.stack([j, j + 1, j + 1], -1), np.stack([j, j + 1, j], -1)], axis=2).reshape(-1, 3)
    at = np.stack([np.stack([i, i, i + 1], -1), np.stack([i, i + 1, i + 1], -1)], axis=2).reshape(-1, 3)
    fan = np.array([[0, k + 1, k] for k in range(1, sides - 1)])
    return np.concatenate([rows, fan, fan[:, ::-1] + (points - 1) * sides]), around, at


def fan(outline: Array, middle: ArrayLike) -> Array:
    """Quads (P, 4, 3) that fill a closed outline (P, 3) from a middle (3,), one for each of its sides."""
    after = np.roll(outline, -1, axis=0)
    return np.stack([np.broadcast_to(middle, outline.shape), outline, (outline + after) / 2, after], axis=1)


def skin(x: Array, rings: Array) -> tuple[Array, Indices]:
    """A closed surface of rings (C, P, 2) of (y, z) at places x (C,): vertices (C P, 3) and triangles (T, 3).

    First come two triangles for each of the P sides between two rings, then those of both ends.
    """
    count, size = rings.shape[:2]
    vertices = np.concatenate([np.broadcast_to(x[:, None, None], (count, size, 1)), rings], axis=2)
    i, j = np.meshgrid(np.arange(count - 1), np.arange(size), indexing="ij")
    a, b = i * size + j, i * size + (j + 1) % size
    walls = np.stack([np.stack([a, a + size, b + size], -1), np.stack([a, b + size, b], -1)], axis=2)
    end = np.array([[0, k, k + 1] for k in range(1, size - 1)])
    return vertices.reshape(-1, 3), np.concatenate([walls.reshape(-1, 3), end, end[:, ::-1] + (count - 1) * size])


def ear_clip(polygon: Array) -> Indices:
    """Triangulation (P - 2, 3) of a simple counter-clockwise polygon (P, 2) by ear clipping, as rows of the polygon."""
    left = list(range(len(polygon)))
    triangles: list[tuple[int, int, int]] = []
    while len(left) > 3:
        scores = [_ear_score(polygon, left, k) for k in range(len(left))]
        k = int(np.argmax(scores))
        triangles.append((left[k - 1], left[k], left[(k + 1) % len(left)]))
        del left[k]
    triangles.append((left[0], left[1], left[2]))
    return np.array(triangles, dtype=np.int64)


def _ear_score(polygon: Array, left: list[int], k: int) -> float:
    """Quality of the ear at ``k``, twice its area over its squared longest side, or -1 if there is no ear."""
    corners = polygon[[left[k - 1], left[k], left[(k + 1) % len(left)]]]
    edges = np.roll(corners, -1, axis=0) - corners
    area = edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0]
    if area <= 1e-12:
        return -1.0
    others = polygon[[i for n, i in enumerate(left) if n not in ((k - 1) % len(left), k, (k + 1) % len(left))]]
    to_point = others[:, None] - corners[None]
    inside = (edges[None, :, 0] * to_point[:, :, 1] - edges[None, :, 1] * to_point[:, :, 0] >= -1e-12).all(axis=1)
    return -1.0 if inside.any() else float(area / (edges**2).sum(axis=1).max())


def instances(shape: Shape, transforms: Array, instance: ArrayLike, variant: ArrayLike, semantic: Semantic) -> Mesh:
    """N copies of a shape under transforms (N, 4, 4) with uniform scale; ``instance`` and ``variant`` are (N,)."""
    count, faces = len(transforms), len(shape)
    vertices = np.einsum("nij,vj->nvi", transforms[:, :3, :3], shape.vertices) + transforms[:, None, :3, 3]
    rows = shape.triangles[None] + (len(shape.vertices) * np.arange(count))[:, None, None]
    scale = np.linalg.norm(transforms[:, :3, 0], axis=1)
    looks = np.asarray(variant, dtype=np.uint32)[:, None] ^ shape.variant[None]
    return Mesh(
        vertices.reshape(-1, 3).astype(np.float32),
        rows.reshape(-1, 3).astype(np.uint32),
        (scale[:, None, None, None] * shape.uv[None]).reshape(-1, 3, 2).astype(np.float32),
        np.tile(shape.material, count),
        np.full(count * faces, int(semantic), dtype=np.uint8),
        np.repeat(np.asarray(instance, dtype=np.uint32), faces),
        np.ascontiguousarray(looks.reshape(-1)),
        np.tile(shape.rank, count),
    )


def single(shape: Shape, instance: int, variant: int, semantic: Semantic) -> Mesh:
    """A mesh of the shape as one object, without a transform."""
    return instances(shape, np.eye(4)[None], np.array([instance]), np.array([variant]), semantic)


def poses(x: ArrayLike, y: ArrayLike, z: ArrayLike, yaw: ArrayLike, scale: ArrayLike = 1.0) -> Array:
    """Transforms (N, 4, 4) that scale, turn by ``yaw`` about z and move to (x, y, z); all arguments broadcast."""
    px, py, pz, angle, size = np.broadcast_arrays(*(np.atleast_1d(np.asarray(a, float)) for a in (x, y, z, yaw, scale)))
    result = np.zeros((len(px), 4, 4))
    result[:, 0, 0] = result[:, 1, 1] = size * np.cos(angle)
    result[:, 1, 0] = size * np.sin(angle)
    result[:, 0, 1] = -result[:, 1, 0]
    result[:, 2, 2] = size
    result[:, :3, 3] = np.stack([px, py, pz], axis=1)
    result[:, 3, 3] = 1
    return result
