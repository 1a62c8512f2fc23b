"""The car's pose at every step of a traversal.

Every traversal of a district follows the same route from end to end, with its own lateral position in the lane, its own
speed profile and its own small heading offset.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from relocbench.arrays import Array
from relocbench.geometry import make_transform, so3_exp

RATE_HZ = 10.0
STEP_NS = 100_000_000
MARGIN_M = 40.0
"""length of the route before the start and after the end of a drive, where other cars appear and disappear"""
_START_M = 0.5
"""greatest distance of a traversal's start from the nominal one"""
_PACE = 0.4
"""greatest deviation of the speed relative to its mean"""
_PACE_WAVE_M = 45.0
_HARDEST_MPS2 = 2.0
"""greatest acceleration and deceleration"""
_SWAY_WAVES_M = (27.0, 61.0)
_BODY_DEG = 0.3
"""greatest pitch and roll of the car's body"""
_BODY_M = 0.01
"""greatest heave of the car's body"""


class Route(Protocol):
    """The line to drive, such as :class:`relocbench.datasets.synthetic.town.network.Path`."""

    @property
    def length(self) -> float:
        """Length in metres."""
        ...

    @property
    def other_lane_m(self) -> float:
        """Metres from the line to the middle of the other lane, positive to the left."""
        ...

    def pose(self, s: float, lateral_m: float = 0.0, yaw_rad: float = 0.0) -> Array:
        """``T_world_vehicle`` (4, 4) at ``s`` metres along the route."""
        ...


@dataclass(frozen=True)
class DriveStyle:
    """Mean speed, and bounds for what differs between traversals."""

    speed_mps: float = 8.0
    """mean speed"""
    lateral_m: float = 0.6
    """greatest distance from the lane's middle"""
    heading_deg: float = 2.0
    """greatest angle between the rig and the direction of travel"""


@dataclass(frozen=True, eq=False)
class Drive:
    """The motion of one traversal."""

    along: Array
    """(N,) metres along the route, increasing"""
    T_world_rig: Array
    """(N, 4, 4)"""


def route_length(steps: int, style: DriveStyle) -> float:
    """Length of route in metres that any drive of so many steps needs."""
    return (steps - 1) * style.speed_mps / RATE_HZ + 2 * MARGIN_M


def drive(route: Route, steps: int, style: DriveStyle, rng: np.random.Generator) -> Drive:
    """A drive of ``steps`` poses at 10 Hz, from ``MARGIN_M`` after the route's start to ``MARGIN_M`` before its end."""
    driven = (steps - 1) * style.speed_mps / RATE_HZ
    along = MARGIN_M + rng.uniform(-_START_M, _START_M) + driven * _pace(steps, driven, rng)
    lateral, slope = _sway(along, style.lateral_m, rng)
    bias, wave = np.radians(style.heading_deg) * np.array([0.6, 0.4]) * [rng.uniform(-1, 1), 1.0]
    heading = bias + wave * np.sin(2 * np.pi * along / _SWAY_WAVES_M[0] + rng.uniform(0, 2 * np.pi))
    on_road = np.array(
        [route.pose(s, y, yaw) for s, y, yaw in zip(along, lateral, np.arctan(slope) + heading, strict=True)]
    )
    return Drive(along, on_road @ _body(along, rng))


def _pace(steps: int, driven_m: float, rng: np.random.Generator) -> Array:
    """Share (steps,) of the distance that has been driven, from 0 to 1, with varying speed.

    It is ``t + sum a_k / (2 pi k) (cos p_k - cos(2 pi k t + p_k))``, with whole periods so that all traversals end at
    the same place. Its derivative stays within ``_PACE`` of its mean, and the acceleration ``v sum a_k w_k`` (mean
    speed v, waves of w_k radians per second) below ``_HARDEST_MPS2``.
    """
    t = np.linspace(0.0, 1.0, steps) if steps > 1 else np.zeros(1)
    slowest = max(1, round(driven_m / _PACE_WAVE_M))
    waves = np.array([slowest, 2 * slowest])
    strength = rng.uniform(0.2, 0.5, size=2) * _PACE
    phase = rng.uniform(0, 2 * np.pi, size=2)
    if steps > 1:
        seconds = (steps - 1) / RATE_HZ
        hardest = driven_m / seconds * np.sum(strength * 2 * np.pi * waves / seconds)
        strength *= min(1.0, _HARDEST_MPS2 / hardest)
    turned = 2 * np.pi * waves * t[:, None] + phase
    return np.asarray(t + np.sum(strength / (2 * np.pi * waves) * (np.cos(phase) - np.cos(turned)), axis=1))


def _sway(along: Array, bound_m: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Lateral offset (N,) in metres, at most ``bound_m``, and its slope along the route."""
    offset = rng.uniform(-0.6, 0.6) * bound_m
    waves = 2 * np.pi / np.array(_SWAY_WAVES_M)
    phase = rng.uniform(0, 2 * np.pi, size=2)
    turned = waves * along[:, None] + phase
    amplitude = 0.2 * bound_m
    return offset + amplitude * np.sin(turned).sum(axis=1), amplitude * (waves * np.cos(turned)).sum(axis=1)


def _body(along: Array, rng: np.random.Generator) -> Array:
    """``T_vehicle_rig`` (N, 4, 4): pitch, roll and heave of the car's body on its springs."""
    waves = 2 * np.pi / np.array([5.3, 9.1, 3.7])
    motion = np.sin(waves * along[:, None] + rng.uniform(0, 2 * np.pi, size=3))
    zero = np.zeros_like(along)
    bound = np.radians(_BODY_DEG)
    rotation = so3_exp(np.stack([bound * motion[:, 0], bound * motion[:, 1], zero], axis=-1))
    return make_transform(rotation, np.stack([zero, zero, _BODY_M * motion[:, 2]], axis=-1))
