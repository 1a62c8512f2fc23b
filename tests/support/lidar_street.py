"""A straight street whose surfaces are known exactly, scanned by push-broom lidars: what tests of blocks measure."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.sensors.recording import FieldRecording, Scan, Trajectory
from relocbench.geometry import make_transform, so3_exp

START_NS = 1_700_000_000_000_000_000
RIG_HEIGHT_M = 1.5
"""of the rig's origin over the road"""
WALL_M = 6.0
"""from the middle of the street to either wall"""
_BEAMS = 241


@dataclass(frozen=True)
class Box:
    """Something between the walls that may move along the street."""

    x: float
    """of its middle at the start"""
    speed: float = 0.0
    low: tuple[float, float, float] = (-2.0, 2.0, 0.2)
    high: tuple[float, float, float] = (2.0, 4.0, 1.6)


@dataclass(frozen=True, eq=False)
class StreetLidar:
    """Fires its beams in the plane across the street, one after another, from a car that moves on."""

    name: str
    motion: Trajectory
    times: Times
    forward_m: float
    boxes: tuple[Box, ...] = ()
    sigma: float = 0.0
    blind: bool = False
    pattern: Literal["push-broom", "spinning"] = "push-broom"
    max_range_m: float = 50.0
    sigma_m: float = 0.01

    @property
    def T_rig_lidar(self) -> Array:
        # x down, z along the street: the scan's plane is x-y
        rotation = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
        return make_transform(rotation @ so3_exp(np.array([0.05, 0.0, 0.0])), [self.forward_m, 0.1, -0.4])

    @property
    def times_ns(self) -> Times:
        return self.times

    def read(self, index: int) -> Scan:
        angle = np.radians(np.linspace(-135, 135, _BEAMS))
        times = self.times[index] + np.rint(angle / (2 * np.pi) * 20e6).astype(np.int64)
        times = np.clip(times, self.motion.times_ns[0], self.motion.times_ns[-1])
        directions = np.stack([np.cos(angle), np.sin(angle), np.zeros(_BEAMS)], axis=1)
        T = self.motion.at(times) @ self.T_rig_lidar
        aim = np.einsum("nij,nj->ni", T[:, :3, :3], directions)
        reach = cast(T[:, :3, 3], aim, (times - START_NS) / 1e9, self.boxes)
        reach = reach + self.sigma * np.random.default_rng([index, len(self.name)]).normal(size=_BEAMS)
        seen = (reach < self.max_range_m) & (not self.blind)
        return Scan((reach[:, None] * directions)[seen], times[seen])


def cast(origins: Array, directions: Array, seconds: Array, boxes: tuple[Box, ...]) -> Array:
    """(N,) metres to the road (z = 0), the walls (y = +-6, 8 m high) or a box; inf past all."""
    with np.errstate(divide="ignore", invalid="ignore"):
        road = np.where(directions[:, 2] < 0, -origins[:, 2] / directions[:, 2], np.inf)
        wall = (np.sign(directions[:, 1]) * WALL_M - origins[:, 1]) / directions[:, 1]
        wall = np.where(np.isfinite(wall), wall, np.inf)
        top = origins[:, 2] + np.where(np.isfinite(wall), wall, 0.0) * directions[:, 2]
        wall = np.where(top <= 8.0, wall, np.inf)
        nearest = np.minimum(road, wall)
        for box in boxes:
            shift = np.stack([box.x + box.speed * seconds, 0 * seconds, 0 * seconds], axis=1)
            a = (np.array(box.low) + shift - origins) / directions
            b = (np.array(box.high) + shift - origins) / directions
            enter, leave = np.nanmax(np.minimum(a, b), axis=1), np.nanmin(np.maximum(a, b), axis=1)
            nearest = np.where((enter <= leave) & (enter > 0), np.minimum(nearest, enter), nearest)
    return nearest


@dataclass(frozen=True)
class Street:
    """How it is driven."""

    length_m: float = 40.0
    speed: float = 5.0
    stop_s: float = 0.0
    """standing at half of the way"""
    boxes: tuple[Box, ...] = ()
    sigma: float = 0.0
    wobble: float = 0.0
    """standard deviation of each pose of the odometry"""
    gap_s: float = 0.0
    """odometry missing, from half of the way"""
    blind: bool = False
    period_ns: int = 20_000_000
    lidars: tuple[float, ...] = field(default=(1.5, -2.5))
    """metres before the rig's origin"""


def drive_street(street: Street) -> FieldRecording:
    """A recording of the street; the odometry's frame is the street's own, the road at z = 0."""
    moving_s = street.length_m / street.speed
    seconds = np.arange(0.0, moving_s + street.stop_s + 1e-9, 0.05)
    half = moving_s / 2
    x = street.speed * np.where(seconds < half, seconds, np.maximum(seconds - street.stop_s, half))
    rng = np.random.default_rng(1)
    position = np.stack([x, 0.2 * np.sin(x / 15), np.full_like(x, RIG_HEIGHT_M)], axis=1)
    noise = street.wobble * rng.normal(size=position.shape)
    turns = np.stack([0 * x, 0 * x, 0.2 / 15 * np.cos(x / 15)], axis=1)
    times = START_NS + np.rint(seconds * 1e9).astype(np.int64)
    truth = Trajectory(times, make_transform(so3_exp(turns), position))
    told = Trajectory(times, make_transform(so3_exp(turns), position + noise), max_gap_ns=200_000_000)
    if street.gap_s:
        there = (seconds < half) | (seconds > half + street.gap_s)
        told = Trajectory(times[there], told.T_odom_rig[there], max_gap_ns=200_000_000)
    scans = np.arange(times[0] + 20_000_000, times[-1] - 20_000_000, street.period_ns, dtype=np.int64)
    lidars = tuple(
        StreetLidar(f"lidar{i}", truth, scans, forward, street.boxes, street.sigma, street.blind)
        for i, forward in enumerate(street.lidars)
    )
    condition = Condition(weather="clear", season="summer", time_of_day="day")
    return FieldRecording("street", Path("street"), condition, told, lidars)
