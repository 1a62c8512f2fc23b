"""What a map's keyframe knows of its depth, made from a rendered frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Floats
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.latest import latest
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.datasets.synthetic.map_depth.kinds import MapDepth
from relocbench.datasets.synthetic.map_depth.matched import matched_depth, matched_up_to
from relocbench.datasets.synthetic.map_depth.scanned import (
    T_RIG_LIDAR,
    Returns,
    Surroundings,
    scan_returns,
    seen_points,
)
from relocbench.datasets.synthetic.map_depth.triangulated import triangulated_points, triangulated_up_to
from relocbench.datasets.synthetic.renderer.render import Frame
from relocbench.datasets.synthetic.town.moving import Moving, moves
from relocbench.errors import ConfigError
from relocbench.geometry import Camera
from relocbench.tracking import KeyframePoints

_DEPTH_STREAM = 3
"""number of the random stream of an image's depth; the renderer has those before"""


_LEAST_REACH_M = 5.0
"""depth up to which a map knows something at least; the road begins 2 to 3 m before the camera"""


def check_reach(known: MapDepth, camera: Camera) -> None:
    """Raise ConfigError if errors are so large that hardly any depth is left."""
    reaches = {"points": triangulated_up_to, "stereo": matched_up_to}
    reach = reaches[known.kind](camera, known.error_px) if known.kind in reaches else np.inf
    if reach < _LEAST_REACH_M:
        size = f"{camera.width}x{camera.height}"
        raise ConfigError(
            f"--depth-error {known.error_px:g}: in images of {size} depth would end at {reach:.1f} m, expected "
            f"{_LEAST_REACH_M:g} m at least; lower the error or raise --size"
        )


@dataclass(frozen=True, eq=False)
class Scan:
    """What the lidar scans while the cameras of the rig take their images."""

    place: DistrictSpec
    factors: Factors
    moving: tuple[Moving, ...]
    T_world_rig: Array
    seed: int


@dataclass(frozen=True, eq=False)
class Keyframe:
    """One rendered image of a map."""

    frame: Frame
    camera: Camera
    T_world_cam: Array
    seed: int
    """of the image"""
    scan: Scan | None = None
    """at its time, for maps of a lidar"""

    @property
    def _rng(self) -> np.random.Generator:
        return np.random.default_rng([self.seed, _DEPTH_STREAM])

    def depth(self, known: MapDepth) -> Floats:
        """Depth (H, W) in metres, 0 where unknown, as a map with depth images has it."""
        if known.kind == "stereo":
            return matched_depth(self.frame.rgb, self.frame.depth, self.camera, known.error_px, self._rng)
        return self.frame.depth

    def points(self, known: MapDepth) -> KeyframePoints:
        """The points of a map that has points in place of depth images."""
        if self.scan is None:
            static = ~moves(self.frame.semantic)
            near = self.frame.rgb, self.frame.depth, static, self.camera
            return triangulated_points(*near, known.points, known.error_px, self._rng)
        scan = self.scan
        around = Surroundings(
            scenes.static_scene(scan.place, scan.factors),
            scenes.moving_scene(scan.moving),
            scan.factors,
        )

        def scanned() -> Returns:
            rng = np.random.default_rng(scan.seed)
            return scan_returns(around, scan.T_world_rig @ T_RIG_LIDAR, known.rings, rng)

        # All cameras of a rig see points of the same scan.
        returns = latest("scan", (scan.place, scan.factors, known, scan.seed), scanned)
        return seen_points(returns, around, self.camera, self.T_world_cam)
