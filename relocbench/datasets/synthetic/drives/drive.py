"""Drives: where the car is at every step of a traversal.

Every traversal of a district follows the same route from end to end, on its own line within the lane, at its own
pace and with its own small heading offset.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from relocbench.geometry import make_transform, so3_exp

Array = NDArray[np.float64]

RATE_HZ = 10.0
STEP_NS = 100_000_000
MARGIN_M = 40.0
"""of the route before the start and after the end of a drive, where other cars come from and go to"""
_START_M = 0.5
"""traversals start up to so far before or behind the same place"""
_PACE = 0.4
"""the speed differs from its mean by less than this share"""
_PACE_WAVE_M = 45.0
_HARDEST_MPS2 = 2.0
"""nobody brakes or speeds up harder"""
_SWAY_WAVES_M = (27.0, 61.0)
_BODY_DEG = 0.3
"""largest pitch and roll of the car's body"""
_BODY_M = 0.01
"""largest heave"""


class Route(Protocol):
    """The line that is driven: :class:`relocbench.datasets.synthetic.town.network.Path`."""

    @property
    def length(self) -> float:
        """Metres."""
        ...

    def pose(self, s: float, lateral_m: float = 0.0, yaw_rad: float = 0.0) -> Array:
        """``T_world_vehicle`` (4, 4) at ``s`` metres."""
        ...


@dataclass(frozen=True)
class DriveStyle:
    """What differs from traversal to traversal, as bounds."""

    speed_mps: float = 8.0
    """mean"""
    lateral_m: float = 0.6
    """the car keeps within so much of the lane's middle"""
    heading_deg: float = 2.0
    """the rig is turned against the direction of travel by up to so much"""


@dataclass(frozen=True, eq=False)
class Drive:
    """One traversal."""

    along: Array
    """(N,) metres along the route, increasing"""
    T_world_rig: Array
    """(N, 4, 4)"""


def route_length(steps: int, style: DriveStyle) -> float:
    """Metres of the route that all drives of so many steps stay on."""
    return (steps - 1) * style.speed_mps / RATE_HZ + 2 * MARGIN_M


def drive(route: Route, steps: int, style: DriveStyle, rng: np.random.Generator) -> Drive:
    """``steps`` poses at 10 Hz along the route, from ``MARGIN_M`` behind its start to ``MARGIN_M`` before its end."""
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
    """(steps,) share of the way, from 0 to 1; its derivative stays within ``_PACE`` of its mean, and the acceleration
    ``v sum a_k w_k`` (mean speed v, waves of w_k radians a second) below ``_HARDEST_MPS2``.

    ``t + sum a_k / (2 pi k) (cos p_k - cos(2 pi k t + p_k))``: whole periods, so that all traversals end together.
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
    """(N, 4, 4) ``T_vehicle_rig``: how the body pitches, rolls and heaves on its springs."""
    waves = 2 * np.pi / np.array([5.3, 9.1, 3.7])
    motion = np.sin(waves * along[:, None] + rng.uniform(0, 2 * np.pi, size=3))
    zero = np.zeros_like(along)
    bound = np.radians(_BODY_DEG)
    rotation = so3_exp(np.stack([bound * motion[:, 0], bound * motion[:, 1], zero], axis=-1))
    return make_transform(rotation, np.stack([zero, zero, _BODY_M * motion[:, 2]], axis=-1))
