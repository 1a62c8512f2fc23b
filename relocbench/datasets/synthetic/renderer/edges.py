"""Anti-aliasing: edges in the image, and the samples across them that have to be shaded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Floats, Indices
from relocbench.datasets.synthetic.renderer.samples import PIXEL_OFFSETS, View, ray
from relocbench.datasets.synthetic.renderer.surfaces import Geometry, Hits, corner
from relocbench.datasets.synthetic.renderer.vectors import cross, dot, subtract
from relocbench.datasets.synthetic.town.raycast import NOTHING
from relocbench.kernels import njit

_CONTRAST = 0.04
"""least difference of two pixels relative to their sum that makes an edge worth smoothing"""
_AROUND = ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
"""row and column offsets of a pixel and its neighbours, the nearest first"""
_CACHE_SIZE = 256
"""triangles"""


def surface_names(geometry: Geometry) -> NDArray[np.uint32]:
    """A number (T,) for each triangle that is the same for the same object, material and variant."""
    name = geometry.instance * np.uint32(0x9E3779B1)
    name ^= geometry.variant * np.uint32(0x85EBCA6B)
    return np.asarray(name * np.uint32(32) + geometry.material)


@njit(cache=True, nogil=True, error_model="numpy")
def edge_pixels(
    names: NDArray[np.uint32], triangle: NDArray[np.uint32], hits: Hits, light: Floats, width: int
) -> Indices:
    """Pixels with a horizontal or vertical neighbour that shows another surface and differs in brightness.

    Two pixels show the same surface if they have the same name (see :func:`surface_names`), similar normals and no step
    in between.
    """
    n = len(triangle)
    depth, normal, position = hits.depth, hits.normal, hits.position
    marked = np.zeros(n, dtype=np.bool_)
    column = -1
    for i in range(n):
        column = column + 1 if column < width - 1 else 0
        for k in range(2):
            j = i + (1 if k == 0 else width)
            if j >= n or (k == 0 and column == width - 1):
                continue
            a, b = triangle[i], triangle[j]
            if a == b:
                continue
            total = light[i, 0] + light[i, 1] + light[i, 2] + light[j, 0] + light[j, 1] + light[j, 2]
            apart = abs(light[i, 0] - light[j, 0]) + abs(light[i, 1] - light[j, 1]) + abs(light[i, 2] - light[j, 2])
            if apart < _CONTRAST * total:
                continue
            if a != NOTHING and b != NOTHING and names[a] == names[b]:
                alike = normal[i, 0] * normal[j, 0] + normal[i, 1] * normal[j, 1] + normal[i, 2] * normal[j, 2]
                step = (
                    normal[i, 0] * (position[j, 0] - position[i, 0])
                    + normal[i, 1] * (position[j, 1] - position[i, 1])
                    + normal[i, 2] * (position[j, 2] - position[i, 2])
                )
                if alike > 0.9 and abs(step) < 0.02 + 0.002 * depth[i]:
                    continue
            marked[i] = True
            marked[j] = True
    return np.flatnonzero(marked)


@njit(cache=True, nogil=True, error_model="numpy")
def neighbours_seen(
    view: View, geometry: Geometry, edges: Indices, triangle: NDArray[np.uint32], width: int
) -> Indices:
    """For each sample of the edge pixels (4 E,) the nearby pixel whose triangle it hits first, or -1 if it hits none.

    Only the triangles shown by the surrounding 3 x 3 pixels are tested, which nearly always include the right one and
    cost a tenth of a ray. A ray from o along d hits the triangle with corners o + A, o + B, o + C if d.(A x B),
    d.(B x C) and d.(C x A) have the same sign, at the parameter A.(B x C) divided by their sum.
    """
    n = len(triangle)
    out = np.full(4 * len(edges), -1, dtype=np.int64)
    tried = np.empty(9, dtype=np.uint32)
    nearest = np.empty(4)
    # Neighbouring edge pixels test the same triangles, so recent ones are cached by their numbers.
    cached = np.full(_CACHE_SIZE, NOTHING, dtype=np.uint32)
    planes = np.empty((_CACHE_SIZE, 10))
    o = (view.origin[0], view.origin[1], view.origin[2])
    for e in range(len(edges)):
        i = edges[e]
        column = i % width
        d0, _, _ = ray(view, column + PIXEL_OFFSETS[0, 0], i // width + PIXEL_OFFSETS[0, 1])
        d1, _, _ = ray(view, column + PIXEL_OFFSETS[1, 0], i // width + PIXEL_OFFSETS[1, 1])
        d2, _, _ = ray(view, column + PIXEL_OFFSETS[2, 0], i // width + PIXEL_OFFSETS[2, 1])
        d3, _, _ = ray(view, column + PIXEL_OFFSETS[3, 0], i // width + PIXEL_OFFSETS[3, 1])
        nearest[:] = np.inf
        count = 0
        for step, aside in _AROUND:
            j = i + step * width + aside
            if j < 0 or j >= n or not 0 <= column + aside < width:
                continue
            t = triangle[j]
            new = t != NOTHING
            for k in range(count):
                new &= tried[k] != t
            if not new:
                continue
            tried[count] = t
            count += 1
            slot = t % _CACHE_SIZE
            if cached[slot] != t:
                cached[slot] = t
                A = subtract(corner(geometry.vertices, geometry.triangles[t, 0]), o)
                B = subtract(corner(geometry.vertices, geometry.triangles[t, 1]), o)
                C = subtract(corner(geometry.vertices, geometry.triangles[t, 2]), o)
                AB, BC, CA = cross(A, B), cross(B, C), cross(C, A)
                for k in range(3):
                    planes[slot, k], planes[slot, 3 + k], planes[slot, 6 + k] = AB[k], BC[k], CA[k]
                planes[slot, 9] = dot(A, BC)
            AB = (planes[slot, 0], planes[slot, 1], planes[slot, 2])
            BC = (planes[slot, 3], planes[slot, 4], planes[slot, 5])
            CA = (planes[slot, 6], planes[slot, 7], planes[slot, 8])
            volume = planes[slot, 9]
            for k in range(4):
                d = d0 if k == 0 else (d1 if k == 1 else (d2 if k == 2 else d3))
                x, y, z = dot(d, AB), dot(d, BC), dot(d, CA)
                if (x >= 0.0 and y >= 0.0 and z >= 0.0) or (x <= 0.0 and y <= 0.0 and z <= 0.0):
                    depth = volume / (x + y + z)
                    if 0.0 < depth < nearest[k]:
                        nearest[k] = depth
                        out[4 * e + k] = j
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def known_colours(
    geometry: Geometry,
    names: NDArray[np.uint32],
    pixels: Indices,
    found: NDArray[np.uint32],
    triangle: NDArray[np.uint32],
    hits: Hits,
    width: int,
) -> Indices:
    """For each sample (S,) the nearby pixel that shows the same surface, or -1.

    ``pixels`` and ``found`` (S,) hold the samples' pixels and triangles; ``triangle`` and ``hits`` are those of all
    pixels' centres.
    """
    n = len(triangle)
    out = np.full(len(found), -1, dtype=np.int64)
    for s in range(len(found)):
        i = pixels[s]
        t = found[s]
        for step, aside in _AROUND:
            j = i + step * width + aside
            if j < 0 or j >= n or not 0 <= i % width + aside < width:
                continue
            other = triangle[j]
            if other == t:
                out[s] = j
                break
            if t == NOTHING or other == NOTHING or names[t] != names[other]:
                continue
            if abs(_cosine(geometry.vertices, geometry.triangles, t, hits.normal, j)) > 0.93:
                out[s] = j
                break
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _cosine(vertices: Floats, triangles: NDArray[np.uint32], t: int, normal: Floats, j: int) -> float:
    """Cosine of the angle between the normals of a triangle and of a pixel."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    x1, y1, z1 = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    x2, y2, z2 = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    nx, ny, nz = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
    size = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
    return float((nx * normal[j, 0] + ny * normal[j, 1] + nz * normal[j, 2]) / size)


@njit(cache=True, nogil=True, error_model="numpy")
def blend_edges(image: Floats, edges: Indices, known: Indices, own: Floats, index: Indices) -> Floats:
    """The image (N, 3) in which each edge pixel is the mean of its centre and its four samples.

    A sample has the colour of pixel ``known`` (4 E,) or, if that is -1, of ``own`` (M, 3) at ``index`` (4 E,).
    """
    out = image.copy()
    for e in range(len(edges)):
        for k in range(3):
            total = image[edges[e], k]
            for s in range(4 * e, 4 * e + 4):
                total += image[known[s], k] if known[s] >= 0 else own[index[s], k]
            out[edges[e], k] = total * 0.2
    return out
