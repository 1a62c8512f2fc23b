"""What a car knows of its own motion: visual odometry that drifts, and GNSS/INS that is off by metres.

Rotations as roll, pitch and yaw are ``R = Rz(yaw) Ry(pitch) Rx(roll)``, the convention of the Oxford RobotCar files.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relocbench.geometry import invert, make_transform, so3_exp

Array = NDArray[np.float64]
Times = NDArray[np.int64]


def rotation_from_rpy(roll_pitch_yaw: ArrayLike) -> Array:
    """``Rz(yaw) Ry(pitch) Rx(roll)`` of (..., 3) radians: (..., 3, 3)."""
    angles = np.asarray(roll_pitch_yaw, dtype=np.float64)
    x, y, z = (so3_exp(angles[..., i, None] * np.eye(3)[i]) for i in range(3))
    return np.asarray(z @ y @ x)


def rpy_from_rotation(rotation: ArrayLike) -> Array:
    """Roll, pitch and yaw (..., 3) of (..., 3, 3), pitch in [-pi/2, pi/2]; looking straight up or down, roll is 0."""
    r = np.asarray(rotation, dtype=np.float64)
    level = np.hypot(r[..., 0, 0], r[..., 1, 0])
    pitch = np.arctan2(-r[..., 2, 0], level)
    steep = level < 1e-9
    roll = np.where(steep, 0.0, np.arctan2(r[..., 2, 1], r[..., 2, 2]))
    yaw = np.where(steep, np.arctan2(-r[..., 0, 1], r[..., 1, 1]), np.arctan2(r[..., 1, 0], r[..., 0, 0]))
    return np.stack([roll, pitch, yaw], axis=-1)


def transform_from_xyzrpy(values: ArrayLike) -> Array:
    """(..., 4, 4) of x, y, z, roll, pitch, yaw (..., 6)."""
    v = np.asarray(values, dtype=np.float64)
    return make_transform(rotation_from_rpy(v[..., 3:]), v[..., :3])


def xyzrpy_from_transform(transform: ArrayLike) -> Array:
    """x, y, z, roll, pitch, yaw (..., 6) of (..., 4, 4)."""
    m = np.asarray(transform, dtype=np.float64)
    return np.concatenate([m[..., :3, 3], rpy_from_rotation(m[..., :3, :3])], axis=-1)


@dataclass(frozen=True)
class OdometryErrors:
    """The errors of stereo visual odometry; by default it drifts by about 0.8 m and 0.3 degrees in 100 m."""

    scale: float = 0.008
    """standard deviation of the share by which steps are too long or too short"""
    scale_length_m: float = 150.0
    """after so much driving little is left of the present error of scale"""
    turn_rad_per_m: float = 6e-5
    """standard deviation of the rate at which it bends to a side"""
    turn_length_m: float = 60.0
    """after so much driving little is left of the present bend"""
    step_m: float = 0.002
    """noise of each step, each axis"""
    step_rad: float = 2e-4
    """noise of each step, each axis"""


EXACT = OdometryErrors(scale=0.0, turn_rad_per_m=0.0, step_m=0.0, step_rad=0.0)
"""odometry without errors"""


def visual_odometry(T_world_body: Array, errors: OdometryErrors, rng: np.random.Generator) -> Array:
    """What odometry says of each step of a drive.

    Scale and bend are first-order Gauss-Markov processes over the way driven. The bend is about the vertical, which
    is taken to be the body's z.

    Args:
        T_world_body: (N, 4, 4) true poses.

    Returns:
        (N - 1, 4, 4) ``T_earlier_later`` of successive poses; their product, left to right, is the track.
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
    """A process (N,) of unit variance whose correlation falls as ``exp(-distance)``; steps (N,) in its length."""
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
    """east, north, up: of the whole drive; another drive has another"""
    walk_m: float = 0.03
    """by which the offset wanders in a second, each axis"""
    noise_m: float = 0.01
    """of each solution, each axis"""
    heading_deg: float = 0.3
    """of the whole drive"""
    tilt_deg: float = 0.05
    """roll and pitch, of the whole drive"""
    receiver_m: float = 0.8
    """of the receiver alone against the INS, each axis, over seconds"""


@dataclass(frozen=True, eq=False)
class Solution:
    """What the receiver or the INS says at N times, world axes (x east, y north, z up)."""

    times_ns: Times
    """(N,)"""
    T_world_body: Array
    """(N, 4, 4)"""
    velocity: Array
    """(N, 3) m/s"""
    offset_m: Array
    """(3,) error of position of the whole drive; what wanders comes on top"""


def inertial(times_ns: Times, T_world_body: Array, errors: InertialErrors, rng: np.random.Generator) -> Solution:
    """GNSS/INS of a drive: a constant offset, a slow random walk and a little noise; a constant error of attitude.

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
    """The positions of the receiver alone, each so-many-th time: those of the INS with slow errors of its own."""
    times, pose = solution.times_ns[::every], solution.T_world_body[::every].copy()
    since = np.diff(times / 1e9, prepend=times[0] / 1e9) / 10.0
    own = np.stack([gauss_markov(since, rng) for _ in range(3)], axis=1)
    pose[:, :3, 3] += errors.receiver_m * own
    return Solution(times, pose, solution.velocity[::every], solution.offset_m)
