"""A submap with what registration and verification derive from it, each computed once, when it is first needed."""

from __future__ import annotations

from functools import cached_property

from relocbench.datasets.groundtruth.submaps.free_space import FreeSpace, FreeSpaceOptions
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap, PlaneOptions
from relocbench.datasets.groundtruth.submaps.submaps import Submap


class PreparedSubmap:
    """A submap as one side of a registration."""

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
        """Its planes, for ICP."""
        return PlaneMap(self.submap, self._plane_options)

    @cached_property
    def space(self) -> FreeSpace:
        """Its surfaces and beams, for verification."""
        return FreeSpace(self.submap, self._free_space_options)
