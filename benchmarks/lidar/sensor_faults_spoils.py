"""What ``sensor_faults.py`` does to recordings: clocks that are late, extrinsics, odometry and GNSS that are off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.calibration.correction import CorrectedLidar
from relocbench.datasets.groundtruth.calibration.unknowns import NOMINAL, STEADY, Sigmas
from relocbench.datasets.sensors.derived_lidar import DerivedLidar
from relocbench.datasets.sensors.recording import FieldRecording, Scan
from relocbench.geometry import invert, make_transform, se3_exp, so3_exp

Spoil = Callable[[FieldRecording], FieldRecording]
_LATE_NS = 50_000_000
_GNSS_OFF_M = 60.0
"""north and east"""


def same(recording: FieldRecording) -> FieldRecording:
    return recording


def late(recording: FieldRecording, lidars: tuple[str, ...] | None = None, late_ns: int = _LATE_NS) -> FieldRecording:
    """The recording with late lidars; all of them by default."""
    return _spoilt(recording, -late_ns, np.eye(4), lidars or tuple(s.name for s in recording.lidars))


@dataclass(frozen=True, eq=False)
class _Repeating(DerivedLidar):
    """A lidar whose driver sends each scan several times, with new times."""

    times: int

    def read(self, index: int) -> Scan:
        first = index - index % self.times
        scan = self.stream.read(first)
        return Scan(scan.points, scan.times_ns + (self.times_ns[index] - self.times_ns[first]))


def repeated(recording: FieldRecording, times: int) -> FieldRecording:
    """The recording with lidars that send each scan several times."""
    return replace(recording, lidars=tuple(_Repeating(s, times) for s in recording.lidars))


def mounted(
    recording: FieldRecording, how: Callable[[Array], Array], lidars: tuple[str, ...] | None = None
) -> FieldRecording:
    """The recording whose lidars' extrinsics (4, 4), of all of them by default, are replaced by a function of them."""
    names = lidars or tuple(s.name for s in recording.lidars)
    return replace(
        recording,
        lidars=tuple(
            CorrectedLidar(s, 0, how(s.T_rig_lidar) @ np.linalg.inv(s.T_rig_lidar)) if s.name in names else s
            for s in recording.lidars
        ),
    )


def upside_down(T_rig_lidar: Array) -> Array:
    """The extrinsics of a lidar that is taken to be the other way up, where it is."""
    return turned(T_rig_lidar, np.array([np.pi, 0.0, 0.0]))


def turned(T_rig_lidar: Array, rotation: Array) -> Array:
    """Extrinsics turned where the lidar is, by a rotation vector (3,) about the rig's axes."""
    return np.asarray(make_transform(so3_exp(rotation) @ T_rig_lidar[:3, :3], T_rig_lidar[:3, 3]))


def mirrored(T_rig_lidar: Array) -> Array:
    """Extrinsics whose left is right."""
    return np.asarray(np.diag([1.0, -1.0, 1.0, 1.0]) @ T_rig_lidar)


def _spoilt(recording: FieldRecording, early_ns: int, T: Array, lidars: tuple[str, ...]) -> FieldRecording:
    streams = tuple(CorrectedLidar(s, early_ns, T) if s.name in lidars else s for s in recording.lidars)
    return replace(recording, lidars=streams)


def misplaced(recording: FieldRecording, seed: int) -> FieldRecording:
    """The recording with extrinsics of all lidars that are off by 5 cm and 1 degree, in directions by the seed."""
    rng = np.random.default_rng(seed)
    shift, turn = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    T = se3_exp(np.concatenate([0.05 * shift, np.radians(1.0) * turn]))
    return _spoilt(recording, 0, T, tuple(s.name for s in recording.lidars))


