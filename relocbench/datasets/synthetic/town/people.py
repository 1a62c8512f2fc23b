"""People on foot and on bicycles, made of a few tubes, in the postures of walking, standing and riding.

The figure is at the origin, faces +x and has y on its left. Where a walker is in the stride follows from the place, so
that one who moves on takes steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Indices
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic, merge
from relocbench.datasets.synthetic.town.shapes import Shape, boxes, instances, join, poses, tube

_THIGH_M, _SHIN_M, _UPPER_ARM_M, _FOREARM_M = 0.43, 0.42, 0.29, 0.27
_ANKLE_M = 0.07
"""height of an ankle above the sole"""
_STRIDE_M = 1.45
"""length of two steps"""
_PHASES = 8
_PEDALS_M = 5.2
"""way of a bicycle in one turn of its pedals"""
_CHILDREN = 0.1
"""share of the figures on foot that are children"""


@dataclass(frozen=True)
class _Build:
    """What differs between figures, in metres."""

    shoulders: float
    hips: float
    belly: float
    """radius of the waist"""
    hem: float
    """height of the coat's or skirt's lower edge"""
    flare: float
    """radius of the hem"""
    legs: Material
    long_hair: bool
    bag: str
    """none, rucksack, or a bag in the hand"""


_BUILDS = (
    _Build(0.215, 0.165, 0.17, 0.84, 0.17, Material.TROUSERS, False, "none"),
    _Build(0.185, 0.170, 0.145, 0.84, 0.175, Material.TROUSERS, True, "bag"),
    _Build(0.205, 0.165, 0.17, 0.52, 0.22, Material.TROUSERS, False, "none"),
    _Build(0.180, 0.165, 0.14, 0.50, 0.26, Material.SKIN, True, "none"),
    _Build(0.220, 0.180, 0.20, 0.80, 0.19, Material.TROUSERS, False, "bag"),
    _Build(0.195, 0.160, 0.155, 0.84, 0.165, Material.TROUSERS, False, "rucksack"),
    _Build(0.185, 0.175, 0.16, 0.62, 0.21, Material.TROUSERS, True, "rucksack"),
)


@dataclass(frozen=True)
class _Posture:
    """Angles in radians from hanging down, positive forward, left side first; elbows and knees bend further."""

    thighs: tuple[float, float]
    knees: tuple[float, float]
    arms: tuple[float, float]
    elbows: tuple[float, float]
    lean: float = 0.0
    """of the trunk, forward"""
    hip: Array | None = None
    """position of the hips; by default so that the lower foot is on the ground"""
    umbrella: bool = False
    """above the right hand"""


def _walking(phase: int, umbrella: bool) -> _Posture:
    turn = 2 * np.pi * phase / _PHASES + np.array([0.0, np.pi])
    swing, forward = np.sin(turn), np.maximum(np.cos(turn), 0.0)
    a, b = (0.46 * swing).tolist(), (0.10 + 0.80 * forward).tolist()
    if umbrella:
        return _Posture((a[0], a[1]), (b[0], b[1]), (-0.9 * a[0], 0.35), (0.3, 1.7), 0.04, umbrella=True)
    return _Posture((a[0], a[1]), (b[0], b[1]), (-0.9 * a[0], -0.9 * a[1]), (0.3, 0.3), 0.04)


def _standing(way: int) -> _Posture:
    """With hanging arms, with one hand at the face or before the chest, or with weight on one leg."""
    elbows = ((0.15, 0.15), (0.2, 2.2), (1.6, 1.5), (0.2, 0.3))[way]
    arms = ((0.05, 0.0), (0.0, 0.5), (0.25, 0.2), (-0.1, 0.1))[way]
    return _Posture((0.02, 0.10 if way % 2 else 0.0), (0.03, 0.2 if way % 2 else 0.03), arms, elbows)


_STANDING_WAYS = 4


def _limb(start: Array, lengths: tuple[float, float], first: float, bend: float, aside: float) -> Array:
    """Three joints (3, 3) of a limb that hangs from ``start``, turned by ``first``, then further by ``bend``."""
    angles = np.array([first, first + bend])
    steps = np.stack([np.sin(angles), np.full(2, aside), -np.cos(angles)], axis=1) * np.array(lengths)[:, None]
    return np.concatenate([start[None], start + np.cumsum(steps, axis=0)])


def _leaned(shape: Shape, hip: Array, lean: float) -> Shape:
    """A shape about upright hips at the origin, leaned forward and moved to the hips."""
    c, s = np.cos(lean), np.sin(lean)
    return replace(shape, vertices=shape.vertices @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + hip)


def _flat(shape: Shape, depth: float) -> Shape:
    """A shape whose extent along x is scaled."""
    return replace(shape, vertices=shape.vertices * np.array([depth, 1, 1]))


def _up(heights: Sequence[float], x: float = 0.0) -> Array:
    return np.column_stack([np.full(len(heights), x), np.zeros(len(heights)), heights])


def _trunk(build: _Build, hem: float) -> list[Shape]:
    """Coat, neck, head and hair above hips at the origin."""
    at = [hem, 0.02, 0.16, 0.38, 0.50, 0.555]
    girth = [build.flare, build.hips, build.belly, build.shoulders * 0.93, build.shoulders * 0.86, 0.07]
    if hem > -0.1:
        girth[0] = build.hips
    coat = _flat(tube(_up(at), girth, 8, Material.CLOTH), 0.62)
    head = _flat(
        tube(_up([0.50, 0.60, 0.64, 0.72, 0.80], 0.02), [0.055, 0.06, 0.078, 0.09, 0.075], 8, Material.SKIN), 1.1
    )
    back = 0.62 if not build.long_hair else 0.50
    hair = _flat(tube(_up([back, 0.70, 0.79, 0.845], -0.025), [0.07, 0.098, 0.088, 0.03], 8, Material.HAIR), 1.05)
    parts = [coat, head, hair]
    if build.bag == "rucksack":
        parts.append(boxes([-0.27, -0.14, 0.12], [-0.09, 0.14, 0.5], Material.CLOTH, variant=0x3D))
    return parts


def _figure(build: _Build, posture: _Posture) -> Shape:
    """A person of 1.75 m."""
    legs = []
    for k, side in enumerate((1, -1)):
        thigh, knee = posture.thighs[k], posture.knees[k]
        legs.append(_limb(np.array([0.0, 0.088 * side, 0.0]), (_THIGH_M, _SHIN_M), thigh, -knee, 0.0))
    low = min(leg[2, 2] for leg in legs)
    hip = np.array([0.0, 0.0, _ANKLE_M - low]) if posture.hip is None else posture.hip
    seated = posture.hip is not None
    parts = [_leaned(part, hip, posture.lean) for part in _trunk(build, -0.06 if seated else build.hem - 0.91)]
    for leg in legs:
        ankle = leg[2] + hip
        parts.append(tube(leg + hip, [0.088, 0.06, 0.046], 6, build.legs))
        sole = np.array([[-0.07, 0, -0.02], [0.06, 0, -0.015], [0.17, 0, -0.04]])
        parts.append(tube(ankle + sole, [0.045, 0.048, 0.028], 5, Material.RUBBER))
    c, s = np.cos(posture.lean), np.sin(posture.lean)
    for k, side in enumerate((1, -1)):
        shoulder = hip + np.array([0.47 * s, side * (build.shoulders - 0.015), 0.47 * c])
        arm = _limb(shoulder, (_UPPER_ARM_M, _FOREARM_M), posture.arms[k], posture.elbows[k], 0.08 * side)
        parts.append(tube(arm, [0.058, 0.047, 0.038], 5, Material.CLOTH))
        reach = (arm[2] - arm[1]) / _FOREARM_M
        parts.append(tube(np.stack([arm[2], arm[2] + 0.1 * reach]), [0.036, 0.028], 5, Material.SKIN))
        if build.bag == "bag" and side > 0 and not seated:
            x, y, z = arm[2]
            parts.append(
                boxes([x - 0.17, y - 0.05, z - 0.42], [x + 0.17, y + 0.05, z - 0.12], Material.CLOTH, variant=0x71)
            )
        if posture.umbrella and side < 0:
            parts += _umbrella(arm[2] + 0.05 * reach)
    return join(parts)


def _umbrella(hand: Array) -> list[Shape]:
    up = np.array([[-0.05, 0.08, z] for z in (0.0, 0.62, 0.64, 0.79, 0.86)])
    stick = tube(hand + up[[0, 3]], 0.012, 4, Material.METAL)
    cloth = tube(hand + up[1:], [0.52, 0.51, 0.3, 0.02], 8, Material.CLOTH)
    return [stick, replace(cloth, variant=cloth.variant ^ np.uint32(0x2B))]


@cache
def walker(build: int, way: int) -> Shape:
    """A person of a build (0 to ``BUILDS`` - 1) in one of the phases of a stride; from ``_PHASES`` on with umbrella."""
    return _figure(_BUILDS[build], _walking(way % _PHASES, way >= _PHASES))


@cache
def stander(build: int, way: int) -> Shape:
    """A person of a build who stands in one of some ways."""
    return _figure(_BUILDS[build], _standing(way))


BUILDS = len(_BUILDS)
_WHEEL_M, _AXLES = 0.34, (-0.5, 0.55)
_CRANK = np.array([-0.06, 0.0, 0.29])
_SADDLE = np.array([-0.2, 0.0, 0.96])
_BAR = np.array([0.36, 0.0, 1.05])


def _wheel(x: float) -> Shape:
    """A tyre and a hub; spokes are too thin to be seen."""
    turn = np.linspace(0, 2 * np.pi, 15)
    ring = np.stack([x + _WHEEL_M * np.cos(turn), np.zeros(15), _WHEEL_M * (1 + np.sin(turn))], axis=1)
    return tube(ring, 0.022, 4, Material.RUBBER)


def _bicycle() -> list[Shape]:
    rear, front = (np.array([x, 0.0, _WHEEL_M]) for x in _AXLES)
    head = np.array([0.4, 0.0, 0.85])
    seat = _SADDLE - np.array([0.0, 0.0, 0.08])
    frame = [(rear, _CRANK), (rear, seat), (_CRANK, seat), (_CRANK, head), (seat, head), (front, head), (head, _BAR)]
    bar = np.array([[0.3, -0.27, 1.03], [0.36, -0.2, 1.05], [0.36, 0.2, 1.05], [0.3, 0.27, 1.03]])
    saddle = boxes(_SADDLE - np.array([0.14, 0.07, 0.06]), _SADDLE + np.array([0.12, 0.07, 0.0]), Material.RUBBER)
    lamp = boxes([0.42, -0.04, 0.88], [0.48, 0.04, 0.97], Material.LAMP)
    return [
        *(_wheel(x) for x in _AXLES),
        *(tube(np.stack(ends), 0.02, 4, Material.CONTAINER) for ends in frame),
        tube(bar, 0.014, 4, Material.METAL),
        saddle,
        lamp,
    ]


def _to(start: Array, end: Array) -> tuple[float, float]:
    """Angle of the thigh and bend of the knee for which a leg from the hip reaches an ankle."""
    way = end - start
    reach = min(float(np.hypot(way[0], way[2])), _THIGH_M + _SHIN_M - 1e-3)
    knee = np.pi - np.arccos((_THIGH_M**2 + _SHIN_M**2 - reach**2) / (2 * _THIGH_M * _SHIN_M))
    inner = np.arccos((_THIGH_M**2 + reach**2 - _SHIN_M**2) / (2 * _THIGH_M * reach))
    return float(np.arctan2(way[0], -way[2]) + inner), float(knee)


@cache
def rider(build: int, phase: int) -> Shape:
    """A person on a bicycle, with pedals in one of their phases."""
    hip = _SADDLE + np.array([0.02, 0.0, 0.07])
    turn = 2 * np.pi * phase / _PHASES
    legs = [
        _to(hip, _CRANK + 0.17 * way * np.array([np.sin(turn), 0, np.cos(turn)]) + np.array([-0.03, 0, 0.07]))
        for way in (1, -1)
    ]
    thighs, knees = (legs[0][0], legs[1][0]), (legs[0][1], legs[1][1])
    sitting = _Posture(thighs, knees, (0.95, 0.95), (0.25, 0.25), 0.42, hip)
    build = {2: 0, 3: 1}.get(build, build)  # nobody rides in a long coat or a skirt
    return join([_figure(_BUILDS[build], sitting), *_bicycle()])


def _in_groups(
    shape_of: Callable[[int, int], Shape],
    transforms: Array,
    variant: ArrayLike,
    instance: ArrayLike,
    semantic: Semantic,
    way: Indices,
) -> Mesh:
    """Figures (N,) of the builds that their variants choose, in their ways (N,)."""
    looks, names = np.asarray(variant, dtype=np.int64), np.asarray(instance, dtype=np.int64)
    build = looks % BUILDS
    groups = []
    for b, w in sorted(set(zip(build.tolist(), way.tolist(), strict=True))):
        where = np.flatnonzero((build == b) & (way == w))
        groups.append(instances(shape_of(b, w), transforms[where], names[where], looks[where], semantic))
    return merge(groups)


def _phase(transforms: Array, length_m: float) -> Indices:
    """Phase (N,) of who has come to these poses (N, 4, 4) straight on, by cycles of a length."""
    along = (transforms[:, :2, 3] * transforms[:, :2, 0]).sum(axis=1)
    return np.asarray(np.floor(along / length_m * _PHASES).astype(np.int64) % _PHASES)


def _grown(transforms: Array, variant: ArrayLike) -> Array:
    """The poses with the sizes of the figures: 1.6 to 1.87 m, and some children of 1.1 to 1.35 m."""
    size = (np.asarray(variant, dtype=np.int64) // 64 % 1024) / 1024
    child = size < _CHILDREN
    scale = np.where(child, 0.63 + 1.4 * size, 0.91 + 0.16 * size)
    return transforms @ poses(0.0, 0.0, 0.0, 0.0, scale)


def walkers(
    transforms: Array, variant: ArrayLike, instance: ArrayLike, semantic: Semantic, umbrella: bool = False
) -> Mesh:
    """People who walk, with poses (N, 4, 4); the variant (N,) chooses build, size and clothes."""
    way = _phase(transforms, _STRIDE_M) + _PHASES * umbrella
    return _in_groups(walker, _grown(transforms, variant), variant, instance, semantic, way)


def standers(transforms: Array, variant: ArrayLike, instance: ArrayLike, semantic: Semantic) -> Mesh:
    """People who stand, as in :func:`walkers`."""
    way = np.asarray(variant, dtype=np.int64) // 8 % _STANDING_WAYS
    return _in_groups(stander, _grown(transforms, variant), variant, instance, semantic, way)


def riders(transforms: Array, variant: ArrayLike, instance: ArrayLike, semantic: Semantic) -> Mesh:
    """People on bicycles, as in :func:`walkers`."""
    return _in_groups(rider, transforms, variant, instance, semantic, _phase(transforms, _PEDALS_M))
