"""Trees with branches of three orders and individual leaves in clumps, evergreens, and hedges."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.datasets.synthetic.town.shapes import Shape, join, skin, triangle_shape, tube

LOOK_STEP = 1 << 9
"""variants of plants are multiples of this: what lies below is the place of a leaf; see :func:`place_of`"""
_SHADES = 4


@dataclass(frozen=True)
class _Habit:
    """Dimensions of a kind of tree, in metres."""

    trunk: float
    """height of the lowest branches"""
    height: float
    spread: float
    """radius of the crown"""
    branches: int
    leaf: float
    """length of a leaf"""
    rise: float
    """slope of the branches where they begin, rise over run"""
    evergreen: bool = False


_HABITS = (
    _Habit(2.8, 8.6, 2.6, 9, 0.25, 0.9),
    _Habit(3.0, 10.5, 3.1, 10, 0.27, 0.7),
    _Habit(2.6, 7.0, 2.3, 8, 0.22, 0.6),
    _Habit(2.2, 12.0, 1.7, 14, 0.24, 2.2),
    _Habit(3.2, 9.5, 3.5, 9, 0.28, 0.45),
    _Habit(1.8, 5.4, 2.0, 7, 0.2, 0.8),
    _Habit(1.2, 11.0, 2.4, 20, 0.26, -0.25, evergreen=True),
)
TREE_TYPES = len(_HABITS)
STREET_TYPES = 6
"""the first of them are planted along streets"""


def crown(kind: int) -> tuple[float, float, float]:
    """Height of the lowest branches, of the top, and radius of the crown of one of TREE_TYPES, in metres."""
    habit = _HABITS[kind]
    return habit.trunk, habit.height, habit.spread


def evergreen(kind: int) -> bool:
    """Whether one of TREE_TYPES keeps its leaves in winter."""
    return _HABITS[kind].evergreen


@cache
def tree_shapes(kind: int, coarse: bool = False) -> tuple[Shape, Shape]:
    """Wood and leaves of one of TREE_TYPES; z up, origin at the base of the trunk.

    The coarse version, for trees far from any street, has fewer but larger leaves and fewer twigs.
    """
    habit = _HABITS[kind]
    rng = np.random.default_rng([7919, kind])
    wood, clumps = _wood(habit, rng, coarse)
    return wood, _leaves(habit, clumps, rng, coarse)


def _wood(habit: _Habit, rng: np.random.Generator, coarse: bool) -> tuple[Shape, Array]:
    """Trunk, branches, side branches and twigs, and the points (P, 3) around which leaves grow."""
    levels = np.linspace(0, habit.height * 0.9, 8)
    sway = np.cumsum(rng.normal(0, 0.09, (8, 2)), axis=0) * np.minimum(levels / habit.trunk, 1)[:, None]
    if habit.evergreen:
        sway *= 0.2
    trunk = np.column_stack([sway - sway[0], levels])
    girth = 0.02 + (0.09 + 0.009 * habit.height) * (1 - levels / habit.height)
    girth[0] *= 1.4
    parts = [tube(trunk, girth, 4 if coarse else 8, Material.BARK)]
    feet, tips, thick, clumps = [], [], [], [trunk[-1]]
    for k in range(habit.branches):
        z = habit.trunk + (habit.height * 0.85 - habit.trunk) * (k + 0.4 * rng.random()) / habit.branches
        angle = 2.4 * k + rng.normal(0, 0.35)
        level = (z - habit.trunk) / (habit.height - habit.trunk)
        taper = 1.0 - 0.93 * level if habit.evergreen else 1.0 - 0.68 * level**1.5
        reach = habit.spread * taper * rng.uniform(0.72, 1.05)
        foot = np.array([np.interp(z, levels, trunk[:, 0]), np.interp(z, levels, trunk[:, 1]), z])
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        branch = foot + np.outer([0, 0.3, 0.65, 1.0], out * reach)
        climb = np.array([0, 0.42, 0.8, 1.05]) * rng.uniform(0.75, 1.2)
        branch[:, 2] += climb * reach * habit.rise * (1 if habit.rise < 0 else (0.5 + 0.7 * level))
        branch[1:3] += rng.normal(0, 0.05 * reach, (2, 3))
        base = 0.028 + 0.016 * reach * (1 - 0.4 * level)
        parts.append(tube(branch, base * np.array([1, 0.75, 0.5, 0.2]), 3 if coarse else 5, Material.BARK))
        clumps.append(branch[3])
        for t in np.linspace(0.28, 0.97, 4 if coarse else 6) + rng.normal(0, 0.03):
            start = np.array([np.interp(t, [0, 0.3, 0.65, 1.0], branch[:, i]) for i in range(3)])
            bend = angle + rng.choice([-1, 1]) * rng.uniform(0.4, 1.3)
            length = habit.spread * rng.uniform(0.2, 0.42) * (1.15 - 0.5 * t) * (taper if habit.evergreen else 1.0)
            up = rng.uniform(-0.35, 0.1) if habit.evergreen else rng.uniform(0.1, 1.1)
            feet.append(start)
            tips.append(start + np.array([np.cos(bend), np.sin(bend), up]) * length)
            thick.append(base * (0.5 - 0.3 * t))
    side = np.array(feet), np.array(tips)
    parts.append(spikes(*side, np.array(thick)))
    clumps += [*(0.45 * side[0] + 0.55 * side[1]), *side[1]]
    if not coarse:
        parts.append(_twigs(side, rng))
    return join(parts), np.array(clumps)


def _twigs(side: tuple[Array, Array], rng: np.random.Generator) -> Shape:
    """Four twigs on each of the side branches from (N, 3) to (N, 3), the last one at its end."""
    foot, tip = side
    along = tip - foot
    length = np.linalg.norm(along, axis=1)
    starts, ends = [], []
    for t in (0.35, 0.6, 0.85, 0.98):
        start = foot + t * along
        turned = along / length[:, None] + rng.normal(0, 0.65, along.shape) + np.array([0, 0, 0.35])
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        starts.append(start)
        ends.append(start + turned * (length * rng.uniform(0.4, 0.75, len(length)))[:, None])
    return blades(np.concatenate(starts), np.concatenate(ends), 0.014)


def blades(feet: Array, tips: Array, radius: float) -> Shape:
    """Flat triangles from (N, 3) to (N, 3), each turned otherwise about its axis: twigs, too thin for more."""
    side, other = _across(tips - feet)
    angle = 2.4 * np.arange(len(feet))[:, None]
    out = radius * (np.cos(angle) * side + np.sin(angle) * other)
    corners = np.stack([feet - out, feet + out, tips], axis=1)
    return triangle_shape(corners.reshape(-1, 3), np.arange(3 * len(feet)).reshape(-1, 3), Material.BARK)


def _across(along: Array) -> tuple[Array, Array]:
    """Two unit vectors (N, 3) at right angles to vectors (N, 3) and to each other."""
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    start = np.where(np.abs(along[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    side = np.cross(along, start)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return side, np.cross(along, side)


def spikes(feet: Array, tips: Array, radius: Array) -> Shape:
    """Closed three-sided spikes of wood from (N, 3) to (N, 3), with radii (N,) at their feet."""
    length = np.linalg.norm(tips - feet, axis=1, keepdims=True)
    side, other = _across(tips - feet)
    ring = [feet + radius[:, None] * (np.cos(a) * side + np.sin(a) * other) for a in 2 * np.pi * np.arange(3) / 3]
    corners = np.stack([*ring, tips], axis=1)
    rows = 4 * np.arange(len(feet))[:, None, None] + np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3], [0, 2, 1]])
    width = 2 * radius
    zero = np.zeros_like(width)
    low = np.stack([zero, width, width / 2], axis=1)
    high = np.stack([zero, zero, length[:, 0]], axis=1)
    uv = np.repeat(np.stack([low, high], axis=-1)[:, None], 4, axis=1)
    uv[:, 3, 2, 1] = width
    return triangle_shape(corners.reshape(-1, 3), rows.reshape(-1, 3), Material.BARK, uv.reshape(-1, 3, 2))


def _leaves(habit: _Habit, clumps: Array, rng: np.random.Generator, coarse: bool) -> Shape:
    """Leaves scattered around the side branches, darker where they are deep in the crown."""
    each, length = (5, 2.45 * habit.leaf) if coarse else (17, 1.25 * habit.leaf)
    chosen = np.repeat(np.arange(len(clumps)), each)
    size = np.maximum(0.085 * habit.spread, 0.16) * rng.uniform(0.8, 1.6, (len(clumps), 1))
    scattered = rng.normal(0, 1, (len(chosen), 3)).clip(-1.8, 1.8)
    centre = clumps[chosen] + (size * np.array([1.15, 1.15, 0.8]))[chosen] * scattered
    centre[:, 2] = np.maximum(centre[:, 2], habit.trunk - 0.1)
    middle = np.array([0, 0, 0.45 * habit.trunk + 0.5 * habit.height])
    extent = np.array([habit.spread, habit.spread, (habit.height - habit.trunk) / 2])
    outward = (centre - middle) / extent
    depth = 1.05 - np.linalg.norm(outward, axis=1) - 0.25 * outward[:, 2]
    shade = np.clip(depth * _SHADES, 0, _SHADES - 1).astype(int)
    material = Material.HEDGE if habit.evergreen else Material.LEAF
    return leaf_triangles(centre, length, material, rng, outward, chosen, shade)


@cache
def distant_tree(kind: int, needles: bool) -> tuple[Shape, Shape]:
    """Wood and leaves of a tree that is hundreds of metres away: 14 branches and 56 clumps of leaves."""
    rng = np.random.default_rng([7927, kind, needles])
    height, spread = 9.0 + 2.5 * kind, 3.4 + 0.5 * kind
    d = rng.normal(0, 1, (56, 3))
    d *= (rng.uniform(0.55, 1.0, 56) / np.linalg.norm(d, axis=1))[:, None]
    level = (d[:, 2] + 1) / 2
    width = spread * (1.15 * (1 - level) + 0.1 if needles else np.ones(56))
    centre = np.stack([d[:, 0] * width, d[:, 1] * width, 0.2 * height + 0.8 * height * level], axis=1)
    shade = ((1 - level) * (_SHADES - 1)).astype(int)
    material = Material.HEDGE if needles else Material.LEAF
    leaves = leaf_triangles(centre, 2.9, material, rng, d, np.arange(56), shade)
    foot = np.column_stack([np.zeros((14, 2)), height * np.linspace(0.15, 0.7, 14)])
    trunk = np.array([[0.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 0.9 * height]])
    wood = [spikes(*trunk, np.array([0.3])), spikes(foot, centre[:14] + np.array([0.0, 0.0, 0.5]), np.full(14, 0.12))]
    return join(wood), leaves


def place_of(clump: Indices, shade: Indices, rng: np.random.Generator) -> Indices:
    """Variants (N,) of leaves below LOOK_STEP: five bits for the clump, two for the leaf, two for how deep it is."""
    return np.asarray((clump % 32) * 16 + rng.integers(0, 4, len(clump)) * 4 + shade)


def leaf_triangles(
    centre: Array,
    length: float,
    material: Material,
    rng: np.random.Generator,
    outward: Array,
    clump: Indices,
    shade: Indices,
) -> Shape:
    """A leaf of ``length`` at each centre (N, 3), which tends to face ``outward`` (N, 3) and up.

    Ranks are spread evenly over (0, 1). ``clump`` and ``shade`` (N,) go into the variant; see :func:`place_of`.
    """
    count = len(centre)
    along = rng.normal(0, 1, (count, 3)) + np.array([0, 0, -0.3])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    facing = rng.normal(0, 0.8, (count, 3)) + outward + np.array([0, 0, 0.6])
    across = np.cross(facing, along)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    size = length * rng.uniform(0.7, 1.3, (count, 1))
    local = np.array([[0.55, 0.0], [-0.45, 0.33], [-0.3, -0.4]])
    corners = centre[:, None] + size[:, None] * (
        local[None, :, :1] * along[:, None] + local[None, :, 1:] * across[:, None]
    )
    uv = size[:, None] * local[None]
    rank = (rng.permutation(count) + 0.5) / count
    rows = np.arange(3 * count).reshape(-1, 3)
    return triangle_shape(corners.reshape(-1, 3), rows, material, uv, place_of(clump, shade, rng), rank)


def hedge_shapes(length: float, height: float, seed: int) -> tuple[Shape, Shape]:
    """Wood and leaves of a hedge along +x from the origin, 0.7 m deep around the x axis."""
    rng = np.random.default_rng([104729, seed])
    columns = max(3, int(length / 0.6) + 1)
    x = np.linspace(0, length, columns)
    section = np.array([[-0.3, 0.0], [-0.33, 0.5], [-0.28, 0.95], [0.28, 0.95], [0.33, 0.5], [0.3, 0.0]])
    ring = np.tile(section, (columns, 1, 1)) * np.array([1.0, height])
    ring[:, 1:5] += rng.normal(0, 0.035, (columns, 4, 2))
    core = triangle_shape(*skin(x, ring), Material.HEDGE, variant=_SHADES - 1)
    count = int(92 * length * height)
    side = rng.integers(0, 3, count)
    y = np.where(side == 1, rng.uniform(-0.33, 0.33, count), np.where(side == 0, -0.34, 0.34))
    z = np.where(side == 1, 0.98, rng.uniform(0.03, 0.98, count)) * height
    along = rng.uniform(0, length, count)
    centre = np.stack([along, y, z], axis=1) + rng.normal(0, 0.04, (count, 3))
    outward = np.stack([np.zeros(count), np.sign(y) * (side != 1), 1.0 * (side == 1)], axis=1)
    clump = (along / 0.5).astype(int) * 3 + side
    low = np.clip(2.2 * (1 - z / height), 0, 2).astype(int)
    return core, leaf_triangles(centre, 0.153, Material.HEDGE, rng, outward, clump, low)
