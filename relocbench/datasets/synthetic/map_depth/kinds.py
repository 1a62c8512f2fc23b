"""The kinds of depth that the keyframes of a rendered map can have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

DepthKind = Literal["exact", "points", "lidar", "stereo"]


@dataclass(frozen=True)
class MapDepth:
    """What a map knows of the depth of its keyframes."""

    kind: DepthKind = "exact"
    points: int = 500
    """greatest number of points of a keyframe (``points``)"""
    error_px: float = 0.5
    """standard deviation in pixels of what was matched (``points``, ``stereo``)"""
    rings: int = 64
    """of the lidar (``lidar``)"""

    @property
    def stored_as(self) -> Literal["depth", "points"]:
        """Whether keyframes have a depth image or points."""
        return "depth" if self.kind in ("exact", "stereo") else "points"


EXACT = MapDepth()
