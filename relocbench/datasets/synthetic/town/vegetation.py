"""Trees with trunk, branches and individual leaves, and hedges."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.datasets.synthetic.town.shapes import Shape, join, quads, triangle_shape, tube


@dataclass(frozen=True)
class _Habit:
    """Dimensions of a kind of tree, in metres."""

    trunk: float
    """height of the lowest branches"""
    height: float
    spread: float
    """radius of the crown"""
    branches: int
    leaves: int
    leaf: float
    """length of a spray of leaves"""


_HABITS = (
    _Habit(2.8, 8.0, 2.3, 9, 800, 0.44),
    _Habit(3.0, 9.5, 2.7, 10, 950, 0.48),
    _Habit(2.6, 6.5, 2.0, 8, 700, 0.38),
    _Habit(2.2, 11.0, 1.5, 13, 800, 0.45),
    _Habit(3.2, 8.5, 3.0, 9, 950, 0.5),
    _Habit(1.8, 5.0, 1.8, 7, 600, 0.35),
)
TREE_TYPES = len(_HABITS)


def crown(kind: int) -> tuple[float, float, float]:
    """Height of the lowest branches, of the top, and radius of the crown of one of TREE_TYPES, in metres."""
    habit = _HABITS[kind]
    return habit.trunk, habit.height, habit.spread


@cache
def tree_shapes(kind: int, coarse: bool = False) -> tuple[Shape, Shape]:
    """Wood and leaves of one of TREE_TYPES; z up, origin at the base of the trunk.

    The coarse version, for trees far from any street, has fewer but larger leaves and no twigs.
    """
    habit = _HABITS[kind]
    if coarse:
        habit = replace(habit, leaves=habit.leaves // 5, leaf=2.2 * habit.leaf)
    rng = np.random.default_rng([7919, kind])
    wood, tips = _wood(habit, rng, coarse)
    return wood, _leaves(habit, tips, rng)


def _wood(habit: _Habit, rng: np.random.Generator, coarse: bool) -> tuple[Shape, Array]:
    """Trunk, branches and twigs, and the points (P, 3) around which leaves grow."""
    levels = np.linspace(0, habit.height * 0.88, 8)
    sway = np.cumsum(rng.normal(0, 0.07, (8, 2)), axis=0) * np.minimum(levels / habit.trunk, 1)[:, None]
    trunk = np.column_stack([sway - sway[0], levels])
    girth = 0.02 + (0.10 + 0.008 * habit.height) * (1 - levels / habit.height)
    girth[0] *= 1.35
    parts = [tube(trunk, girth, 5 if coarse else 9, Material.BARK)]
    tips = [trunk[-1]]
    for k in range(habit.branches):
        z = habit.trunk + (habit.height * 0.8 - habit.trunk) * (k + 0.3 * rng.random()) / habit.branches
        angle = 2.4 * k + rng.normal(0, 0.3)
        level = (z - habit.trunk) / (habit.height - habit.trunk)
        reach = habit.spread * (1.05 - 0.75 * level**1.5) * rng.uniform(0.8, 1.0)
        foot = np.array([np.interp(z, levels, trunk[:, 0]), np.interp(z, levels, trunk[:, 1]), z])
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        branch = foot + np.outer([0, 0.35, 0.7, 1.0], out * reach)
        branch[:, 2] += np.array([0, 0.22, 0.5, 0.85]) * reach * rng.uniform(0.5, 0.8)
        thick = 0.05 + 0.05 * (1 - level)
        parts.append(tube(branch, thick * np.array([1, 0.75, 0.5, 0.25]), 3 if coarse else 5, Material.BARK))
        tips += [branch[2], branch[3]]
        for t in (0.35, 0.55, 0.75, 0.9):
            start = branch[0] + (branch[3] - branch[0]) * t
            start[2] = np.interp(t, [0, 0.35, 0.7, 1.0], branch[:, 2])
            bend = angle + rng.choice([-1, 1]) * rng.uniform(0.5, 1.2)
            length = reach * rng.uniform(0.3, 0.5)
            rise = rng.uniform(0.3, 0.8)
            twig = start + np.outer([0, 0.5, 1.0], np.array([np.cos(bend), np.sin(bend), rise]) * length)
            if not coarse:
                parts.append(tube(twig, thick * np.array([0.4, 0.28, 0.1]), 3, Material.BARK))
            tips += [twig[1], twig[2]]
    return join(parts), np.array(tips)


def _leaves(habit: _Habit, tips: Array, rng: np.random.Generator) -> Shape:
    """Sprays of leaves scattered around the twigs."""
    centre = tips[rng.integers(len(tips), size=habit.leaves)]
    centre = centre + rng.normal(0, 0.17 * habit.spread, centre.shape)
    centre[:, 2] = np.maximum(centre[:, 2], habit.trunk - 0.1)
    return leaf_quads(centre, habit.leaf, Material.LEAF, rng)


def leaf_quads(centre: Array, length: float, material: Material, rng: np.random.Generator) -> Shape:
    """A kite of ``length`` at each centre (N, 3), with random orientation and ranks spread evenly over (0, 1)."""
    count = len(centre)
    along = rng.normal(0, 1, (count, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    facing = rng.normal(0, 1, (count, 3)) + np.array([0, 0, 0.8])
    across = np.cross(facing, along)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    size = length * rng.uniform(0.7, 1.25, (count, 1))
    local = np.array([[-0.5, 0.0], [0.08, -0.32], [0.5, 0.0], [0.08, 0.32]])
    in_plane = local[None, :, :1] * along[:, None] + local[None, :, 1:] * across[:, None]
    corners = centre[:, None] + size[:, None] * in_plane
    uv = size[:, None] * local[None]
    rank = (rng.permutation(count) + 0.5) / count
    return quads(corners, material, uv, variant=rng.integers(0, 16, count), rank=rank)


def hedge_shapes(length: float, height: float, seed: int) -> tuple[Shape, Shape]:
    """Wood and leaves of a hedge along +x from the origin, 0.7 m deep around the x axis."""
    rng = np.random.default_rng([104729, seed])
    columns = max(3, int(length / 0.6) + 1)
    x = np.linspace(0, length, columns)
    section = np.array([[-0.3, 0.0], [-0.33, 0.5], [-0.28, 0.95], [0.28, 0.95], [0.33, 0.5], [0.3, 0.0]])
    ring = np.tile(section, (columns, 1, 1)) * np.array([1.0, height])
    ring[:, 1:5] += rng.normal(0, 0.025, (columns, 4, 2))
    vertices = np.concatenate([np.broadcast_to(x[:, None, None], (columns, 6, 1)), ring], axis=2).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(columns - 1), np.arange(6), indexing="ij")
    a, b = i * 6 + j, i * 6 + (j + 1) % 6
    rows = np.stack([np.stack([a, a + 6, b + 6], -1), np.stack([a, b + 6, b], -1)], axis=2).reshape(-1, 3)
    fan = np.array([[0, k, k + 1] for k in range(1, 5)])
    core = triangle_shape(vertices, np.concatenate([rows, fan, fan[:, ::-1] + (columns - 1) * 6]), Material.HEDGE)
    count = int(55 * length * height)
    side = rng.integers(0, 3, count)
    y = np.where(side == 1, rng.uniform(-0.33, 0.33, count), np.where(side == 0, -0.34, 0.34))
    z = np.where(side == 1, 0.98, rng.uniform(0.05, 0.98, count)) * height
    centre = np.stack([rng.uniform(0, length, count), y, z], axis=1) + rng.normal(0, 0.03, (count, 3))
    return core, leaf_quads(centre, 0.16, Material.HEDGE, rng)
