"""Edges in the image, and which samples across them need colours of their own."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from relocbench.datasets.synthetic.raycast import NOTHING
from relocbench.datasets.synthetic.shading import Geometry, Hits

Floats = NDArray[np.float32]
OFFSETS = np.array([[-0.375, -0.125], [0.125, -0.375], [0.375, 0.125], [-0.125, 0.375]], dtype=np.float32)
"""(4, 2) of the samples in a pixel of an edge: a rotated square meets edges near the axes at four places"""


@njit(cache=True, nogil=True, error_model="numpy")
def edge_pixels(geometry: Geometry, triangle: NDArray[np.uint32], hits: Hits, width: int) -> NDArray[np.int64]:
    """Pixels whose right, left, upper or lower neighbour shows another surface."""
    n = len(triangle)
    marked = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        for step in (1, width):
            j = i + step
            if j >= n or (step == 1 and j % width == 0):
                continue
            if not _same_surface(geometry, triangle, hits, i, j):
                marked[i] = True
                marked[j] = True
    return np.flatnonzero(marked)


@njit(cache=True, nogil=True, error_model="numpy")
def _same_surface(geometry: Geometry, triangle: NDArray[np.uint32], hits: Hits, i: int, j: int) -> bool:
    """Whether two pixels show one smooth surface: same object and material, normals alike, no step between."""
    a, b = triangle[i], triangle[j]
    if a == b:
        return True
    if a == NOTHING or b == NOTHING:
        return False
    if geometry.instance[a] != geometry.instance[b] or geometry.material[a] != geometry.material[b]:
        return False
    alike = 0.0
    step = 0.0
    for k in range(3):
        alike += hits.normal[i, k] * hits.normal[j, k]
        step += hits.normal[i, k] * (hits.position[j, k] - hits.position[i, k])
    return alike > 0.9 and abs(step) < 0.02 + 0.002 * hits.depth[i]


@njit(cache=True, nogil=True, error_model="numpy")
def known_colours(
    geometry: Geometry,
    edges: NDArray[np.int64],
    found: NDArray[np.uint32],
    triangle: NDArray[np.uint32],
    hits: Hits,
    width: int,
) -> NDArray[np.int64]:
    """For each sample of the edge pixels (4 E,) the pixel nearby that shows the same surface, or -1.

    ``found`` (4 E,) holds the samples' triangles; ``triangle`` and ``hits`` are those of the pixels' centres.
    """
    n = len(triangle)
    out = np.full(len(found), -1, dtype=np.int64)
    for s in range(len(found)):
        i = edges[s // 4]
        t = found[s]
        for step in (0, 1, -1, width, -width, width + 1, width - 1, -width + 1, -width - 1):
            j = i + step
            if j < 0 or j >= n or abs(j % width - i % width) > 1:
                continue
            if triangle[j] == t or (
                t != NOTHING and triangle[j] != NOTHING and _coplanar(geometry, t, triangle[j], hits, j)
            ):
                out[s] = j
                break
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _coplanar(geometry: Geometry, t: int, other: int, hits: Hits, j: int) -> bool:
    """Whether a triangle continues the surface that pixel j shows."""
    if (
        geometry.material[t] != geometry.material[other]
        or geometry.instance[t] != geometry.instance[other]
        or geometry.variant[t] != geometry.variant[other]
    ):
        return False
    a, b, c = geometry.triangles[t, 0], geometry.triangles[t, 1], geometry.triangles[t, 2]
    v = geometry.vertices
    x1, y1, z1 = v[b, 0] - v[a, 0], v[b, 1] - v[a, 1], v[b, 2] - v[a, 2]
    x2, y2, z2 = v[c, 0] - v[a, 0], v[c, 1] - v[a, 1], v[c, 2] - v[a, 2]
    nx, ny, nz = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
    size = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
    alike = (nx * hits.normal[j, 0] + ny * hits.normal[j, 1] + nz * hits.normal[j, 2]) / size
    return abs(alike) > 0.93


@njit(cache=True, nogil=True, error_model="numpy")
def blend_edges(
    image: Floats, edges: NDArray[np.int64], known: NDArray[np.int64], own: Floats, index: NDArray[np.int64]
) -> Floats:
    """The image (N, 3) with each edge pixel the mean of its centre and its four samples.

    Samples take the colour of a pixel that is known (4 E,), or their own (M, 3) at ``index`` (4 E,).
    """
    out = image.copy()
    for e in range(len(edges)):
        for k in range(3):
            total = image[edges[e], k]
            for s in range(4 * e, 4 * e + 4):
                total += image[known[s], k] if known[s] >= 0 else own[index[s], k]
            out[edges[e], k] = total * 0.2
    return out
