"""The offset between the clocks of images and poses that makes the poses predict what the images show.

An image at time t is taken to have the pose ``T(t + offset)``. For pairs of images of one drive, tracks of points are
compared with what the poses at shifted times predict, in three ways:

- ``lines``: distances of tracks from the epipolar lines of the poses' relative motion; no depth is needed;
- ``points``: distances of tracks from where the depth of the first image and the motion put them in the second;
- ``rotation``: the rotation between the images, from the images and their depth alone, against that of the poses. It
  does not use the poses' translation, which an error of the rig's extrinsics would spoil.

A camera whose rows are read one after the other shows each row at a time of its own, ``t + offset + readout * row``
with row from -0.5 at the top to 0.5. While the camera turns, that moves points like an error of the clock: in the
sequences freiburg1 of TUM RGB-D, the rotation between images as a pinhole camera would see it fits the motion capture
best 20 ms too early, and with a readout of 25 ms at 5 ms. The readout is therefore estimated with the offset.

Each pair of images counts once, however many tracks it has, since errors of the poses move all its tracks together.
The standard deviation is by the jackknife over the images or, of a long drive, over its parts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from relocbench.arrays import Array, Indices, Mask, Times
from relocbench.datasets.clock.tracks import (
    Tracks,
    cross,
    epipolar_distances,
    homogeneous,
    motion_by_depth,
    rotation_by_lines,
)
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.geometry import invert, rotation_angle, se3_log, so3_log

Method = Literal["lines", "points", "rotation"]

REACH_S = 0.1
"""greatest offset that is looked for, in seconds"""
_GRID_S = 0.0125
_READOUT_S = 0.015
"""standard deviation of the readout before any image is seen: cameras take up to 33 ms, or read all rows at once"""
_HUBER_PX = 1.5
_MOST_STEPS = 25
_LONGEST_STEP_S = 0.02
_CUT_PX = 30.0
_SMOOTH_NS = 20_000_000
"""spacing of poses from which on the motion between them is taken for a spline"""
_PARTS = 8
"""parts of a drive from which on the jackknife leaves out parts, not images"""
_FEWEST_PAIRS = 6
_INDEPENDENT = 10
"""tracks of a pair whose errors are independent: those of its many tracks are not, since calibration, depth and the
rows' times err alike in all"""
_NOISE_PX = 0.3
"""least root mean square of what is left"""


@dataclass(frozen=True)
class Estimate:
    """What a method says of the offset."""

    method: Method
    offset_s: float
    sigma_s: float
    readout_s: float
    """time from the first row to the last"""
    readout_sigma_s: float
    pairs: int
    freedom: int
    """degrees of freedom of the standard deviation"""


@dataclass(frozen=True)
class Residual:
    """By how much the motion between images and that of the poses differ, medians over pairs of images."""

    deg: float
    mm: float
    """NaN without depth"""
    pairs: int


@dataclass(frozen=True, eq=False)
class CameraMotion:
    """Where a camera was at the times of its images, by poses of another clock."""

    trajectory: Trajectory
    T_rig_cam: Array
    times_ns: Times
    """(F,) of the images"""

    @classmethod
    def of(cls, trajectory: Trajectory, T_rig_cam: Array, times_ns: Times) -> CameraMotion:
        """The motion by the poses of a trajectory, smooth between poses that are far apart."""
        spacing = float(np.median(np.diff(trajectory.times_ns))) if len(trajectory.times_ns) > 1 else 0.0
        return cls(replace(trajectory, smooth=spacing >= _SMOOTH_NS), T_rig_cam, times_ns)

    @property
    def step_s(self) -> float:
        """Half the time over which velocities are differences: the noise of a pose is in both ends, or in none."""
        spacing = float(np.median(np.diff(self.trajectory.times_ns))) / 1e9
        return min(max(0.01, spacing / 2), 0.1)

    def poses(self, offset_s: float) -> tuple[Array, Mask]:
        """``T_world_cam`` (F, 4, 4) at the images' times plus an offset, and which of them are known (F,)."""
        times = self.times_ns + round(offset_s * 1e9)
        known = self.trajectory.covers(times)
        inside = np.clip(times, self.trajectory.times_ns[0], self.trajectory.times_ns[-1])
        return self.trajectory.at(inside) @ self.T_rig_cam, known

    def twists(self, offset_s: float) -> tuple[Array, Mask]:
        """Velocity and turn rate (F, 6) in the camera's frame, m/s and rad/s, and which of them are known (F,)."""
        (before, known), (after, too) = self.poses(offset_s - self.step_s), self.poses(offset_s + self.step_s)
        return se3_log(invert(before) @ after) / (2 * self.step_s), known & too


