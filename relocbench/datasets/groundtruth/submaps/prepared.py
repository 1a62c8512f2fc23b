"""A submap with what registration and verification derive from it, each computed once, when it is first needed."""

from __future__ import annotations

from functools import cached_property

from relocbench.datasets.groundtruth.submaps.free_space import FreeSpace
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap
from relocbench.datasets.groundtruth.submaps.submaps import Submap


class PreparedSubmap:
    """A submap as one side of a registration."""

    def __init__(self, submap: Submap) -> None:
        self.submap = submap

    @cached_property
    def planes(self) -> PlaneMap:
        """Its planes, for ICP."""
        return PlaneMap(self.submap)

    @cached_property
    def space(self) -> FreeSpace:
        """Its surfaces and beams, for verification."""
        return FreeSpace(self.submap)
