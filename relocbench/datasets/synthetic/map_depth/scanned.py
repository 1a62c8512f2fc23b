"""Points of a spinning lidar on the car, as far as a camera sees them.

The scan is motion-compensated without error: all of its beams are fired from where the car is when the image is taken.
Since lidar and camera are at different places, the lidar sees past some edges; and rain and snow reflect beams. A
return is kept if the camera sees a surface there, in the pixel in which the return appears.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.lidar.lidar import LidarScene, MovingObject, scan, spinning, trace
from relocbench.geometry import Camera, apply, invert, make_transform
from relocbench.tracking import KeyframePoints

T_RIG_LIDAR = make_transform(np.eye(3), [0.63, 0.0, 1.73])
"""1.73 m above the road and 0.27 m behind the front cameras, as on KITTI's car"""
_SIGMAS = 4.0
"""standard deviations by which a return may differ from the surface that the camera sees"""
_STEEPEST = 3.0
"""times that an error along a beam may become one of depth, where the camera sees a surface at a smaller angle"""
_PIXEL_DIGITS, _INVERSE_DEPTH_DIGITS = 4, 9
"""decimals of what is stored; they are worth less than a millimetre, and files of many points become half as long"""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What stands and moves around a car at one moment."""

    static: LidarScene
    moving: LidarScene | None
    factors: Factors

    @property
    def movers(self) -> Sequence[MovingObject]:
        """What moves, for :func:`trace`, where it is at this moment."""
        return [] if self.moving is None else [MovingObject(self.moving, Still(np.eye(4)), np.inf)]


@dataclass(frozen=True, eq=False)
class Still:
    """The motion of something that does not move."""

    T_world_body: Array

    def __call__(self, times_ns: Times) -> Array:
        return np.broadcast_to(self.T_world_body, (len(times_ns), 4, 4))


@dataclass(frozen=True, eq=False)
class Returns:
    """The returns of one scan."""

    points: Array
    """(N, 3) in the world"""
    origin: Array
    """(3,) where the lidar was"""
    sigma: Array
    """(N,) metres along the beam"""


def scan_returns(around: Surroundings, T_world_lidar: Array, rings: int, rng: np.random.Generator) -> Returns:
    """Scan the surroundings, with the noise of recordings, in their weather."""
    sensor = spinning(rings)
    measured = scan(sensor, around.static, Still(T_world_lidar), 0, around.factors, rng, around.movers)
    points = apply(T_world_lidar, measured.points[measured.returned])
    return Returns(points, T_world_lidar[:3, 3], measured.sigma_m[measured.returned])


def seen_points(returns: Returns, around: Surroundings, camera: Camera, T_world_cam: Array) -> KeyframePoints:
    """The returns that a camera sees, at most one a pixel, in raster order.

    An error along the beam, in the unit direction l, moves a point off its surface, of the normal n. The depth of the
    surface in the pixel where it then appears, along the ray r of depth 1, differs from the point's by ``n.l / n.r``
    times the error.
    """
    in_camera = apply(invert(T_world_cam), returns.points)
    uv, valid = camera.project(in_camera)
    uv = np.round(uv, _PIXEL_DIGITS)
    rows = np.flatnonzero(valid & (in_camera[:, 2] > 0) & camera.contains(uv))
    uv, depth = uv[rows], in_camera[rows, 2]
    rays = returns.points[rows] - T_world_cam[:3, 3]
    beams = returns.points[rows] - returns.origin
    rays, beams = rays / depth[:, None], beams / np.linalg.norm(beams, axis=1, keepdims=True)
    origins = np.broadcast_to(T_world_cam[:3, 3], rays.shape)
    hits = trace(around.static, around.movers, origins, rays, np.zeros(len(rays), dtype=np.int64))
    steep = np.abs(np.sum(hits.normal * rays, axis=1))
    gain = np.abs(np.sum(hits.normal * beams, axis=1)) / np.maximum(steep, 1e-9)
    sigma = returns.sigma[rows] * gain
    # hits.range counts lengths of the rays, whose depth is 1.
    kept = np.isfinite(hits.range) & (gain <= _STEEPEST) & (np.abs(depth - hits.range) <= _SIGMAS * sigma)
    uv, inverse, sigma = uv[kept], 1.0 / depth[kept], sigma[kept]
    u, v = np.rint(uv).astype(int).T
    _, first = np.unique(v * camera.width + u, return_index=True)
    return KeyframePoints(
        uv[first],
        np.round(inverse[first], _INVERSE_DEPTH_DIGITS),
        np.round(sigma[first] * inverse[first] ** 2, _INVERSE_DEPTH_DIGITS),
    )
