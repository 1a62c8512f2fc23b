"""Simulated clouds with exact poses for ``register_clouds.py``: scans of streets, of rooms and of objects."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import open3d as o3d

from relocbench.arrays import Array, Times
from relocbench.datasets.groundtruth.clouds.cloud import Cloud
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.drives.routes import RouteName, route
from relocbench.datasets.synthetic.lidar.lidar import LidarScene, scan, spinning
from relocbench.datasets.synthetic.town.town import District, compose, make_district
from relocbench.errors import ConfigError
from relocbench.geometry import apply, invert, make_transform, so3_exp

EXTENT_M = 300.0
_LENGTH_M = 200.0
_SENSOR_M = 1.73
"""height of the lidar over the road"""
_SEEDS = 1_000_000
_LANE_M = 3.4
"""distance between the lanes of a street"""


@dataclass(frozen=True, eq=False)
class View:
    """A cloud and where it was measured."""

    cloud: Cloud
    T_world_cloud: Array
    """(4, 4)"""


@dataclass(frozen=True, eq=False)
class Pair:
    """Two clouds and the true pose."""

    a: Cloud
    b: Cloud
    T_a_b: Array
    """(4, 4); nan if they show different places"""


class Streets:
    """A district of the procedural town, with the scenes of its conditions."""

    def __init__(self, seed: int, split: str = "train") -> None:
        self.seed, self.split = seed, split
        self._scenes: dict[str, LidarScene] = {}

    @cached_property
    def district(self) -> District:
        # Not every seed has a street network of this size; the next one of another range has.
        for seed in range(self.seed, self.seed + 10 * _SEEDS, _SEEDS):
            try:
                return make_district(seed, self.split, EXTENT_M)
            except ConfigError:
                continue
        raise ConfigError(f"no district for seed {self.seed}")

    def pose(self, along_m: float, lateral_m: float, yaw_deg: float, name: RouteName = "common") -> Array:
        """``T_world_lidar`` (4, 4) on a route, turned to the left by ``yaw_deg``."""
        path = route(self.district.network, self.district.periodic.street, name, _LENGTH_M, self.seed)
        return path.pose(along_m, lateral_m, np.radians(yaw_deg)) @ make_transform(np.eye(3), [0, 0, _SENSOR_M])

    def view(self, T_world_lidar: Array, condition: str, seed: int, rings: int = 64) -> View:
        """A scan of a standing spinning lidar."""
        factors = condition_named(condition).factors
        if condition not in self._scenes:
            self._scenes[condition] = LidarScene(compose(self.district, factors))
        lidar = spinning(rings, 1000)

        def still(times: Times) -> Array:
            return np.broadcast_to(T_world_lidar, (len(times), 4, 4))

        measured = scan(lidar, self._scenes[condition], still, 0, factors, np.random.default_rng([seed, 11]))
        points = measured.points[measured.returned]
        points = points[np.linalg.norm(points, axis=1) < 80.0]
        return View(Cloud("scan", points, np.zeros_like(points), supposed=True), T_world_lidar)


@lru_cache(maxsize=4)
def streets(seed: int) -> Streets:
    return Streets(seed)


def paired(a: View, b: View) -> Pair:
    return Pair(a.cloud, b.cloud, np.asarray(invert(a.T_world_cloud) @ b.T_world_cloud))


def street_pair(seed: int, *, opposite: bool, rings: int = 64, name: RouteName = "common") -> Pair:
    """Two scans of a street 3 to 10 m apart, in different weather; ``opposite`` is in the other lane, driving back."""
    rng = np.random.default_rng([seed, 1])
    town = streets(seed)
    along = float(rng.uniform(60, 120))
    apart = float(rng.uniform(3, 10)) * float(rng.choice([-1, 1]))
    sway = rng.uniform(-0.5, 0.5, 2)
    a = town.view(town.pose(along, sway[0], float(rng.normal(0, 2)), name), "Sunny", 2 * seed, rings)
    lateral = sway[1] + (_LANE_M if opposite else 0.0)
    yaw = float(rng.normal(0, 2)) + (180.0 if opposite else 0.0)
    return paired(a, town.view(town.pose(along + apart, lateral, yaw, name), "Snow", 2 * seed + 1, rings))


def unrelated_streets(seed: int, rings: int = 64) -> Pair:
    """Scans of two streets of different districts."""
    a, b = (street_pair(s, opposite=False, rings=rings) for s in (seed, seed + 1))
    return Pair(a.a, b.b, np.full((4, 4), np.nan))


def short_submap(seed: int, along: float, lateral: float, yaw: float, condition: str, backwards: bool) -> View:
    """Five scans along 8 m of road, put together by their true poses in the frame of the third."""
    town, views = streets(seed), []
    for k in range(5):
        at = along + (2 - k if backwards else k - 2) * 2.0
        views.append(town.view(town.pose(at, lateral, yaw), condition, 100 * seed + 10 * int(backwards) + k))
    T_middle_world = invert(views[2].T_world_cloud)
    poses = [T_middle_world @ v.T_world_cloud for v in views]
    points = np.concatenate([apply(T, v.cloud.points) for T, v in zip(poses, views, strict=True)])
    sensors = np.repeat(np.array([T[:3, 3] for T in poses]), [len(v.cloud.points) for v in views], axis=0)
    return View(Cloud("submap", points, sensors), views[2].T_world_cloud)


def submap_pair(seed: int) -> Pair:
    """Two short submaps of opposite drives."""
    rng = np.random.default_rng([seed, 2])
    along = float(rng.uniform(60, 120))
    a = short_submap(seed, along, float(rng.uniform(-0.5, 0.5)), float(rng.normal(0, 2)), "Sunny", False)
    b = short_submap(seed, along + float(rng.uniform(-6, 6)), _LANE_M, 180 + float(rng.normal(0, 2)), "Overcast", True)
    return paired(a, b)


class Boxes:
    """A scene of boxes, walls and cylinders to be scanned from inside or outside."""

    def __init__(self) -> None:
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)

    def box(self, size: Array, T_world_box: Array) -> None:
        """Add a box with its middle at the origin of its frame."""
        mesh = o3d.geometry.TriangleMesh.create_box(*[float(s) for s in size])
        mesh.translate(-np.asarray(size) / 2).transform(T_world_box)
        self._scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))

    def cylinder(self, radius: float, height: float, T_world_cylinder: Array) -> None:
        mesh = o3d.geometry.TriangleMesh.create_cylinder(radius, height, 40).transform(T_world_cylinder)
        self._scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))

    def seen(self, T_world_sensor: Array, directions: Array, sigma_m: float, rng: np.random.Generator) -> Array:
        """Points (N, 3) in the sensor's frame along directions (M, 3), with noise along the beams."""
        turned = directions @ T_world_sensor[:3, :3].T
        rays = np.hstack([np.broadcast_to(T_world_sensor[:3, 3], turned.shape), turned]).astype(np.float32)
        far = self._scene.cast_rays(o3d.core.Tensor(rays), nthreads=1)["t_hit"].numpy().astype(np.float64)
        far = far + sigma_m * rng.normal(size=len(far))
        return np.asarray(far[np.isfinite(far), None] * directions[np.isfinite(far)])


