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
        corners = second.vertices[second.triangles].reshape(-1, 3)
        self._low = corners.min(axis=0, initial=np.inf).astype(np.float32) - np.float32(_MARGIN_M)
        self._high = corners.max(axis=0, initial=-np.inf).astype(np.float32) + np.float32(_MARGIN_M)

    def closest(self, rays: Floats) -> NDArray[np.uint32]:
        """As :meth:`Scene.closest`."""
        if len(rays) == 0:
            return np.zeros(0, dtype=np.uint32)
        found = self._first._cast(rays)
        triangle: NDArray[np.uint32] = found["primitive_ids"].numpy()
        asked = _meets(rays, self._low, self._high)
        if len(asked):
            other = self.second._cast(rays[asked])
            nearer = other["t_hit"].numpy() < found["t_hit"].numpy()[asked]
            triangle = triangle.copy()
            triangle[asked[nearer]] = other["primitive_ids"].numpy()[nearer] + np.uint32(self._count)
        return triangle

    def occluded(self, rays: Floats, far: float = np.inf) -> Mask:
        """As :meth:`Scene.occluded`."""
        hit = self._first.occluded(rays, far)
        asked = _meets(rays, self._low, self._high)
        asked = asked[~hit[asked]]
        hit[asked] = self.second.occluded(rays[asked], far)
        return hit


@njit(cache=True, nogil=True, error_model="numpy")
def _meets(rays: Floats, low: Floats, high: Floats) -> Indices:
    """Rays (M,) of (N, 6) that enter the box between two corners, most of which hit nothing in it."""
    out = np.empty(len(rays), dtype=np.int64)
    m = 0
    for i in range(len(rays)):
        enter, leave = 0.0, np.inf
        for k in range(3):
            d = rays[i, 3 + k]
            if d == 0.0:
                if rays[i, k] < low[k] or rays[i, k] > high[k]:
                    leave = -1.0
                continue
            a, b = (low[k] - rays[i, k]) / d, (high[k] - rays[i, k]) / d
            enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
        if enter <= leave:
            out[m] = i
            m += 1
    return out[:m].copy()
