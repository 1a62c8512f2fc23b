"""Ray casting by Embree (Open3D's RaycastingScene), single-threaded in each worker."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from relocbench.arrays import Floats, Indices, Mask
from relocbench.datasets.synthetic.town.mesh import Mesh
from relocbench.kernels import njit

NOTHING = 0xFFFFFFFF
"""triangle number of a ray that hits nothing"""
_MARGIN_M = 0.01
"""by which boxes are larger than what is in them, for roundings"""
_SQUARE_M = 2.0
"""side of the squares of ground in which things that move are looked for"""


class Scene:
    """Triangles that rays are cast against."""

    def __init__(self, mesh: Mesh) -> None:
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        if len(mesh):
            self._scene.add_triangles(
                o3d.core.Tensor.from_numpy(np.ascontiguousarray(mesh.vertices, dtype=np.float32)),
                o3d.core.Tensor.from_numpy(np.ascontiguousarray(mesh.triangles, dtype=np.uint32)),
            )

    def closest(self, rays: Floats) -> NDArray[np.uint32]:
        """Number (N,) of the first triangle that each ray (N, 6), origin and direction, hits, or NOTHING."""
        if len(rays) == 0:
            return np.zeros(0, dtype=np.uint32)
        return np.asarray(self._cast(rays)["primitive_ids"].numpy())

    def _cast(self, rays: Floats) -> dict[str, o3d.core.Tensor]:
        """What rays (N, 6), one at least, hit first: ``t_hit``, ``primitive_ids``, ``primitive_normals``."""
        hits: dict[str, o3d.core.Tensor] = self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays), nthreads=1)
        return hits

    def occluded(self, rays: Floats, far: float = np.inf) -> Mask:
        """Whether each ray (N, 6) hits anything before ``far``, in lengths of its direction: (N,)."""
        if len(rays) == 0:
            return np.zeros(0, dtype=np.bool_)
        hit = self._scene.test_occlusions(o3d.core.Tensor.from_numpy(rays), tfar=far, nthreads=1)
        return np.asarray(hit.numpy())


class ScenePair:
    """Two scenes that rays are cast against as one, so that the first can be kept while the second changes.

    Triangles of the second scene, whose mesh is ``second``, are numbered after the ``first_count`` of the first.
    """

    def __init__(self, first: Scene, first_count: int, second: Mesh) -> None:
        self._first, self._count, self.second = first, first_count, Scene(second)
        corners = second.vertices[second.triangles]
        self._low = corners.min(axis=(0, 1), initial=np.inf) - np.float32(_MARGIN_M)
        self._high = corners.max(axis=(0, 1), initial=-np.inf) + np.float32(_MARGIN_M)
        self._taken = _taken(corners, self._low, self._high)

    def closest(self, rays: Floats) -> NDArray[np.uint32]:
        """As :meth:`Scene.closest`."""
        if len(rays) == 0:
            return np.zeros(0, dtype=np.uint32)
        found = self._first._cast(rays)
        triangle: NDArray[np.uint32] = found["primitive_ids"].numpy()
        first_at = found["t_hit"].numpy()
        asked = _meets(rays, first_at, self._low, self._high, self._taken)
        if len(asked):
            other = self.second._cast(rays[asked])
            nearer = other["t_hit"].numpy() < first_at[asked]
            triangle = triangle.copy()
            triangle[asked[nearer]] = other["primitive_ids"].numpy()[nearer] + np.uint32(self._count)
        return triangle

    def occluded(self, rays: Floats, far: float = np.inf) -> Mask:
        """As :meth:`Scene.occluded`."""
        hit = self._first.occluded(rays, far)
        asked = _meets(rays, np.where(hit, np.float32(-1), np.float32(far)), self._low, self._high, self._taken)
        hit[asked] = self.second.occluded(rays[asked], far)
        return hit


@njit(cache=True, nogil=True, error_model="numpy")
def _taken(corners: Floats, low: Floats, high: Floats) -> Mask:
    """Which squares (y, x) of :data:`_SQUARE_M` have triangles (T, 3, 3) above them, from a corner of a box to another.

    Triangles count with a margin.
    """
    if len(corners) == 0:
        return np.zeros((1, 1), dtype=np.bool_)
    columns, rows = int((high[0] - low[0]) / _SQUARE_M) + 1, int((high[1] - low[1]) / _SQUARE_M) + 1
    out = np.zeros((rows, columns), dtype=np.bool_)
    for t in range(len(corners)):
        x0 = min(corners[t, 0, 0], corners[t, 1, 0], corners[t, 2, 0]) - low[0] - _MARGIN_M
        x1 = max(corners[t, 0, 0], corners[t, 1, 0], corners[t, 2, 0]) - low[0] + _MARGIN_M
        y0 = min(corners[t, 0, 1], corners[t, 1, 1], corners[t, 2, 1]) - low[1] - _MARGIN_M
        y1 = max(corners[t, 0, 1], corners[t, 1, 1], corners[t, 2, 1]) - low[1] + _MARGIN_M
        for j in range(max(int(y0 / _SQUARE_M), 0), min(int(y1 / _SQUARE_M), rows - 1) + 1):
            for i in range(max(int(x0 / _SQUARE_M), 0), min(int(x1 / _SQUARE_M), columns - 1) + 1):
                out[j, i] = True
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _meets(rays: Floats, until: Floats, low: Floats, high: Floats, taken: Mask) -> Indices:
    """Rays (M,) of (N, 6) that pass through the box between two corners above a taken square, before ``until`` (N,).

    ``until`` is in lengths of the directions; a negative number stands for a ray that is not asked for. The squares
    below a ray are visited in its order (Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", 1987).
    """
    rows, columns = taken.shape
    out = np.empty(len(rays), dtype=np.int64)
    m = 0
    for r in range(len(rays)):
        enter, leave = 0.0, float(until[r])
        for k in range(3):
            d = rays[r, 3 + k]
            if d == 0.0:
                if rays[r, k] < low[k] or rays[r, k] > high[k]:
                    leave = -1.0
                continue
            a, b = (low[k] - rays[r, k]) / d, (high[k] - rays[r, k]) / d
            enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
        if enter > leave:
            continue
        dx, dy = float(rays[r, 3]), float(rays[r, 4])
        x, y = rays[r, 0] + enter * dx - low[0], rays[r, 1] + enter * dy - low[1]
        i = min(max(int(x / _SQUARE_M), 0), columns - 1)
        j = min(max(int(y / _SQUARE_M), 0), rows - 1)
        step_x, step_y = 1 if dx > 0 else -1, 1 if dy > 0 else -1
        along_x = _SQUARE_M / abs(dx) if dx != 0.0 else np.inf
        along_y = _SQUARE_M / abs(dy) if dy != 0.0 else np.inf
        next_x = enter + ((i + (dx > 0)) * _SQUARE_M - x) / dx if dx != 0.0 else np.inf
        next_y = enter + ((j + (dy > 0)) * _SQUARE_M - y) / dy if dy != 0.0 else np.inf
        while True:
            if taken[j, i]:
                out[m] = r
                m += 1
                break
            if min(next_x, next_y) > leave:
                break
            if next_x < next_y:
                i, next_x = i + step_x, next_x + along_x
            else:
                j, next_y = j + step_y, next_y + along_y
            if i < 0 or i >= columns or j < 0 or j >= rows:
                break
    return out[:m].copy()