def sphere_directions(step_deg: float, lowest_deg: float = -60.0) -> Array:
    """Directions (N, 3) of a scanner on a tripod."""
    azimuth, elevation = np.meshgrid(
        np.radians(np.arange(0, 360, step_deg)), np.radians(np.arange(lowest_deg, 90, step_deg))
    )
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], -1).reshape(-1, 3)


def camera_directions(columns: int = 320, rows: int = 240, focal: float = 260.0) -> Array:
    """Unit directions (N, 3) of a depth camera: x right, y down, z forward."""
    u, v = np.meshgrid(np.arange(columns), np.arange(rows))
    rays = np.stack([(u - columns / 2) / focal, (v - rows / 2) / focal, np.ones_like(u, dtype=float)], -1)
    return (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).reshape(-1, 3)


def room(seed: int) -> tuple[Boxes, Array]:
    """A furnished room, and its size (3,): 4 to 6 m long."""
    rng = np.random.default_rng([seed, 3])
    size = np.array([rng.uniform(4, 6), rng.uniform(3, 4.5), rng.uniform(2.4, 2.8)])
    scene = Boxes()
    for axis in range(3):
        for sign in (-1, 1):
            at = np.array([0, 0, size[2] / 2])
            at[axis] += sign * (size[axis] / 2 + 0.05)
            wall = size + 0.2
            wall[axis] = 0.1
            scene.box(wall, make_transform(np.eye(3), at))
    for _ in range(9):
        thing = rng.uniform([0.3, 0.3, 0.3], [1.4, 0.7, 1.9])
        yaw = float(rng.choice([0, np.pi / 2])) + float(rng.normal(0, 0.03))
        edge = rng.uniform(-0.5, 0.5, 2) * (size[:2] - 0.7)
        axis = int(rng.integers(2))
        edge[axis] = np.sign(edge[axis]) * (size[axis] / 2 - 0.35)
        scene.box(thing, make_transform(so3_exp([0, 0, yaw]), [*edge, thing[2] / 2]))
    for _ in range(2):
        height = float(rng.uniform(0.5, 1.2))
        at = rng.uniform(-0.3, 0.3, 2) * size[:2]
        scene.cylinder(float(rng.uniform(0.05, 0.25)), height, make_transform(np.eye(3), [*at, height / 2]))
    return scene, size


