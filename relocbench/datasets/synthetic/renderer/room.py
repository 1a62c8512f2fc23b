"""The arrays of a mesh that stands still, with room behind them for what moves.

A town has a million triangles and what moves some ten thousands, so that copying the town for each moment would take
as long as much of an image.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.synthetic.renderer.edges import surface_names
from relocbench.datasets.synthetic.renderer.surfaces import Geometry, make_geometry
from relocbench.datasets.synthetic.town.mesh import Mesh

_SPARE = 1.5
"""rows that are made at once, relative to those needed, so that few moments need more"""


class Room:
    """The arrays of a mesh, behind which another mesh can be put again and again."""

    def __init__(self, mesh: Mesh) -> None:
        self.geometry: Geometry = make_geometry(mesh)
        self.names: NDArray[np.uint32] = surface_names(self.geometry)
        """of the surfaces of all triangles; see :func:`surface_names`"""
        self._triangles, self._vertices = len(mesh), len(mesh.vertices)

    @property
    def triangles(self) -> int:
        """Number of triangles of the first mesh."""
        return self._triangles

    def put(self, mesh: Mesh) -> None:
        """Put a mesh behind the first one, in place of the one that was put there before."""
        if not self._holds(mesh):
            self._grow(mesh)
        moving = make_geometry(mesh)
        moving = moving._replace(triangles=moving.triangles + np.uint32(self._vertices))
        for name in Geometry._fields:
            first, part = self._first(name), getattr(moving, name)
            getattr(self.geometry, name)[first : first + len(part)] = part
        self.names[self._triangles : self._triangles + len(mesh)] = surface_names(moving)

    def _first(self, name: str) -> int:
        """Number of rows that the first mesh has in an array."""
        return self._vertices if name == "vertices" else self._triangles

    def _holds(self, mesh: Mesh) -> bool:
        return len(self.names) >= self._triangles + len(mesh) and len(self.geometry.vertices) >= self._vertices + len(
            mesh.vertices
        )

    def _grow(self, mesh: Mesh) -> None:
        def with_room(values: NDArray[Any], name: str) -> NDArray[Any]:
            first, more = self._first(name), len(mesh.vertices) if name == "vertices" else len(mesh)
            out = np.zeros((first + int(_SPARE * more), *values.shape[1:]), dtype=values.dtype)
            out[:first] = values[:first]
            return out

        for name in Geometry._fields:  # one by one, so that there are never two of all
            self.geometry = self.geometry._replace(**{name: with_room(getattr(self.geometry, name), name)})
        self.names = with_room(self.names, "names")
