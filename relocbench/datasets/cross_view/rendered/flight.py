"""Camera poses: a drone on descending circles, a satellite straight above, a pedestrian on the street.

University-1652's drone flies three circles around its building while it descends from 256 m to 121.5 m. Its buildings
are campus blocks; those of the town are houses, so the circles are smaller here, in the same proportion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.cross_view.rendered.places import Building
from relocbench.datasets.synthetic.town.network import StreetNetwork
from relocbench.geometry import Camera, make_transform

ROUNDS = 3
FAR_TO_NEAR = 256.0 / 121.5
"""ratio in University-1652"""
ELEVATION_DEG = 50.0
"""elevation of the drone above the horizon, seen from the building"""
DRONE_VIEW_DEG = 45.0
STREET_VIEW_DEG = 75.0
SATELLITE_M = 400.0
"""so far that perspective hardly shows the walls of houses"""
_EYE_M = 1.6
_STRIDE_M = 5.0


@dataclass(frozen=True)
class Optics:
    """The cameras of all views."""

    size: int
    """width and height in pixels"""
    satellite_side_m: float
    """metres of ground that the satellite's image covers"""

    def camera(self, view: str) -> Camera:
        """The square pinhole camera of a view."""
        if view == "satellite":
            focal = self.size * SATELLITE_M / self.satellite_side_m
        else:
            degrees = DRONE_VIEW_DEG if view == "drone" else STREET_VIEW_DEG
            focal = self.size / 2 / float(np.tan(np.radians(degrees) / 2))
        middle = (self.size - 1) / 2
        return Camera("pinhole", self.size, self.size, focal, focal, middle, middle)


def drone(building: Building, views: int, far_m: float, start_rad: float) -> list[Array]:
    """T_world_cam (4, 4) of each view: evenly along three circles, descending from ``far_m``, facing the building."""
    share = np.arange(views) / max(views - 1, 1)
    distance = far_m + (far_m / FAR_TO_NEAR - far_m) * share
    bearing = start_rad + 2 * np.pi * ROUNDS * np.arange(views) / views
    target = np.array([*building.centre, building.height_m / 2])
    up = np.radians(ELEVATION_DEG)
    out = np.stack([np.cos(bearing) * np.cos(up), np.sin(bearing) * np.cos(up), np.full(views, np.sin(up))], axis=1)
    return [facing(target + r * d, target) for r, d in zip(distance, out, strict=True)]


def satellite(building: Building, turn_rad: float = 0.0) -> Array:
    """T_world_cam (4, 4) looking straight down on the building, north up or turned counter-clockwise by an angle."""
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return make_transform(np.stack([[c, s, 0], [s, -c, 0], [0, 0, -1]], axis=1), [*building.centre, SATELLITE_M])


def street(building: Building, views: int, network: StreetNetwork) -> list[Array]:
    """T_world_cam (4, 4) of each view: from the middle of the nearest street, 5 m apart, facing the house."""
    foot, along = nearest_street(building.centre, network)
    target = np.array([*building.centre, 0.45 * building.height_m])
    steps = (np.arange(views) - (views - 1) / 2) * _STRIDE_M
    return [facing(np.array([*(foot + step * along), _EYE_M]), target) for step in steps]


def facing(eye: Array, target: Array) -> Array:
    """T_world_cam (4, 4) of a camera without roll at ``eye`` (3,) that looks at ``target`` (3,)."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return make_transform(np.stack([x, np.cross(z, x), z], axis=1), eye)


def nearest_street(point: Array, network: StreetNetwork) -> tuple[Array, Array]:
    """The nearest point (2,) on the streets' centre lines, and the direction (2,) of that street."""
    best, found = np.inf, (point, np.array([1.0, 0.0]))
    for u, v in sorted(network.street):
        a, along = network.nodes[u], network.nodes[v] - network.nodes[u]
        length = float(np.linalg.norm(along))
        along = along / length
        foot = a + np.clip(float((point - a) @ along), 0.0, length) * along
        distance = float(np.linalg.norm(point - foot))
        if distance < best - 1e-9:
            best, found = distance, (foot, along)
    return found
