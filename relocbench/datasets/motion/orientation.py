"""Whether the rotations of a drive go with its way: order of quaternions, direction of poses, headings, gravity.

What drives or walks moves mostly one way in its own axes. Where rotations are read in another order, or a pose is given
the other way round, all numbers are valid, and neither their size nor their change from one pose to the next tells; the
direction of travel in the rig's axes does, once the road bends: it wanders as read, and is steady as it should be read.

A vehicle has one direction of travel and one vertical axis all along. Stretches in which either is another than in the
rest of the drive are told, for vehicles alone: cameras that are carried look anywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from relocbench.arrays import Array, Indices, Mask, Times
from relocbench.geometry import invert, path_lengths, rotation_angle, spaced

QuaternionOrder = Literal["xyzw", "wxyz"]

_STEADY, _WANDERS = (0.99, 0.97), (0.95, 0.99)
"""lengths of the mean of unit directions of travel in the rig's axes: above the first it is one direction, below the
second it need not be; with few steps, and with many. In 10,528 stretches of 6 to 1000 poses of eleven real drives and
hand-held sequences, none was doubted"""
_MANY, _FEWEST = 20, 5
"""steps"""
_BETTER = 8.0
"""times that the mean must be farther from 1 as read than as it should be read"""
_PARTS = 1000
"""of the path: what stands still has no direction"""
_VEHICLE_M = 100.0
"""a vehicle's drive is at least as long"""
_MOST = 0.9
"""share of a vehicle's steps along one direction, and of its poses with one vertical axis, within 10 degrees"""
_ALIKE, _OTHER = np.cos(np.radians(10.0)), np.cos(np.radians(45.0))
_BENT = 0.9
"""length of the mean of the second axis, in that of the vertical one, below which the road bends enough to tell them"""
_TURN = np.radians(20.0)
"""from one pose to the next, above which the direction of travel is not judged"""
_RUN_M = 5.0
"""metres of the way, at least, that a stretch with other axes has"""


def likely_order(T_world_rig: Array, order: QuaternionOrder) -> QuaternionOrder:
    """The order in which quaternions make more sense.

    Args:
        T_world_rig: (N, 4, 4) as read in ``order``.
    """
    other: QuaternionOrder = "xyzw" if order == "wxyz" else "wxyz"
    return other if _better(T_world_rig, _reordered(T_world_rig, order)) else order


def is_inverse(T_world_rig: Array) -> bool:
    """Whether poses (N, 4, 4) make more sense as those of the world in the rig."""
    return _better(T_world_rig, invert(T_world_rig), _MANY)


def doubts_of_axes(times_ns: Times, T_world_rig: Array) -> Sequence[str]:
    """What is doubtful about the rotations of a drive, with N poses (N, 4, 4), in sentences without a subject."""
    if len(times_ns) <= _FEWEST:
        return ()
    if is_inverse(T_world_rig):
        return (
            "its rotations do not go with its way, and with each pose inverted they do: expected poses of the sensor "
            "in the world, which map points of the sensor into it",
        )
    return [
        f"from {times_ns[first]} to {times_ns[last]} ns its {what} is {degrees:.0f} deg from that of the other poses"
        for what, first, last, degrees in _other_axes(T_world_rig)
    ]


def _reordered(T_world_rig: Array, order: QuaternionOrder) -> Array:
    from scipy.spatial.transform import Rotation  # imported late: loading takes a while

    quaternions = Rotation.from_matrix(T_world_rig[:, :3, :3]).as_quat()
    # The four numbers of each line, put into their places by the other order.
    turned = quaternions[:, [3, 0, 1, 2]] if order == "wxyz" else quaternions[:, [1, 2, 3, 0]]
    out = T_world_rig.copy()
    out[:, :3, :3] = Rotation.from_quat(turned).as_matrix()
    return out


def _better(given: Array, other: Array, fewest: int = _FEWEST) -> bool:
    """Whether the direction of travel wanders in poses as given, and is steady in other ones."""
    steps = [directions(T)[1] for T in (given, other)]
    if min(map(len, steps)) < fewest:
        return False
    many = int(min(map(len, steps)) >= _MANY)
    wandering, steady = (float(np.linalg.norm(u.mean(axis=0))) for u in steps)
    if wandering > _WANDERS[many] or steady < _STEADY[many]:
        return False
    return 1 - wandering >= _BETTER * (1 - steady)


def directions(T_world_rig: Array) -> tuple[Indices, Array]:
    """Rows (M,) at equal distances along the path, and unit directions of travel (M, 3) from each in the rig's axes."""
    positions = T_world_rig[:, :3, 3]
    rows = np.array(spaced(positions, path_lengths(positions)[-1] / _PARTS))
    steps = np.diff(positions[rows], axis=0)
    lengths = np.linalg.norm(steps, axis=1, keepdims=True)
    if not lengths.all():
        return rows[:0], np.zeros((0, 3))
    return rows[:-1], np.einsum("nji,nj->ni", T_world_rig[rows[:-1], :3, :3], steps) / lengths


def _other_axes(T_world_rig: Array) -> Sequence[tuple[str, int, int, float]]:
    """Stretches of a vehicle's drive with other axes: what of them, first and last row, and degrees."""
    way = path_lengths(T_world_rig[:, :3, 3])
    rows, along = directions(T_world_rig)
    if way[-1] < _VEHICLE_M or len(rows) < _MANY:
        return ()
    forward = np.abs(along @ _usual(along))  # who reverses goes along the same axis
    upright = T_world_rig[rows, :3, :3]
    # Within a sharp turn the way to the next pose goes along none of the axes, and that to the last one is unknown.
    turned = np.asarray(rotation_angle(np.swapaxes(upright[:-1], 1, 2) @ upright[1:]))
    forward[np.append(turned, np.inf) > _TURN] = 1.0
    _, constant, rig_axes = np.linalg.svd(upright.mean(axis=0))
    up = upright @ rig_axes[0]
    # On a straight road any axis is constant.
    level = up @ _usual(up) if constant[1] < _BENT * constant[0] else np.ones(len(up))
    if min(np.mean(forward > _ALIKE), np.mean(level > _ALIKE)) < _MOST:
        return ()
    out = []
    for what, cosine in (("direction of travel in its own axes", forward), ("vertical axis", level)):
        for first, last in _runs(cosine < _OTHER):
            if way[rows[last]] - way[rows[first]] >= _RUN_M:
                degrees = float(np.degrees(np.arccos(np.clip(np.median(cosine[first : last + 1]), -1, 1))))
                out.append((what, int(rows[first]), int(rows[last]), degrees))
    return out


def _usual(directions: Array) -> Array:
    """(3,) the direction that most of (N, 3) have."""
    usual = np.median(directions, axis=0)
    return np.asarray(usual / max(float(np.linalg.norm(usual)), 1e-12))


def _runs(wrong: Mask) -> list[tuple[int, int]]:
    """First and last index of each run of what is True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], wrong.astype(np.int8), [0]])))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
