"""Other cars, and bicycles, on the road during a traversal."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.drives.drive import RATE_HZ, Drive, Route
from relocbench.datasets.synthetic.town.moving import Kind, Moving
from relocbench.geometry import invert

_NEAREST_M = 14.0
"""least distance between the centres of our car and another one in the same lane"""
_OWN_LANE_M = 2.2
"""lateral distance below which another car is in our way"""
_EDGE_M = 1.15
"""distance of bicycles from the middle of their lane"""
_SLOW = 0.6
"""speed of bicycles relative to that of cars"""


def on_the_road(
    route: Route,
    drive: Drive,
    per_100_m: float,
    lane_m: float,
    rng: np.random.Generator,
    kind: Kind = Kind.CAR,
) -> list[list[Moving]]:
    """The moving cars, or what else rides, at every step of a drive.

    Cars ahead and behind keep their distance to ours, apart from a slow variation. Oncoming cars use the other lane at
    a common constant speed; one that leaves the route at its start reappears at its end. If we are in the lane of
    oncoming cars, there are none, and those in the lane on our right go our way at half that speed.

    Args:
        per_100_m: cars per 100 m of each lane.
        lane_m: metres from the middle of our lane to that of the other, positive to the left.
        kind: bicycles ride at the right-hand edge of their lane, and slowly where they do not keep their distance.
    """
    aside, pace = (_EDGE_M, _SLOW) if kind == Kind.RIDER else (0.0, 1.0)
    count = round(per_100_m * route.length / 100)
    time = np.arange(len(drive.along)) / RATE_HZ
    # Each car starts within its own section of the route, so that no two overlap.
    section = route.length / max(count, 1)
    starts = (np.arange(count) + rng.uniform(0.0, 0.4, size=count)) * section
    speed = pace * rng.uniform(7.0, 10.0)
    looks = rng.integers(2**31, size=(2, count)).tolist()
    cars: list[list[Moving]] = [[] for _ in time]
    gaps = starts - drive.along[0]
    waves = np.sin(2 * np.pi * (time[:, None] / 20.0 + rng.uniform(0, 1, size=count)))
    for k in range(count):
        same_lane = drive.along + gaps[k] + 0.1 * min(section, 20.0) * waves[:, k]
        oncoming = (starts[k] - speed * time) % route.length
        overtaken = (starts[k] + speed / 2 * time) % route.length
        for i in range(len(time)):
            if lane_m < 0:
                cars[i].append(Moving(route.pose(float(overtaken[i]), lane_m - aside), looks[0][k], kind))
                continue
            # Cars in our lane have the route's pose; oncoming ones are turned round in the other lane.
            if abs(same_lane[i] - drive.along[i]) >= _NEAREST_M and 0 <= same_lane[i] <= route.length:
                cars[i].append(Moving(route.pose(float(same_lane[i]), -aside), looks[0][k], kind))
            cars[i].append(Moving(route.pose(float(oncoming[i]), lane_m + aside, np.pi), looks[1][k], kind))
    return [
        [car for car in present if not _in_the_way(T_world_rig, car.T_world_thing)]
        for T_world_rig, present in zip(drive.T_world_rig, cars, strict=True)
    ]


def _in_the_way(T_world_rig: Array, T_world_car: Array) -> bool:
    """Whether another car overlaps ours, which can happen where a route crosses itself."""
    x, y, _ = (invert(T_world_rig) @ T_world_car)[:3, 3]
    return bool(abs(x) < _NEAREST_M - 0.5 and abs(y) < _OWN_LANE_M)
