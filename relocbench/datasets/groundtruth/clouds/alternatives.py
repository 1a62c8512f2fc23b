"""Alternatives of the pose of two clouds: turns by quarters, shifts along the axes of the scene, and the next step.

Rooms and streets have surfaces that face along few axes, so that a pose that is turned by a quarter, or shifted along
one of them, may fit as well. Shifts by less than a metre, as from one step of a staircase to the next, and by the
period of a street, are found on a finer grid, by how close surfaces lie to those of the other cloud.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.registration.scene_scale import SceneScale
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap
from relocbench.datasets.groundtruth.verification.alternatives import ShiftOptions, shifted_poses
from relocbench.geometry import apply, make_transform, so3_exp

SHIFT = ShiftOptions(step_m=0.7, apart_m=1.5, most=4, points=300)
_FOLLOWED = 2
"""shifts along one axis from which shifts along the other are tried"""
_QUARTER = np.pi / 2
_DIRECTIONS, _ALIKE = 1500, 0.97
"""normals that axes are found with, and the cosine of the angle within which two face the same way"""
_CONES = (_ALIKE, 0.99, 0.998)
"""cosines of the angles within which an axis is the mean of all normals, one after the other: a street's length from
here, a degree is half a metre"""
_GRID_M, _GRID = 0.2, 5
"""step of the fine grid of shifts, and the number of steps either way along two axes"""
_LEVEL, _REACH_M, _CLOSE_M, _COSINE = 1, 0.5, 0.2, 0.8
"""level of the planes that are compared on it, the largest distance of a match, the distance from its plane at which a
match counts nothing, and the cosine of the largest angle between normals"""
_POINTS = 400
MOST_BESIDE = 8
"""shifts on the finer grid that are tried at most, half of them by less than a metre"""
_AS_CLOSE = 0.6
"""share of the closeness of a pose that another one must reach to be tried"""


def shifts_as_close(a: PlaneMap, b: PlaneMap, T_a_b: Array, scale: SceneScale) -> list[Array]:
    """Shifts of a pose by less than a metre, and along one axis by more, at which surfaces lie about as close.

    They lie within half a step of where they lead to: a refinement that looks further would be drawn from a facade one
    period on to where trees or the ends of the street fit.
    """
    axes, reach = _axes(a), round(_reach_m(scale) / _GRID_M)
    least = _AS_CLOSE * _closeness(a, b, T_a_b)

    def closest(shifts: Array, sides: tuple[int, int]) -> list[tuple[float, Array]]:
        """The best shifts of a grid (2 n + 1, 2 m + 1, 3) that are maxima of it and not next to its middle."""
        close = np.array([[_closeness(a, b, make_transform(np.eye(3), s) @ T_a_b) for s in row] for row in shifts])
        found: list[tuple[float, Array]] = []
        for i, j in zip(*np.nonzero(close >= least), strict=True):
            around = close[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
            if close[i, j] == around.max() and max(abs(i - sides[0]), abs(j - sides[1])) > 1:
                found.append((close[i, j], shifts[i, j]))
        return sorted(found, key=lambda pair: -pair[0])

    near, far = _steps(_GRID), _steps(reach)
    beside = [
        pair
        for first, second in combinations(axes, 2)
        for pair in closest(near[:, None, None] * first + near[None, :, None] * second, (_GRID, _GRID))
    ]
    along = [pair for axis in axes for pair in closest(far[:, None, None] * axis, (reach, 0))]
    return [
        make_transform(np.eye(3), shift) @ T_a_b
        for found in (beside, along)
        for _, shift in sorted(found, key=lambda pair: -pair[0])[: MOST_BESIDE // 2]
    ]


def _steps(count: int) -> Array:
    return np.asarray(np.arange(-count, count + 1) * _GRID_M)


def _reach_m(scale: SceneScale) -> float:
    return min(SHIFT.reach_m, scale.radius_m * scale.factor)


def _closeness(a: PlaneMap, b: PlaneMap, T_a_b: Array) -> float:
    """How close B's planes, sampled evenly over directions, lie to A's: 1 if all lie in them, 0 if none is near."""
    sample, planes = b.sample(_LEVEL), a.level(_LEVEL)
    rows = np.arange(0, len(sample), max(len(sample) // _POINTS, 1))
    if not len(rows):
        return 0.0
    moved = apply(T_a_b, sample.points[rows])
    match = planes.nearest(moved, sample.normals[rows] @ T_a_b[:3, :3].T, _REACH_M, _COSINE)
    away = np.abs(np.einsum("ni,ni->n", planes.normals[match], moved - planes.points[match]))
    return float(np.mean(np.where(match >= 0, np.maximum(1 - away / _CLOSE_M, 0.0), 0.0)))


def alternatives_of(a: PlaneMap, b: PlaneMap, T_a_b: Array, scale: SceneScale) -> list[Array]:
    """Shifts of a pose along the axes of A's surfaces, and of the pose turned by quarters about the axes of B's."""
    axes_a, axes_b = _axes(a), _axes(b)
    options = replace(SHIFT, reach_m=_reach_m(scale))
    turns = [np.zeros(3), *(k * _QUARTER * axis for axis in axes_b for k in (1, 2, 3))]
    out = []
    for turn in turns:
        T = T_a_b @ make_transform(so3_exp(turn), np.zeros(3))
        # Surfaces that face along one axis fit whatever the shift along the other, so that one follows the other.
        for first, second in (axes_a[:2], axes_a[1::-1]):
            for shifted in shifted_poses(a, b, T, options, first)[:_FOLLOWED]:
                out += shifted_poses(a, b, shifted, options, second)[:_FOLLOWED]
    return out


def _axes(planes: PlaneMap) -> list[Array]:
    """Three orthogonal unit vectors (3,): the directions that most surfaces face, the least frequent one first.

    Those of a box are its edges, about which quarter turns map it to itself. Principal axes would not do: of a cube
    any three are.
    """
    every = planes.level(_LEVEL).normals
    normals = planes.sample(_LEVEL).normals
    normals = normals[np.linspace(0, len(normals) - 1, min(_DIRECTIONS, len(normals))).astype(np.int64)]
    if not len(normals):
        return list(np.eye(3))
    alike = np.abs(normals @ normals.T) > _ALIKE
    first = _mean_axis(every, normals[int(np.argmax(alike.sum(axis=1)))])
    across = np.abs(normals @ first) < 0.5
    if across.any():
        second = _mean_axis(every, normals[int(np.argmax(np.where(across, alike.sum(axis=1), -1)))])
    else:
        second = np.eye(3)[int(np.argmin(np.abs(first)))]
    second = second - (second @ first) * first
    second /= np.linalg.norm(second)
    axes = [first, second, np.cross(first, second)]
    facing = [int(np.count_nonzero(np.abs(normals @ axis) > _ALIKE)) for axis in axes]
    return [axes[k] for k in np.argsort(facing, kind="stable")]


def _mean_axis(normals: Array, axis: Array) -> Array:
    """(3,) the mean direction, of either sign, of the normals that face about along an axis (3,)."""
    for cosine in _CONES:
        along = normals @ axis
        near = np.abs(along) > cosine
        if not near.any():
            break
        axis = np.sum(normals[near] * np.sign(along[near])[:, None], axis=0)
        axis = axis / np.linalg.norm(axis)
    return np.asarray(axis)
