"""Clouds of shapes that leave motions open, for ``register_clouds.py``: no pose of theirs may be trusted.

A corridor, a floor and a tunnel are cut around the sensor, which moved along them, as a scan is by its range.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from register_scenes import Pair

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.clouds.cloud import Cloud
from relocbench.geometry import apply, invert, make_transform, so3_exp

_POINTS, _SIGMA_M, _REACH_M = 25_000, 0.01, 15.0


def shape_pair(name: str, seed: int) -> Pair:
    """Two clouds of a shape, each measured anew; where the sensor is known, the second from 3 m further along."""
    make, known = SHAPES[name]
    rng = np.random.default_rng([seed, 21])
    T_a_b = make_transform(so3_exp(rng.normal(0, 0.03, 3)), [3.0, *rng.normal(0, 0.1, 2)] if known else [0.2, 0.1, 0.1])
    clouds = []
    for T in (np.eye(4), T_a_b):
        points = make(rng, float(T[0, 3]))
        points = apply(invert(T), points + _SIGMA_M * rng.normal(size=points.shape))
        clouds.append(Cloud(name, points, np.zeros_like(points) if known else None, supposed=known))
    return Pair(clouds[0], clouds[1], T_a_b)


def _corridor(rng: np.random.Generator, at_m: float) -> Array:
    size, walls = np.array([3.0, 2.6]), rng.integers(4, size=_POINTS)
    across = rng.uniform(-0.5, 0.5, (_POINTS, 2)) * size
    rows = np.arange(_POINTS)
    across[rows, walls % 2] = (walls // 2 - 0.5) * size[walls % 2]
    return np.column_stack([rng.uniform(at_m - _REACH_M, at_m + _REACH_M, _POINTS), across])


def _floor(rng: np.random.Generator, at_m: float) -> Array:
    away, turn = _REACH_M * np.sqrt(rng.random(_POINTS)), rng.uniform(0, 2 * np.pi, _POINTS)
    return np.column_stack([at_m + away * np.cos(turn), away * np.sin(turn), np.full(_POINTS, -1.7)])


def _tunnel(rng: np.random.Generator, at_m: float) -> Array:
    turn = rng.uniform(0, 2 * np.pi, _POINTS)
    along = rng.uniform(at_m - _REACH_M, at_m + _REACH_M, _POINTS)
    return np.column_stack([along, 2.5 * np.cos(turn), 2.5 * np.sin(turn)])


def _sphere(rng: np.random.Generator, at_m: float) -> Array:
    v = rng.normal(size=(_POINTS, 3))
    return np.asarray(3.0 * v / np.linalg.norm(v, axis=1, keepdims=True))


def _staircase(rng: np.random.Generator, at_m: float) -> Array:
    """Steps of 28 x 17 cm between two walls, as far as the sensor reaches."""
    run, rise, width, reach = 0.28, 0.17, 1.6, 4.0
    at = rng.uniform(at_m - reach, at_m + reach, _POINTS)
    step, kind, part = np.floor(at / run), rng.random(_POINTS), rng.random(_POINTS)
    across = rng.uniform(-width / 2, width / 2, _POINTS)
    tread = np.column_stack([at, across, step * rise])
    riser = np.column_stack([step * run, across, (step - part) * rise])
    wall = np.column_stack([at, np.sign(across) * width / 2, step * rise + 2.0 * part])
    tread, riser, wall = (shape - [0, 0, 1.5] for shape in (tread, riser, wall))
    return np.where((kind < 0.35)[:, None], tread, np.where((kind < 0.6)[:, None], riser, wall))


SHAPES: dict[str, tuple[Callable[[np.random.Generator, float], Array], bool]] = {
    "corridor": (_corridor, True),
    "floor": (_floor, True),
    "tunnel": (_tunnel, True),
    "sphere": (_sphere, False),
    "staircase": (_staircase, False),
}
"""makers of points around a place along x, and whether the sensor is known"""