@dataclass(frozen=True, eq=False)
class _Model:
    """All tracks of all pairs, against a motion."""

    tracks: Sequence[Tracks]
    motion: CameraMotion
    fx: float

    @property
    def images(self) -> Indices:
        """(P, 2) first and second image of each pair."""
        return np.array([(t.first, t.second) for t in self.tracks], dtype=np.int64).reshape(-1, 2)

    def residuals(self, method: Method, offset_s: float, readout_s: float) -> list[Array | None]:
        """Of each pair what its tracks (N,) or (2 N,) are off in pixels; None where a pose is not known."""
        poses, known = self.motion.poses(offset_s)
        twists, moving = self.motion.twists(offset_s)
        usable = known & (moving | (readout_s == 0.0))
        out: list[Array | None] = []
        for one in self.tracks:
            if not (usable[one.first] and usable[one.second]):
                out.append(None)
                continue
            T = invert(poses[one.second]) @ poses[one.first]
            late = readout_s * one.row_x, readout_s * one.row_y
            if method == "points":
                off = _reprojected(one, T, twists[one.first], twists[one.second], late)
            else:
                off = _beside_lines(one, T, twists[one.first], twists[one.second], late)
            out.append(self.fx * off)
        return out


def _unrolled(rays: Array, twist: Array, late: Array, depth: Array | None = None) -> Array:
    """Rays (N, 3) as the camera would see them at the middle row's time: ``X + late (omega x X + v)``."""
    turned = cross(twist[3:], rays)
    if depth is not None:
        turned = turned + np.where(np.isfinite(depth), 1.0 / depth, 0.0)[:, None] * twist[:3]
    return np.asarray(rays + late[:, None] * turned)


def _beside_lines(one: Tracks, T: Array, first: Array, second: Array, late: tuple[Array, Array]) -> Array:
    x = _unrolled(homogeneous(one.x), first, late[0])
    y = _unrolled(homogeneous(one.y), second, late[1])
    # The centres of both rows' cameras, seen from that of the second image.
    moved = T[:3, 3] + (late[0][:, None] * first[:3]) @ T[:3, :3].T - late[1][:, None] * second[:3]
    return epipolar_distances(x, y, T[:3, :3], moved)


def _reprojected(one: Tracks, T: Array, first: Array, second: Array, late: tuple[Array, Array]) -> Array:
    known = np.isfinite(one.depth)
    points = homogeneous(one.x[known]) * one.depth[known, None]
    points = points + late[0][known, None] * (cross(first[3:], points) + first[:3])
    there = points @ T[:3, :3].T + T[:3, 3]
    back = cross(second[3:], there) + second[:3]
    there = there - late[1][known, None] * back
    z = np.where(there[:, 2:] > 1e-3, there[:, 2:], np.nan)
    return np.nan_to_num(np.ravel(there[:, :2] / z - one.y[known]))


def estimate_by_tracks(
    method: Literal["lines", "points"], tracks: Sequence[Tracks], motion: CameraMotion, fx: float, parts: Indices
) -> Estimate | None:
    """The offset and the readout by lines or points; None where too few pairs tell, or the offset is beyond reach.

    Args:
        parts: (F,) the part of the drive that each image belongs to.
    """
    if method == "points":
        tracks = [one for one in tracks if np.count_nonzero(np.isfinite(one.depth)) >= 20]
    model = _Model(tracks, motion, fx)
    if len(tracks) < _FEWEST_PAIRS:
        return None

    def residuals(at: Array) -> list[Array | None]:
        return model.residuals(method, float(at[0]), float(at[1]))

    prior = np.array([0.0, 1.0 / _READOUT_S**2])
    return _fitted(method, residuals, model.images, prior, motion.step_s, parts)


