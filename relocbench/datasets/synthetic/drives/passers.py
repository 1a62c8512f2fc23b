"""Everything that moves during a traversal: cars, bicycles, and people on the pavements."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.drives.drive import RATE_HZ, Drive, Route
from relocbench.datasets.synthetic.drives.traffic import on_the_road
from relocbench.datasets.synthetic.town.footpaths import Footpath
from relocbench.datasets.synthetic.town.moving import Kind, Moving
from relocbench.geometry import invert

_SEEN_M = 50.0
"""farthest distance of a person from our car; beyond, one is a few pixels high"""
_STANDING = 0.3
"""share of the groups of people that stand"""
_SIZES = (0.66, 0.28, 0.06)
"""shares of groups of one, two and three people"""
_BESIDE_M = 0.62
"""distance of those who go together"""
_CLEAR_M = (3.2, 1.5)
"""half the length and width of the space around our car's middle in which nobody is"""
_CLEAR_ON_ROAD_M = (9.0, 2.6)
"""the same for those who cross the road"""
_SHELTERED = 0.6
"""share of those who walk in the rain that have an umbrella"""
_RIDERS = 0.08
"""bicycles per 100 m of lane, relative to people per 100 m of pavement"""


def all_that_moves(
    footpaths: Sequence[Footpath], route: Route, drive: Drive, factors: Factors, rng: np.random.Generator
) -> tuple[tuple[Moving, ...], ...]:
    """Cars, bicycles and people at every step of a drive, as many as the factors say."""
    cars = on_the_road(route, drive, factors.traffic, route.other_lane_m, rng)
    riders = on_the_road(route, drive, _RIDERS * factors.people, route.other_lane_m, rng, Kind.RIDER)
    people = passers(footpaths, drive.T_world_rig, factors.people, rng, in_rain=factors.rain_mm_h > 0)
    return tuple(tuple(chain(*step)) for step in zip(cars, riders, people, strict=True))


def passers(
    footpaths: Sequence[Footpath],
    T_world_rig: Array,
    per_100_m: float,
    rng: np.random.Generator,
    *,
    in_rain: bool = False,
) -> list[list[Moving]]:
    """The people near our car at every step of a drive with poses (N, 4, 4).

    They are alone or in small groups, of which some stand and the others walk round their block at a speed of their
    own, either way, or across a zebra. Some blocks have more people than others.

    Args:
        per_100_m: people per 100 m of pavement on average.
        in_rain: many of those who walk have umbrellas.
    """
    found: list[list[Moving]] = [[] for _ in T_world_rig]
    time = np.arange(len(T_world_rig)) / RATE_HZ
    mean_size = float(np.dot(_SIZES, [1, 2, 3]))
    for path in footpaths:
        groups = rng.poisson(rng.uniform(0.4, 1.6) * per_100_m * path.length / 100 / mean_size)
        for start in rng.uniform(0.0, path.length, groups):
            for track, kind in _group(path, start + 0.0 * time, time, rng):
                variant = int(rng.integers(2**31))
                if in_rain and kind == Kind.WALKER and rng.random() < _SHELTERED:
                    kind = Kind.SHELTERED
                for i in np.flatnonzero(_near(T_world_rig, track, _CLEAR_ON_ROAD_M if path.on_road else _CLEAR_M)):
                    found[i].append(Moving(track[i], variant, kind))
    return found


def _group(path: Footpath, start: Array, time: Array, rng: np.random.Generator) -> list[tuple[Array, Kind]]:
    """Poses (N, 4, 4) of each of some people who begin at ``start`` (N,) together, and what they do."""
    count = int(rng.choice(len(_SIZES), p=_SIZES)) + 1
    stands, aside = rng.random() < _STANDING and not path.on_road, rng.uniform(-0.25, 0.3)
    speed = 0.0 if stands else float(rng.uniform(1.0, 1.7) * rng.choice([-1, 1]))
    turn = rng.uniform(-np.pi, np.pi)
    found = []
    for k in range(count):
        if stands:
            # Those who stand together face each other.
            yaw = turn + np.pi * k + rng.normal(0, 0.3)
            found.append((path.poses(start + 0.9 * k, aside + 0.1 * k, yaw if count == 1 else np.pi * k), Kind.STANDER))
        else:
            back = 0.9 * (k // 2) * np.sign(speed)
            beside = aside + _BESIDE_M * (k % 2) * (1 if aside < 0 else -1)
            found.append((path.poses(start + speed * time - back, beside, 0.0 if speed > 0 else np.pi), Kind.WALKER))
    return found


def _near(T_world_rig: Array, track: Array, clear_m: tuple[float, float]) -> Mask:
    """At which steps (N,) a person is near our car, and not in its way."""
    offset = (invert(T_world_rig) @ track)[:, :2, 3]
    in_the_way = (np.abs(offset) < np.array(clear_m)).all(axis=1)
    return np.asarray((np.linalg.norm(offset, axis=1) < _SEEN_M) & ~in_the_way)
