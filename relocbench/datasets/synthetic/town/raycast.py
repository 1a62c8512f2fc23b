"""Ray casting by Embree (Open3D's RaycastingScene), single-threaded in each worker."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from relocbench.arrays import Floats, Mask
from relocbench.datasets.synthetic.town.mesh import Mesh

NOTHING = 0xFFFFFFFF
"""triangle number of a ray that hits nothing"""


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

    Triangles of the second scene are numbered after the ``first_count`` triangles of the first.
    """

    def __init__(self, first: Scene, first_count: int, second: Scene) -> None:
        self._first, self._count, self._second = first, first_count, second

    def closest(self, rays: Floats) -> NDArray[np.uint32]:
        """As :meth:`Scene.closest`."""
        if len(rays) == 0:
            return np.zeros(0, dtype=np.uint32)
        a, b = self._first._cast(rays), self._second._cast(rays)
        nearer = b["t_hit"].numpy() < a["t_hit"].numpy()
        triangle: NDArray[np.uint32] = a["primitive_ids"].numpy().copy()
        triangle[nearer] = b["primitive_ids"].numpy()[nearer] + np.uint32(self._count)
        return triangle

    def occluded(self, rays: Floats, far: float = np.inf) -> Mask:
        """As :meth:`Scene.occluded`."""
        hit = self._first.occluded(rays, far)
        open_rays = np.flatnonzero(~hit)
        hit[open_rays] = self._second.occluded(rays[open_rays], far)
        return hit