def estimate_by_rotation(
    motions: Sequence[tuple[int, int, Array]], motion: CameraMotion, fx: float, parts: Indices
) -> Estimate | None:
    """The offset by the rotations of motions (4, 4) of second images from first ones, which images alone tell."""
    if len(motions) < _FEWEST_PAIRS:
        return None
    images, turns = np.array([(i, j) for i, j, _ in motions]), np.array([T[:3, :3] for _, _, T in motions])

    def residuals(at: Array) -> list[Array | None]:
        poses, known = motion.poses(float(at[0]))
        first, second = poses[images[:, 0], :3, :3], poses[images[:, 1], :3, :3]
        off = fx * so3_log(np.swapaxes(second, 1, 2) @ first @ np.swapaxes(turns, 1, 2))
        return [one if ok else None for one, ok in zip(off, known[images].all(axis=1), strict=True)]

    return _fitted("rotation", residuals, images, np.array([0.0, np.inf]), motion.step_s, parts)


def _fitted(
    method: Method,
    residuals: Callable[[Array], list[Array | None]],
    images: Indices,
    prior: Array,
    step_s: float,
    parts: Indices,
) -> Estimate | None:
    """Gauss-Newton over offset and readout, from the best of a grid of offsets.

    The derivative by the offset is a difference over ``step_s`` to either side, not of the interpolated poses: noise
    of poses is smaller half-way between two of them, which would draw the offset there.
    """
    free = np.isfinite(prior)
    at = _start(residuals)
    if at is None:
        return None
    for _ in range(_MOST_STEPS):
        normal = _normal_equations(residuals, at, free, step_s)
        if normal is None:
            return None
        H, g, noise = normal
        step = _solved(H.sum(axis=0), g.sum(axis=0), at, prior, free, noise)
        step *= min(1.0, _LONGEST_STEP_S / max(abs(float(step[0])), 1e-12))
        at = at + step
        if abs(at[0]) > REACH_S:
            return None
        if np.max(np.abs(step)) < 1e-6:
            break
    normal = _normal_equations(residuals, at, free, step_s)
    if normal is None:
        return None
    H, g, noise = normal
    used = np.any(H != 0, axis=(1, 2))
    if np.count_nonzero(used) < _FEWEST_PAIRS:
        return None
    sigma, freedom = _spread(H, g, images, at, prior, free, noise, parts)
    return Estimate(
        method, float(at[0]), float(sigma[0]), float(at[1]), float(sigma[1]), int(np.count_nonzero(used)), freedom
    )


def _start(residuals: Callable[[Array], list[Array | None]]) -> Array | None:
    """The best offset of a grid, without readout."""
    costs: list[tuple[float, float]] = []
    for offset in np.arange(-REACH_S, REACH_S + 1e-9, _GRID_S):
        off = residuals(np.array([offset, 0.0]))
        sizes = [float(np.mean(np.minimum(np.abs(one), _CUT_PX))) for one in off if one is not None]
        if len(sizes) >= max(_FEWEST_PAIRS, len(off) / 2):
            costs.append((float(np.mean(sizes)), float(offset)))
    return np.array([min(costs)[1], 0.0]) if costs else None


def _normal_equations(
    residuals: Callable[[Array], list[Array | None]], at: Array, free: Mask, step_s: float
) -> tuple[Array, Array, float] | None:
    """(P, 2, 2) and (P, 2) of each pair, zero where it tells nothing, and the variance of what a pair says together."""
    middle = residuals(at)
    steps = np.diag([step_s, 0.002])
    sides = [(residuals(at + step), residuals(at - step)) if ok else None for step, ok in zip(steps, free, strict=True)]
    H, g, left = np.zeros((len(middle), 2, 2)), np.zeros((len(middle), 2)), []
    for k, r in enumerate(middle):
        ends = [(side[0][k], side[1][k]) if side else None for side in sides]
        if r is None or not len(r) or any(end is not None and (end[0] is None or end[1] is None) for end in ends):
            continue
        J = np.column_stack(
            [
                (end[0] - end[1]) / (2 * steps[n, n]) if end is not None else np.zeros(len(r))  # type: ignore[operator]
                for n, end in enumerate(ends)
            ]
        )
        weight = 1.0 / np.maximum(1.0, np.abs(r) / _HUBER_PX)
        H[k], g[k] = J.T @ (J * weight[:, None]) / len(r), J.T @ (weight * r) / len(r)
        left.append(float(np.mean(weight * r**2)))
    return (H, g, max(float(np.mean(left)), _NOISE_PX**2) / _INDEPENDENT) if len(left) >= _FEWEST_PAIRS else None


