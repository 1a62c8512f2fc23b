"""Lidar: a push-broom scanner and a spinning one, in the weather and among moving cars.

Each beam is fired from where the sensor is at its own time and measures what stands there at that time, so that scans
of a moving sensor are distorted as real ones are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.lidar.echo import clutter, extinction, signal, surface_reflectance
from relocbench.datasets.synthetic.town.mesh import Mesh
from relocbench.errors import ConfigError
from relocbench.geometry import apply, invert

Array = NDArray[np.float64]
Times = NDArray[np.int64]

_BEAMS = 541
_LMS_PERIOD_NS = 20_000_000
_SPIN_PERIOD_NS = 100_000_000
_SPECKLE = 0.2
"""standard deviation of the logarithm of the power that comes back"""
_CLUTTER_RANGE_M = 3.0
"""mean range of the echoes of drops and flakes in the air"""
_STRAY_M = 1.0
"""within a scan, something that moves strays less from the straight line between where it is first and last"""
_BLOCKED_BY_DROPS = 0.15
"""share of beams lost where drops cover the sensor's window as far as they may"""


@dataclass(frozen=True, eq=False)
class Hits:
    """What N rays met first."""

    range: Array
    """(N,) in lengths of the direction; inf where nothing was met"""
    material: NDArray[np.uint8]
    """(N,) :class:`Material`; 0 where nothing was met"""
    instance: NDArray[np.uint32]
    """(N,) object; 0 where nothing was met"""
    normal: Array
    """(N, 3) unit normal of the surface; 0 where nothing was met"""


class LidarScene:
    """Rays against a mesh; one thread, so that N workers use N cores."""

    def __init__(self, mesh: Mesh) -> None:
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._empty = len(mesh) == 0
        if not self._empty:
            self._scene.add_triangles(
                o3d.core.Tensor.from_numpy(np.ascontiguousarray(mesh.vertices, dtype=np.float32)),
                o3d.core.Tensor.from_numpy(np.ascontiguousarray(mesh.triangles, dtype=np.uint32)),
            )
        self._material = mesh.material
        self._instance = mesh.instance

    def cast(self, origins: Array, directions: Array) -> tuple[Array, NDArray[np.uint8], NDArray[np.uint32]]:
        """What rays meet first.

        Args:
            origins: (N, 3) metres, world.
            directions: (N, 3); ranges are in their lengths, so metres for unit directions.

        Returns:
            range (N,), inf where nothing is met, material (N,) and instance (N,), 0 there.
        """
        hits = self.hits(origins, directions)
        return hits.range, hits.material, hits.instance

    def hits(self, origins: Array, directions: Array) -> Hits:
        """As :meth:`cast`, with the normals of the surfaces."""
        count = len(origins)
        if self._empty or count == 0:
            return Hits(
                np.full(count, np.inf),
                np.zeros(count, np.uint8),
                np.zeros(count, np.uint32),
                np.zeros((count, 3)),
            )
        rays = np.concatenate([origins, directions], axis=1).astype(np.float32)
        found = self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays), nthreads=1)
        distance = found["t_hit"].numpy().astype(np.float64)
        met = np.isfinite(distance)
        triangle = np.where(met, found["primitive_ids"].numpy(), 0)
        return Hits(
            distance,
            np.where(met, self._material[triangle], 0).astype(np.uint8),
            np.where(met, self._instance[triangle], 0).astype(np.uint32),
            np.where(met[:, None], found["primitive_normals"].numpy(), 0.0).astype(np.float64),
        )


class Motion(Protocol):
    """Where something is at each time."""

    def __call__(self, times_ns: Times, /) -> Array:
        """(N, 4, 4) ``T_world_body``; NaN where it is not there."""
        ...


@dataclass(frozen=True, eq=False)
class MovingObject:
    """Something that moves while a scan is taken."""

    scene: LidarScene
    """its mesh in its own frame"""
    motion: Motion
    radius_m: float
    """of a ball about its origin that it stays within"""


@dataclass(frozen=True, eq=False)
class Lidar:
    """A scanner: N beams, each fired at its own time within a scan."""

    directions: Array
    """(N, 3) unit, sensor frame"""
    offsets_ns: Times
    """(N,) when each is fired, relative to the scan's timestamp"""
    period_ns: int
    sigma_m: float
    """of a range with a strong echo"""
    nearest_m: float
    farthest_m: float
    dark_range_m: float
    """where the echo of a surface with a reflectance of 0.1, hit head-on in clear air, is just seen"""