def in_the_room(size: Array, rng: np.random.Generator, height_m: float) -> Array:
    """``T_world_sensor`` (4, 4), upright, somewhere in the middle of a room."""
    at = rng.uniform(-0.25, 0.25, 2) * size[:2]
    return make_transform(so3_exp([0, 0, float(rng.uniform(0, 2 * np.pi))]), [*at, height_m])


def room_view(seed: int, which: int, sigma_m: float = 0.003) -> View:
    """A scan of a room by a scanner on a tripod."""
    scene, size = room(seed)
    rng = np.random.default_rng([seed, 4, which])
    T = in_the_room(size, rng, float(rng.uniform(1.2, 1.6)))
    points = scene.seen(T, sphere_directions(1.2), sigma_m, rng)
    return View(Cloud("room", points, np.zeros_like(points), supposed=True), T)


def room_pair(seed: int) -> Pair:
    return paired(room_view(seed, 0), room_view(seed, 1))


def merged_room_pair(seed: int) -> Pair:
    """Two clouds of a room, each of two scans put together, without any sensor's position, in frames of their own."""
    made = []
    for half in range(2):
        views = [room_view(seed, 10 + 2 * half + k) for k in range(2)]
        rng = np.random.default_rng([seed, 5, half])
        T_cloud_world = make_transform(so3_exp([0, 0, float(rng.uniform(0, 6))]), rng.uniform(-3, 3, 3))
        points = np.concatenate([apply(T_cloud_world @ v.T_world_cloud, v.cloud.points) for v in views])
        made.append(View(Cloud("rooms", points), np.asarray(invert(T_cloud_world))))
    return paired(made[0], made[1])


def unrelated_rooms(seed: int, *, merged: bool = False) -> Pair:
    """Clouds of two different rooms."""
    if merged:
        return Pair(merged_room_pair(seed).a, merged_room_pair(seed + 1).b, np.full((4, 4), np.nan))
    return Pair(room_view(seed, 0).cloud, room_view(seed + 1, 1).cloud, np.full((4, 4), np.nan))


def unrelated_depth(seed: int) -> Pair:
    """Views of two different rooms by a depth camera."""
    return Pair(depth_pair(seed).a, depth_pair(seed + 1).b, np.full((4, 4), np.nan))


def depth_pair(seed: int) -> Pair:
    """Two views of one corner of a room by a depth camera, turned by up to 25 degrees."""
    scene, size = room(seed)
    rng = np.random.default_rng([seed, 6])
    T_flat_cam = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    start = in_the_room(size, rng, 1.4)
    views = []
    for k in range(2):
        turn = so3_exp(np.array([0.0, 0.25, float(rng.uniform(-0.2, 0.2)) * k]))
        T = start @ make_transform(turn @ T_flat_cam, k * rng.uniform(-0.3, 0.3, 3))
        points = scene.seen(T, camera_directions(), 0.004, rng)
        views.append(View(Cloud("depth", points, np.zeros_like(points), supposed=True), T))
    return paired(views[0], views[1])


def thing_pair(seed: int) -> Pair:
    """Two scans of an object of 1 m from 40 to 70 degrees apart, by a scanner 2 m away, in frames of their own."""
    rng = np.random.default_rng([seed, 7])
    scene = Boxes()
    for _ in range(7):
        size = rng.uniform(0.1, 0.5, 3)
        scene.box(size, make_transform(so3_exp(rng.normal(0, 0.5, 3)), rng.uniform(-0.25, 0.25, 3)))
    for _ in range(2):
        T = make_transform(so3_exp(rng.normal(0, 0.7, 3)), rng.uniform(-0.2, 0.2, 3))
        scene.cylinder(float(rng.uniform(0.05, 0.12)), float(rng.uniform(0.5, 0.9)), T)
    start, views = float(rng.uniform(0, 6)), []
    for k in range(2):
        yaw = start + k * np.radians(rng.uniform(40, 70))
        T = make_transform(so3_exp([0, 0, yaw]), [0, 0, 0]) @ make_transform(np.eye(3), [-2.0, 0, 0.3])
        narrow = sphere_directions(0.12, -25.0)
        narrow = narrow[(narrow[:, 0] > np.cos(np.radians(25)))]
        points = scene.seen(T, narrow, 0.001, rng)
        views.append(View(Cloud("thing", points, np.zeros_like(points), supposed=True), T))
    return paired(views[0], views[1])