def _solved(H: Array, g: Array, at: Array, prior: Array, free: Mask, noise: float) -> Array:
    """The step (2,) from normal equations and the prior of the readout."""
    step = np.zeros(2)
    weight = noise * prior[free]
    A = H[np.ix_(free, free)] + np.diag(weight)
    step[free] = -np.linalg.lstsq(A, g[free] + weight * at[free], rcond=None)[0]
    return step


def _spread(
    H: Array, g: Array, images: Indices, at: Array, prior: Array, free: Mask, noise: float, parts: Indices
) -> tuple[Array, int]:
    """Standard deviations (2,) by the jackknife, and their degrees of freedom.

    Not less than what the noise of single pairs gives, in which the prior has its part.
    """
    used = np.flatnonzero(np.any(H != 0, axis=(1, 2)))
    of_parts = np.unique(parts[images[used]])
    groups = parts[images[used]] if len(of_parts) >= _PARTS else images[used]
    names = np.unique(groups)
    found = []
    for name in names:
        kept = used[np.all(groups != name, axis=1)]
        if len(kept):
            found.append(at + _solved(H[kept].sum(axis=0), g[kept].sum(axis=0), at, prior, free, noise))
    n = len(found)
    jackknife = np.sqrt((n - 1) / n * np.sum((np.array(found) - np.mean(found, axis=0)) ** 2, axis=0))
    A = H.sum(axis=0)[np.ix_(free, free)] + np.diag(noise * prior[free])
    model = np.zeros(2)
    model[free] = np.sqrt(np.maximum(noise * np.diag(np.linalg.pinv(A)), 0.0))
    return np.maximum(jackknife, model), max(n - 1, 1)


def image_motions(
    tracks: Sequence[Tracks], motion: CameraMotion, fx: float, offset_s: float, readout_s: float
) -> list[tuple[int, int, Array]]:
    """(first, second, ``T_second_first`` (4, 4)) of each pair by its images alone, freed of the readout.

    The translation is NaN where there is no depth.
    """
    twists, moving = motion.twists(offset_s)
    out = []
    for one in tracks:
        late = None
        if readout_s != 0.0:
            if not (moving[one.first] and moving[one.second]):
                continue
            late = (twists[one.first], readout_s * one.row_x), (twists[one.second], readout_s * one.row_y)
        T = _image_motion(one, fx, late)
        if T is not None:
            out.append((one.first, one.second, T))
    return out


def _image_motion(one: Tracks, fx: float, late: tuple[tuple[Array, Array], tuple[Array, Array]] | None) -> Array | None:
    """``T_second_first`` (4, 4) between two images by their tracks alone; None where they do not tell it.

    The translation is NaN where there is no depth.

    Args:
        late: of both images the twist of the camera, and the seconds (N,) after the image's time at which it saw them.
    """
    x, y = homogeneous(one.x), homogeneous(one.y)
    if late is not None:
        x, y = _unrolled(x, *late[0], one.depth), _unrolled(y, *late[1], one.depth)
    T = motion_by_depth(one, x, y, fx)
    if T is not None:
        return T
    R = rotation_by_lines(x, y, fx)
    if R is None:
        return None
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, np.nan
    return T


def residual_at(motions: Sequence[tuple[int, int, Array]], motion: CameraMotion, offset_s: float) -> Residual | None:
    """By how much motions between images differ from those of the poses at an offset."""
    poses, known = motion.poses(offset_s)
    return difference([(T, invert(poses[j]) @ poses[i]) for i, j, T in motions if known[i] and known[j]])


def difference(motions: Sequence[tuple[Array, Array]]) -> Residual | None:
    """By how much motions (4, 4) by images and by poses differ; None where there are none."""
    if not motions:
        return None
    turned = [float(np.degrees(rotation_angle(T[:3, :3] @ by_poses[:3, :3].T))) for T, by_poses in motions]
    moved = [float(np.linalg.norm(T[:3, 3] - by_poses[:3, 3])) * 1000 for T, by_poses in motions]
    with_depth = [one for one in moved if np.isfinite(one)]
    return Residual(float(np.median(turned)), float(np.median(with_depth)) if with_depth else np.nan, len(turned))
