"""Simulated lidar: a push-broom scanner and a spinning one, in any weather and among moving cars.

Each beam is fired from the sensor's pose at the beam's own time and hits objects where they are at that time, so that
scans of a moving sensor are distorted like real ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Bytes, Mask, Times
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.lidar.echo import clutter, extinction, signal, surface_reflectance
from relocbench.datasets.synthetic.town.mesh import Mesh
from relocbench.datasets.synthetic.town.raycast import Scene
from relocbench.errors import ConfigError
from relocbench.geometry import apply, invert

_BEAMS = 541
_LMS_PERIOD_NS = 20_000_000
_SPIN_PERIOD_NS = 100_000_000
_SPECKLE = 0.2
"""standard deviation of the logarithm of the returned power"""
_CLUTTER_RANGE_M = 3.0
"""mean range of echoes from raindrops and snowflakes"""
_STRAY_M = 1.0
"""greatest deviation of a moving object from the straight line between its positions at a scan's start and end"""
_BLOCKED_BY_DROPS = 0.15
"""share of beams that are blocked if ``lens_drops`` is 1"""


@dataclass(frozen=True, eq=False)
class RayHits:
    """The first surfaces that N rays hit."""

    range: Array
    """(N,) in lengths of the direction; inf without a hit"""
    material: Bytes
    """(N,) :class:`Material`; 0 without a hit"""
    instance: NDArray[np.uint32]
    """(N,) object; 0 without a hit"""
    variant: NDArray[np.uint32]
    """(N,) seed of the surface's look; 0 without a hit"""
    normal: Array
    """(N, 3) unit normal of the surface; 0 without a hit"""


class LidarScene(Scene):
    """A scene that tells the surfaces that rays hit."""

    def __init__(self, mesh: Mesh) -> None:
        super().__init__(mesh)
        self._material = mesh.material
        self._instance = mesh.instance
        self._variant = mesh.variant

    def hits(self, origins: Array, directions: Array) -> RayHits:
        """The first surface that each ray hits, from origins (N, 3) in metres along directions (N, 3)."""
        count = len(origins)
        if len(self._material) == 0 or count == 0:
            none = np.zeros(count, np.uint8), *np.zeros((2, count), np.uint32), np.zeros((count, 3))
            return RayHits(np.full(count, np.inf), *none)
        rays = np.concatenate([origins, directions], axis=1).astype(np.float32)
        found = self._cast(rays)
        distance = found["t_hit"].numpy().astype(np.float64)
        met = np.isfinite(distance)
        triangle = np.where(met, found["primitive_ids"].numpy(), 0)
        return RayHits(
            distance,
            np.where(met, self._material[triangle], 0).astype(np.uint8),
            np.where(met, self._instance[triangle], 0).astype(np.uint32),
            np.where(met, self._variant[triangle], 0).astype(np.uint32),
            np.where(met[:, None], found["primitive_normals"].numpy(), 0.0).astype(np.float64),
        )


class Motion(Protocol):
    """The pose of something as a function of time."""

    def __call__(self, times_ns: Times, /) -> Array:
        """``T_world_body`` (N, 4, 4) at times (N,); NaN where it is absent."""
        ...


@dataclass(frozen=True, eq=False)
class MovingObject:
    """An object that moves during a scan."""

    scene: LidarScene
    """its mesh in its own frame"""
    motion: Motion
    radius_m: float
    """radius of a sphere around its origin that contains it"""


@dataclass(frozen=True, eq=False)
class Lidar:
    """A scanner with N beams per scan, each fired at its own time."""

    directions: Array
    """(N, 3) unit vectors in the sensor's frame"""
    offsets_ns: Times
    """(N,) firing times relative to the scan's timestamp"""
    period_ns: int
    sigma_m: float
    """standard deviation of a range with a strong echo"""
    nearest_m: float
    farthest_m: float
    dark_range_m: float
    """greatest range for a surface with a reflectance of 0.1 at normal incidence in clear air"""


@dataclass(frozen=True, eq=False)
class SimulatedScan:
    """One simulated scan of N beams."""

    time_ns: int
    points: Array
    """(N, 3) metres, each in the sensor's frame at its own firing time; 0 without a return"""
    reflectance: Array
    """(N,) in [0, 1]"""
    returned: Mask
    """(N,)"""
    instance: NDArray[np.uint32]
    """(N,) object that reflected the beam; 0 for echoes from rain and snow"""
    sigma_m: Array
    """(N,) standard deviation of the range, which is larger for weak echoes"""


def push_broom() -> Lidar:
    """A SICK LMS-151: 541 beams over 270 degrees at 50 Hz, x along the middle beam, z along the axis of rotation.

    Range 50 m, 18 m for a reflectance of 0.1, noise 12 mm (data sheet). The timestamp is that of the middle beam.
    """
    angle = np.radians(np.linspace(-135.0, 135.0, _BEAMS))
    directions = np.stack([np.cos(angle), np.sin(angle), np.zeros(_BEAMS)], axis=1)
    offsets = np.rint(angle / (2 * np.pi) * _LMS_PERIOD_NS).astype(np.int64)
    return Lidar(directions, offsets, _LMS_PERIOD_NS, 0.012, 0.5, 50.0, 18.0)