def mounted_as_stated(recording: FieldRecording, seed: int, number: int) -> FieldRecording:
    """The recording of a rig whose calibration is as good as it is taken to be where nothing contradicts it.

    Args:
        seed: of what is off in all drives of the rig alike.
        number: of the drive, for what changes from drive to drive.
    """
    always, now = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1, number])

    def off(rng: np.random.Generator, sigmas: Sigmas) -> tuple[Array, float]:
        return rng.normal(size=6) * np.sqrt(sigmas.variances("extrinsics")), float(rng.normal() * sigmas.time_s)

    rig, drive = off(always, NOMINAL)[0], off(now, STEADY)
    lidars = []
    for stream in recording.lidars:
        own, today = off(always, NOMINAL), off(now, STEADY)
        late_ns = round((drive[1] + own[1] + today[1]) * 1e9)
        lidars.append(CorrectedLidar(stream, -late_ns, se3_exp(rig + drive[0] + own[0] + today[0])))
    return replace(recording, lidars=tuple(lidars))


def lost(recording: FieldRecording) -> FieldRecording:
    """The recording with GNSS that is off by 85 m."""
    assert recording.prior is not None
    T = recording.prior.T_odom_rig.copy()
    T[:, :2, 3] += _GNSS_OFF_M
    return replace(recording, prior=replace(recording.prior, T_odom_rig=T))


def unlocated(recording: FieldRecording) -> FieldRecording:
    """The recording without GNSS."""
    return replace(recording, prior=None)


def part(recording: FieldRecording, low_m: float, high_m: float) -> FieldRecording:
    """The part of a recording between two distances from the middle of its drive."""
    times, T = recording.odometry.times_ns, recording.odometry.T_odom_rig
    way = way_of(T)
    inside = (way >= way[-1] / 2 + low_m) & (way <= way[-1] / 2 + high_m)
    return replace(recording, odometry=replace(recording.odometry, times_ns=times[inside], T_odom_rig=T[inside]))


def moved_back(recording: FieldRecording, back_m: float) -> FieldRecording:
    """The recording whose GNSS puts it where the car had been so many metres before."""
    assert recording.prior is not None
    T = recording.prior.T_odom_rig
    way = way_of(T)
    there = np.column_stack([np.interp(way - back_m, way, T[:, k, 3]) for k in range(3)])
    moved = T.copy()
    moved[:, :3, 3] = there
    return replace(recording, prior=replace(recording.prior, T_odom_rig=moved))


def way_of(T: Array) -> Array:
    """(N,) metres along poses (N, 4, 4)."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1))])


def jumped(recording: FieldRecording) -> FieldRecording:
    """The recording with odometry whose step in the middle is off by 30 cm along, 10 cm across and 1 degree."""
    T = recording.odometry.T_odom_rig.copy()
    half = len(T) // 2
    step = se3_exp(np.array([0.3, 0.1, 0.0, 0.0, 0.0, np.radians(1.0)]))
    T[half:] = T[half - 1] @ step @ invert(T[half - 1]) @ T[half:]
    return replace(recording, odometry=replace(recording.odometry, T_odom_rig=T))


def stretched(recording: FieldRecording, factor: float, turn_rad_per_m: float = 0.0) -> FieldRecording:
    """The recording with odometry that is ``factor`` times as long, and turns to the left as it does not."""
    T = recording.odometry.T_odom_rig
    steps = invert(T[:-1]) @ T[1:]
    turns = turn_rad_per_m * np.linalg.norm(steps[:, :3, 3], axis=1)
    steps = steps @ make_transform(so3_exp(turns[:, None] * np.array([0.0, 0.0, 1.0])), np.zeros((len(steps), 3)))
    steps[:, :3, 3] *= factor
    poses = [T[0]]
    for step in steps:
        poses.append(poses[-1] @ step)
    return replace(recording, odometry=replace(recording.odometry, T_odom_rig=np.array(poses)))


def bent(recording: FieldRecording) -> FieldRecording:
    """The recording with odometry that is 2 % too long and turns 3 degrees too far in 100 m."""
    return stretched(recording, 1.02, np.radians(3.0) / 100)