@dataclass(frozen=True, eq=False)
class Scan:
    """What a lidar measured."""

    time_ns: int
    points: Array
    """(N, 3) metres, each in the sensor's frame at the time of its own firing; 0 where nothing came back"""
    reflectance: Array
    """(N,) in [0, 1]"""
    returned: NDArray[np.bool_]
    """(N,)"""
    instance: NDArray[np.uint32]
    """(N,) object that sent the echo back; 0 for echoes out of the air"""


def push_broom() -> Lidar:
    """A SICK LMS-151: 541 beams over 270 degrees, 50 Hz, axes x to the middle beam, z the axis of rotation.

    Range 50 m, 18 m for a reflectance of 0.1, noise 12 mm (data sheet). The timestamp is that of the middle beam.
    """
    angle = np.radians(np.linspace(-135.0, 135.0, _BEAMS))
    directions = np.stack([np.cos(angle), np.sin(angle), np.zeros(_BEAMS)], axis=1)
    offsets = np.rint(angle / (2 * np.pi) * _LMS_PERIOD_NS).astype(np.int64)
    return Lidar(directions, offsets, _LMS_PERIOD_NS, 0.012, 0.5, 50.0, 18.0)


def spinning(rings: int = 64, azimuths: int = 2000, highest_deg: float = 2.0, lowest_deg: float = -24.8) -> Lidar:
    """A spinning lidar, 10 Hz, ring after ring; by default a Velodyne HDL-64E, which reaches 50 m on asphalt and 120 m.

    Axes x forward, y left, z up. It turns clockwise seen from above, begins and ends looking backward, and its
    timestamp is that of looking forward.

    Raises:
        ConfigError: not 16 to 64 rings.
    """
    if not 16 <= rings <= 64:
        raise ConfigError(f"a spinning lidar has 16 to 64 rings, got {rings}")
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
) -> Scan:
    """One scan.

    Args:
        motion: ``T_world_lidar`` (N, 4, 4) at times (N,).
        factors: rain, snow, fog and wetness weaken echoes and make false ones.
        rng: of the noise; the same number of draws whatever is hit.
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
    measured = hits.range + lidar.sigma_m * np.sqrt(1 + 1 / np.maximum(power, 1e-3)) * noise
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
    return Scan(
        time_ns,
        distance[:, None] * lidar.directions,
        np.where(returned, np.clip(brightness, 0.0, 1.0), 0.0),
        returned,
        np.where(returned & ~false_echo, hits.instance, 0).astype(np.uint32),
    )


def compensate(lidar: Lidar, measured: Scan, motion: Motion) -> Array:
    """Points (N, 3) of a scan in the sensor's frame at the scan's timestamp, its own motion taken out; 0 stays 0."""
    T_world_lidar = motion(measured.time_ns + lidar.offsets_ns)
    T_now_world = invert(motion(np.array([measured.time_ns]))[0])
    moved = apply(T_now_world @ T_world_lidar, measured.points[:, None, :])[:, 0]
    return np.where(measured.returned[:, None], moved, 0.0)


def trace(
    scene: LidarScene, moving: Sequence[MovingObject], origins: Array, directions: Array, times_ns: Times
) -> Hits:
    """What rays (N, 3) fired at times (N,) meet first, among what stands and what moves.

    A ray against something that moves is cast in that object's frame at the ray's time: no mesh is moved.
    """
    nearest = scene.hits(origins, directions)
    for thing in moving:
        there = np.flatnonzero(_may_meet(thing, origins, directions, times_ns))
        T_world_object = thing.motion(times_ns[there])
        present = np.isfinite(T_world_object[:, 0, 0])
        there, T_object_world = there[present], invert(T_world_object[present])
        if not len(there):
            continue
        rotation = T_object_world[:, :3, :3]
        start = np.einsum("nij,nj->ni", rotation, origins[there]) + T_object_world[:, :3, 3]
        found = thing.scene.hits(start, np.einsum("nij,nj->ni", rotation, directions[there]))
        nearer = found.range < nearest.range[there]
        rows = there[nearer]
        nearest.range[rows] = found.range[nearer]
        nearest.material[rows] = found.material[nearer]
        nearest.instance[rows] = found.instance[nearer]
        nearest.normal[rows] = np.einsum("nji,nj->ni", rotation[nearer], found.normal[nearer])
    return nearest


def _may_meet(thing: MovingObject, origins: Array, directions: Array, times_ns: Times) -> NDArray[np.bool_]:
    """(N,) rays that pass by an object near enough; all where it comes or goes while they are fired."""
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