def spinning(rings: int = 64, azimuths: int = 2000, highest_deg: float = 2.0, lowest_deg: float = -24.8) -> Lidar:
    """A spinning lidar at 10 Hz, ordered by ring; by default a Velodyne HDL-64E with 120 m range, 50 m on asphalt.

    Axes: x forward, y left, z up. It turns clockwise seen from above, each scan begins and ends facing backward, and
    its timestamp is that of facing forward.

    Raises:
        ConfigError: the number of rings is not 16 to 64.
    """
    if not 16 <= rings <= 64:
        raise ConfigError(f"a spinning lidar needs 16 to 64 rings, got {rings}")
    elevation = np.radians(np.linspace(highest_deg, lowest_deg, rings))[:, None]
    turned = (np.arange(azimuths) + 0.5) / azimuths - 0.5
    azimuth = -2 * np.pi * turned[None, :]
    directions = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.broadcast_to(np.sin(elevation), (rings, azimuths)),
        ],
        axis=-1,
    )
    offsets = np.rint(turned * _SPIN_PERIOD_NS).astype(np.int64)
    return Lidar(directions.reshape(-1, 3), np.tile(offsets, rings), _SPIN_PERIOD_NS, 0.02, 0.9, 120.0, 50.0)


def scan(
    lidar: Lidar,
    scene: LidarScene,
    motion: Motion,
    time_ns: int,
    factors: Factors,
    rng: np.random.Generator,
    moving: Sequence[MovingObject] = (),
) -> SimulatedScan:
    """Simulate one scan.

    Args:
        motion: ``T_world_lidar`` (N, 4, 4) at times (N,).
        factors: the weather; rain, snow, fog and wetness weaken echoes and cause false ones.
        rng: generator of the noise; the number of draws does not depend on what is hit.
    """
    times = time_ns + lidar.offsets_ns
    T_world_lidar = motion(times)
    directions = np.einsum("nij,nj->ni", T_world_lidar[:, :3, :3], lidar.directions)
    hits = trace(scene, moving, T_world_lidar[:, :3, 3], directions, times)
    cosine = np.abs(np.sum(hits.normal * directions, axis=1))
    reflectance = surface_reflectance(hits.material, hits.normal[:, 2], cosine, factors)
    power = signal(hits.range, reflectance * cosine, extinction(factors), lidar.dark_range_m)
    speckle, noise, glitter = rng.normal(size=(3, len(times)))
    blocked, fouled = rng.random(size=(2, len(times)))
    echo_m = lidar.nearest_m + rng.exponential(_CLUTTER_RANGE_M, size=len(times))
    sigma_m = lidar.sigma_m * np.sqrt(1 + 1 / np.maximum(power, 1e-3))
    measured = hits.range + sigma_m * noise
    seen = (
        np.isfinite(hits.range)
        & (power * np.exp(_SPECKLE * speckle) > 1)
        & (measured >= lidar.nearest_m)
        & (measured <= lidar.farthest_m)
    )
    false_echo = (fouled < clutter(factors)) & (echo_m < hits.range)
    returned = (seen | false_echo) & (blocked >= _BLOCKED_BY_DROPS * factors.lens_drops)
    distance = np.where(returned, np.where(false_echo, echo_m, measured), 0.0)
    brightness = np.where(false_echo, 0.02, reflectance * cosine) * (1 + 0.05 * glitter)
    return SimulatedScan(
        time_ns,
        distance[:, None] * lidar.directions,
        np.where(returned, np.clip(brightness, 0.0, 1.0), 0.0),
        returned,
        np.where(returned & ~false_echo, hits.instance, 0).astype(np.uint32),
        sigma_m,
    )


def compensate(lidar: Lidar, measured: SimulatedScan, motion: Motion) -> Array:
    """Motion-compensated points (N, 3) of a scan, in the sensor's frame at the scan's timestamp; 0 without a return."""
    T_world_lidar = motion(measured.time_ns + lidar.offsets_ns)
    T_now_world = invert(motion(np.array([measured.time_ns]))[0])
    moved = apply(T_now_world @ T_world_lidar, measured.points[:, None, :])[:, 0]
    return np.where(measured.returned[:, None], moved, 0.0)


def trace(
    scene: LidarScene, moving: Sequence[MovingObject], origins: Array, directions: Array, times_ns: Times
) -> RayHits:
    """The first surfaces that rays (N, 3), fired at times (N,), hit among static and moving objects.

    For a moving object, rays are transformed to its frame at their times, so that no mesh has to be moved.
    """
    nearest = scene.hits(origins, directions)
    for thing in moving:
        tried = np.flatnonzero(_may_meet(thing, origins, directions, times_ns))
        T_world_object = thing.motion(times_ns[tried])
        present = np.isfinite(T_world_object[:, 0, 0])
        tried, T_object_world = tried[present], invert(T_world_object[present])
        if not len(tried):
            continue
        rotation = T_object_world[:, :3, :3]
        start = np.einsum("nij,nj->ni", rotation, origins[tried]) + T_object_world[:, :3, 3]
        found = thing.scene.hits(start, np.einsum("nij,nj->ni", rotation, directions[tried]))
        nearer = found.range < nearest.range[tried]
        rows = tried[nearer]
        nearest.range[rows] = found.range[nearer]
        nearest.material[rows] = found.material[nearer]
        nearest.instance[rows] = found.instance[nearer]
        nearest.normal[rows] = np.einsum("nji,nj->ni", rotation[nearer], found.normal[nearer])
    return nearest


def _may_meet(thing: MovingObject, origins: Array, directions: Array, times_ns: Times) -> Mask:
    """Mask (N,) of the rays that pass near an object; all of them if it appears or disappears during the scan."""
    ends = thing.motion(np.array([times_ns.min(), times_ns.max()]))[:, :3, 3]
    present = np.isfinite(ends[:, 0])
    if not present.all():
        return np.full(len(times_ns), present.any())
    middle = ends.mean(axis=0)
    reach = thing.radius_m + np.linalg.norm(ends[1] - ends[0]) / 2 + _STRAY_M
    to_object = middle - origins
    along = np.sum(to_object * directions, axis=1)
    aside = np.sum(to_object**2, axis=1) - along**2
    return np.asarray((along > -reach) & (aside < reach**2))
