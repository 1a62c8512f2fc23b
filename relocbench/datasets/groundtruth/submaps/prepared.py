"""A submap with all that registration and its verification make of it, each once and when it is first needed."""

from __future__ import annotations

from functools import cached_property

from relocbench.datasets.groundtruth.submaps.free_space import FreeSpace, FreeSpaceOptions
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap, PlaneOptions
from relocbench.datasets.groundtruth.submaps.submaps import Submap


class PreparedSubmap:
    """One side of a registration."""

    def __init__(
        self,
        submap: Submap,
        plane_options: PlaneOptions | None = None,
        free_space_options: FreeSpaceOptions | None = None,
    ) -> None:
        self.submap = submap
        self._plane_options = plane_options
        self._free_space_options = free_space_options

    @cached_property
    def planes(self) -> PlaneMap:
        """For refinement."""
        return PlaneMap(self.submap, self._plane_options)

    @cached_property
    def space(self) -> FreeSpace:
        """For verification."""
        return FreeSpace(self.submap, self._free_space_options)
