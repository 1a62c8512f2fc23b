"""Simulated measurements of the car's motion: visual odometry with drift, and GNSS/INS with errors of metres.

Roll, pitch and yaw stand for ``R = Rz(yaw) Ry(pitch) Rx(roll)``, the convention of the Oxford RobotCar files.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Times
from relocbench.geometry import invert, make_transform, so3_exp


def rotation_from_rpy(roll_pitch_yaw: ArrayLike) -> Array:
    """Rotations ``Rz(yaw) Ry(pitch) Rx(roll)`` (..., 3, 3) of roll, pitch and yaw (..., 3) in radians."""
    angles = np.asarray(roll_pitch_yaw, dtype=np.float64)
    x, y, z = (so3_exp(angles[..., i, None] * np.eye(3)[i]) for i in range(3))
    return np.asarray(z @ y @ x)


def rpy_from_rotation(rotation: ArrayLike) -> Array:
    """Roll, pitch and yaw (..., 3) of rotations (..., 3, 3), pitch in [-pi/2, pi/2]; roll is 0 if pitch is +-pi/2."""
    r = np.asarray(rotation, dtype=np.float64)
    level = np.hypot(r[..., 0, 0], r[..., 1, 0])
    pitch = np.arctan2(-r[..., 2, 0], level)
    steep = level < 1e-9
    roll = np.where(steep, 0.0, np.arctan2(r[..., 2, 1], r[..., 2, 2]))
    yaw = np.where(steep, np.arctan2(-r[..., 0, 1], r[..., 1, 1]), np.arctan2(r[..., 1, 0], r[..., 0, 0]))
    return np.stack([roll, pitch, yaw], axis=-1)


def transform_from_xyzrpy(values: ArrayLike) -> Array:
    """Transforms (..., 4, 4) of x, y, z, roll, pitch, yaw (..., 6)."""
    v = np.asarray(values, dtype=np.float64)
    return make_transform(rotation_from_rpy(v[..., 3:]), v[..., :3])


def xyzrpy_from_transform(transform: ArrayLike) -> Array:
    """x, y, z, roll, pitch, yaw (..., 6) of transforms (..., 4, 4)."""
    m = np.asarray(transform, dtype=np.float64)
    return np.concatenate([m[..., :3, 3], rpy_from_rotation(m[..., :3, :3])], axis=-1)


@dataclass(frozen=True)
class OdometryErrors:
    """The errors of stereo visual odometry; by default it drifts by about 0.8 m and 0.3 degrees in 100 m."""

    scale: float = 0.008
    """standard deviation of the relative error of scale"""
    scale_length_m: float = 150.0
    """correlation length of the error of scale"""
    turn_rad_per_m: float = 6e-5
    """standard deviation of the yaw drift rate"""
    turn_length_m: float = 60.0
    """correlation length of the yaw drift rate"""
    step_m: float = 0.002
    """noise of each step and axis"""
    step_rad: float = 2e-4
    """noise of each step and axis"""


EXACT = OdometryErrors(scale=0.0, turn_rad_per_m=0.0, step_m=0.0, step_rad=0.0)
"""odometry without errors"""


def visual_odometry(T_world_body: Array, errors: OdometryErrors, rng: np.random.Generator) -> Array:
    """Simulated visual odometry for each step of a drive.

    The error of scale and the yaw drift rate are first-order Gauss-Markov processes over the driven distance. Yaw is
    about the body's z axis.

    Args:
        T_world_body: (N, 4, 4) true poses.

    Returns:
        (N - 1, 4, 4) ``T_earlier_later`` of successive poses; their product from left to right is the trajectory.
    """
    steps = invert(T_world_body[:-1]) @ T_world_body[1:]
    length = np.linalg.norm(steps[:, :3, 3], axis=1)
    scale = errors.scale * gauss_markov(length / errors.scale_length_m, rng)
    bend = errors.turn_rad_per_m * length * gauss_markov(length / errors.turn_length_m, rng)
    wrong_turn = errors.step_rad * rng.normal(size=(len(steps), 3))
    wrong_turn[:, 2] += bend
    wrong_step = errors.step_m * rng.normal(size=(len(steps), 3))
    return make_transform(steps[:, :3, :3] @ so3_exp(wrong_turn), steps[:, :3, 3] * (1 + scale[:, None]) + wrong_step)


def gauss_markov(steps: Array, rng: np.random.Generator) -> Array:
    """A Gauss-Markov process (N,) of unit variance and correlation ``exp(-distance)``, at distances ``steps`` (N,)."""
    kept = np.exp(-steps)
    fresh = np.sqrt(1 - kept**2) * rng.normal(size=len(steps))
    values = np.empty(len(steps))
    value = float(rng.normal())
    for i in range(len(steps)):
        value = kept[i] * value + fresh[i]
        values[i] = value
    return values


@dataclass(frozen=True)
class InertialErrors:
    """The errors of a GNSS/INS without corrections from a base station, as standard deviations."""

    offset_m: tuple[float, float, float] = (1.5, 1.5, 3.0)
    """constant offset per drive: east, north, up"""
    walk_m: float = 0.03
    """random walk of the offset per axis in a second"""
    noise_m: float = 0.01
    """noise of each solution and axis"""
    heading_deg: float = 0.3
    """constant error of heading per drive"""
    tilt_deg: float = 0.05
    """constant error of roll and pitch per drive"""
    receiver_m: float = 0.8
    """slowly varying error of the receiver's own positions relative to the INS, per axis"""


