"""The rigid motion that most matches of two clouds agree with, found by RANSAC.

Each iteration draws three matches (Fischler and Bolles, Random sample consensus, 1981). Most draws hold a wrong match,
which shows without any motion: a rigid motion keeps the lengths of the sides of a triangle. Only the few motions that
keep them, and turn normals onto normals, are compared with all matches.
"""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.geometry import make_transform
from relocbench.kernels import njit

_SIDES = 0.9
"""least ratio of the lengths of the sides of two triangles"""
_COSINE = float(np.cos(np.radians(30.0)))
"""cosine of the largest angle between two normals"""


def most_agreed(
    points: Array, normals: Array, others: Array, other_normals: Array, near_m: float, draws: Indices, enough: int
) -> tuple[Array, int]:
    """The motion (4, 4) of points onto others that brings most matches within ``near_m``, and how many it brings.

    Args:
        points, normals: (M, 3) of one cloud.
        others, other_normals: (M, 3) the matches of these points in the other cloud, and their unit normals.
        draws: (I, 3) rows of the matches that each iteration draws; a draw that repeats a row is left out.
        enough: iterations end when so many matches agree.
    """
    kept, count = _most_agreed(points, normals, others, other_normals, near_m, draws, enough)
    if count < 3:
        return np.eye(4), count
    R, t = _motion(points[kept], others[kept])
    return make_transform(R, t), count


@njit(cache=True, nogil=True, error_model="numpy")
def _most_agreed(
    points: Array, normals: Array, others: Array, other_normals: Array, near: float, draws: Indices, enough: int
) -> tuple[Indices, int]:  # pragma: no cover - compiled
    """Rows of the matches that agree with the best motion, the closest of those with most, and their number."""
    agree, best = np.empty(len(points), np.int64), np.empty(len(points), np.int64)
    most, least = 0, np.inf
    for i in range(len(draws)):
        drawn = draws[i]
        if not _alike(points, others, drawn):
            continue
        R, t = _motion(points[drawn], others[drawn])
        if not _fits(points, normals, others, other_normals, R, t, drawn, near):
            continue
        count, squares = 0, 0.0
        for k in range(len(points)):
            square = 0.0
            for a in range(3):
                moved = R[a, 0] * points[k, 0] + R[a, 1] * points[k, 1] + R[a, 2] * points[k, 2] + t[a]
                square += (moved - others[k, a]) ** 2
            if square <= near * near:
                agree[count] = k
                count += 1
                squares += square
        if count > most or (count == most and squares < least):
            most, least = count, squares
            agree, best = best, agree
        if most >= enough:
            break
    return best[:most], most


@njit(cache=True, nogil=True, error_model="numpy")
def _alike(points: Array, others: Array, drawn: Indices) -> bool:
    """Whether two triangles have sides of about the same lengths."""
    for k in range(3):
        a, b = drawn[k], drawn[(k + 1) % 3]
        if a == b:
            return False
        one = other = 0.0
        for axis in range(3):
            one += (points[a, axis] - points[b, axis]) ** 2
            other += (others[a, axis] - others[b, axis]) ** 2
        if one < _SIDES**2 * other or other < _SIDES**2 * one:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _fits(
    points: Array, normals: Array, others: Array, other_normals: Array, R: Array, t: Array, drawn: Indices, near: float
) -> bool:
    """Whether a motion brings the drawn points and their normals onto their matches."""
    for k in drawn:
        square = cosine = 0.0
        for a in range(3):
            moved = R[a, 0] * points[k, 0] + R[a, 1] * points[k, 1] + R[a, 2] * points[k, 2] + t[a]
            square += (moved - others[k, a]) ** 2
            cosine += other_normals[k, a] * (
                R[a, 0] * normals[k, 0] + R[a, 1] * normals[k, 1] + R[a, 2] * normals[k, 2]
            )
        if square > near * near or cosine < _COSINE:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _motion(points: Array, others: Array) -> tuple[Array, Array]:
    """R (3, 3) and t (3,) that bring points (M, 3) closest to others (M, 3) (Umeyama, PAMI 1991)."""
    middle, there = np.zeros(3), np.zeros(3)
    for axis in range(3):
        middle[axis], there[axis] = points[:, axis].mean(), others[:, axis].mean()
    U, _, V = np.linalg.svd((others - there).T @ (points - middle))
    R = U @ V
    if np.linalg.det(R) < 0:
        U[:, 2] = -U[:, 2]
        R = U @ V
    return R, there - R @ middle