@dataclass(frozen=True, eq=False)
class Solution:
    """Solutions of the receiver or the INS at N times, in world axes (x east, y north, z up)."""

    times_ns: Times
    """(N,)"""
    T_world_body: Array
    """(N, 4, 4)"""
    velocity: Array
    """(N, 3) m/s"""
    offset_m: Array
    """(3,) constant error of position; the random walk is added to it"""


def inertial(times_ns: Times, T_world_body: Array, errors: InertialErrors, rng: np.random.Generator) -> Solution:
    """Simulated GNSS/INS of a drive: constant offset, slow random walk, noise, and a constant error of attitude.

    Args:
        times_ns: (N,) increasing, N at least 2.
        T_world_body: (N, 4, 4) true poses of the instrument.
    """
    offset = np.array(errors.offset_m) * rng.normal(size=3)
    tilt = np.radians([errors.tilt_deg, errors.tilt_deg, errors.heading_deg]) * rng.normal(size=3)
    seconds = (times_ns - times_ns[0]) / 1e9
    since = np.diff(seconds, prepend=seconds[0])
    walk = np.cumsum(errors.walk_m * np.sqrt(since)[:, None] * rng.normal(size=(len(since), 3)), axis=0)
    noise = errors.noise_m * rng.normal(size=(len(since), 3))
    position = T_world_body[:, :3, 3]
    velocity = np.gradient(position, seconds, axis=0) + 2 * errors.noise_m * rng.normal(size=position.shape)
    pose = make_transform(so3_exp(tilt) @ T_world_body[:, :3, :3], position + offset + walk + noise)
    return Solution(times_ns, pose, velocity, offset)


def receiver(solution: Solution, every: int, errors: InertialErrors, rng: np.random.Generator) -> Solution:
    """The receiver's own fixes at every ``every``-th solution: the INS's positions with further slow errors."""
    times, pose = solution.times_ns[::every], solution.T_world_body[::every].copy()
    since = np.diff(times / 1e9, prepend=times[0] / 1e9) / 10.0
    own = np.stack([gauss_markov(since, rng) for _ in range(3)], axis=1)
    pose[:, :3, 3] += errors.receiver_m * own
    return Solution(times, pose, solution.velocity[::every], solution.offset_m)
