"""Tileable surface patterns as mip pyramids, and their filtering over a pixel's footprint.

A pattern has two channels: the share of the material's second colour (mortar, dirt, grain), and brightness.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Floats
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.kernels import njit

SIZE = 256
"""texels along a side of the finest level"""
LEVELS = 9
LAYER = (4 * SIZE * SIZE - 1) // 3
"""number of texels in all levels of a layer"""
MACRO = len(Material)
"""the layer of low-frequency noise with uniform distribution, for stains, puddles and snow drifts"""
MACRO_TILE_M = 29.0
UNIT_BRIGHTNESS = 128.0
_POSITIVE = 2.0**40
_BLENDS = 16
"""blending steps between two levels; eight probes times these still fit into the bits of a channel"""
_PARTS = np.array([0, *(1 / k for k in range(1, 9))])


class Patterns(NamedTuple):
    """All layers: one for each material, then :data:`MACRO`."""

    texels: NDArray[np.uint64]
    """layer by layer, and in each layer level by level; a texel is second + 2^32 brightness"""
    per_tile: Floats
    """(layer,) tiles per metre; each pattern has its own period"""

    def second(self, layer: int) -> Floats:
        """The first channel (SIZE, SIZE) of a layer's finest level, in [0, 1]."""
        finest = self.texels[layer * LAYER : layer * LAYER + SIZE * SIZE].reshape(SIZE, SIZE)
        return (finest & 0xFF).astype(np.float32) / np.float32(255)


def _noise(rng: np.random.Generator, cells: int, octaves: int, gain: float = 0.5, stretch: int = 1) -> Floats:
    """Tileable value noise (SIZE, SIZE) with zero mean and unit deviation; ``stretch`` elongates it along v."""
    total = np.zeros((SIZE, SIZE))
    for k in range(octaves):
        n = min(cells * 2**k, SIZE)
        m = max(1, n // stretch)
        total += gain**k * _enlarge(_enlarge(rng.standard_normal((m, n)), 0), 1)
    return np.asarray((total - total.mean()) / total.std(), dtype=np.float32)


def _enlarge(values: Array, axis: int) -> Array:
    """Periodic smooth interpolation to SIZE along an axis."""
    n = values.shape[axis]
    x = np.arange(SIZE) * n / SIZE
    i = np.floor(x).astype(int)
    t = x - i
    t = t * t * (3 - 2 * t)
    shape = [1, 1]
    shape[axis] = SIZE
    t = t.reshape(shape)
    out: Array = values.take(i % n, axis) * (1 - t) + values.take((i + 1) % n, axis) * t
    return out


def _bricks(
    rng: np.random.Generator, columns: int, rows: int, joint: float, shift: float = 0.5
) -> tuple[Floats, Floats]:
    """Running bond of bricks: mask of the joints, ``joint`` texels wide, and a random brightness of each brick."""
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float32)
    row = np.floor(y * rows / SIZE).astype(int)
    along = (x * columns / SIZE + shift * (row % 2)) % columns
    width, height = SIZE / columns, SIZE / rows
    to_side = np.minimum(along % 1, 1 - along % 1) * width
    below = (y * rows / SIZE) % 1
    to_bed = np.minimum(below, 1 - below) * height
    joints = np.clip(joint + 0.5 - np.minimum(to_side, to_bed), 0, 1)
    tone = rng.standard_normal((rows, columns))[row, np.floor(along).astype(int) % columns]
    return joints.astype(np.float32), tone.astype(np.float32)


def _pattern(material: Material, rng: np.random.Generator) -> tuple[Floats, Floats, float]:
    """Share of the second colour, brightness (about 1 on average) and metres per tile."""
    fine, coarse = _noise(rng, 64, 3), _noise(rng, 6, 5, 0.6)
    none = np.zeros((SIZE, SIZE), dtype=np.float32)
    match material:
        case Material.ASPHALT:
            y, x = np.mgrid[:SIZE, :SIZE] / SIZE
            wander = 0.12 * np.sin(2 * np.pi * x) + 0.02 * _noise(rng, 12, 3)
            crack = np.clip(1 - np.abs(y - 0.5 - wander) / 0.004, 0, 1) * (_noise(rng, 3, 1) > 0.6)
            # Stones of one to three centimetres in bitumen, some of them light, with dark gaps in between.
            stones, grit = _noise(rng, 128, 1), _noise(rng, 256, 1)
            light = np.clip(grit - 1.3, 0, 1)
            second = np.clip(0.35 + 0.12 * coarse + 0.3 * np.clip(-stones - 0.6, 0, 1) + 0.7 * crack, 0, 1)
            return second, 1 + 0.10 * stones + 0.09 * grit + 0.3 * light + 0.05 * coarse - 0.25 * crack, 4.1
        case Material.COBBLES:
            joints, tone = _bricks(rng, 16, 16, 2.2)
            return joints, 1 + 0.16 * tone + 0.07 * fine - 0.25 * joints, 2.0
        case Material.PAVEMENT:
            joints, tone = _bricks(rng, 5, 5, 0.9)
            return np.clip(joints + 0.15 * coarse, 0, 1), 1 + 0.09 * tone + 0.05 * fine + 0.04 * coarse, 2.5
        case Material.KERB:
            joints, tone = _bricks(rng, 3, 1, 0.8)
            joints[:4] = joints[-4:] = 0
            return joints, 1 + 0.05 * tone + 0.06 * fine, 3.0
        case Material.LANE_MARKING:
            return np.clip(coarse - 0.9, 0, 1) * 0.7, 1 + 0.05 * fine, 2.0
        case Material.GRASS | Material.HEDGE | Material.LEAF:
            return np.clip(0.4 + 0.35 * coarse, 0, 1), 1 + 0.22 * fine + 0.12 * coarse, 1.7
        case Material.SOIL:
            return np.clip(0.4 + 0.3 * coarse, 0, 1), 1 + 0.2 * fine + 0.1 * coarse, 2.3
        case Material.BRICK:
            joints, tone = _bricks(rng, 8, 24, 0.9)
            return joints, 1 + 0.13 * tone + 0.05 * fine, 2.0
        case Material.STONE:
            joints, tone = _bricks(rng, 4, 8, 0.9)
            return joints * 0.8, 1 + 0.09 * tone + 0.05 * fine + 0.04 * coarse, 2.8
        case Material.PLASTER:
            streaks = _noise(rng, 24, 2, stretch=12)
            return np.clip(0.15 * coarse + 0.12 * streaks, 0, 1), 1 + 0.05 * coarse + 0.03 * fine, 3.7
        case Material.CONCRETE:
            joints, tone = _bricks(rng, 2, 2, 0.8, 0.0)
            streaks = _noise(rng, 16, 3, stretch=8)
            return np.clip(0.25 * streaks + joints, 0, 1), 1 + 0.05 * tone + 0.06 * coarse, 4.8
        case Material.ROOF_TILES:
            y = np.mgrid[:SIZE, :SIZE][0] / SIZE
            joints, tone = _bricks(rng, 10, 8, 1.0)
            return joints, 0.85 + 0.3 * ((y * 8) % 1) + 0.12 * tone + 0.05 * coarse, 2.4
        case Material.WINDOW | Material.SHOP_WINDOW | Material.CAR_GLASS:
            return np.clip(0.5 + 0.5 * coarse, 0, 1), 1 + 0.12 * coarse, 2.9
        case Material.WOOD | Material.DOOR:
            joints, tone = _bricks(rng, 8, 1, 0.8, 0.0)
            grain = _noise(rng, 64, 2, stretch=16)
            return np.clip(joints + 0.2 * grain, 0, 1), 1 + 0.06 * tone + 0.07 * grain, 1.0
        case Material.BARK:
            ridges = _noise(rng, 32, 3, stretch=6)
            return np.clip(0.4 + 0.4 * ridges, 0, 1), 1 + 0.18 * ridges, 0.9
        case Material.SHOP_SIGN | Material.TRAFFIC_SIGN:
            marks = (_noise(rng, 16, 1) > 0.35) & (np.abs(np.mgrid[:SIZE, :SIZE][0] / SIZE - 0.5) < 0.3)
            return marks.astype(np.float32), 1 + 0.02 * fine, 1.3
        case Material.METAL | Material.RUBBER | Material.PLASTIC | Material.ROOF_FLAT:
            return np.clip(0.25 * coarse - 0.1, 0, 1), 1 + 0.05 * coarse + 0.03 * fine, 2.1
        case _:
            return none, np.ones_like(none), 2.0


@lru_cache(maxsize=2)
def bake(seed: int) -> Patterns:
    """Make the patterns of all materials; the same seed gives the same bytes."""
    layers, tiles = [], []
    for layer in range(MACRO + 1):
        rng = np.random.default_rng([seed, 21, layer])
        if layer == MACRO:
            slow = _noise(rng, 5, 6, 0.55)
            rank = np.argsort(np.argsort(slow.ravel(), kind="stable"), kind="stable")
            second = (rank.reshape(slow.shape) / slow.size).astype(np.float32)
            bright = 1 + 0.5 * _noise(rng, 7, 4)
            tile = MACRO_TILE_M
        else:
            second, bright, tile = _pattern(Material(layer), rng)
        stored = np.stack([second * 255, bright * UNIT_BRIGHTNESS], axis=-1)
        layers.append(_pyramid(np.clip(stored, 0, 255)))
        tiles.append(tile)
    return Patterns(np.stack(layers).ravel(), (1 / np.array(tiles)).astype(np.float32))


def _pyramid(image: NDArray[np.floating]) -> NDArray[np.uint64]:
    """All mip levels of an image (SIZE, SIZE, 2), concatenated; each texel is the mean of 2 x 2 of the level before."""
    levels = [image]
    while len(levels[-1]) > 1:
        last = levels[-1]
        levels.append((last[::2, ::2] + last[1::2, ::2] + last[::2, 1::2] + last[1::2, 1::2]) / 4)
    flat = np.concatenate([np.rint(level).reshape(-1, 2) for level in levels]).astype(np.uint64)
    return np.asarray(flat[:, 0] + (flat[:, 1] << np.uint64(32)))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _log2(x: float) -> float:
    """Base-2 logarithm, linear between powers of two; it is at most 0.09 too small, which blending does not show."""
    bits = np.int64(np.float32(x).view(np.int32))
    return (bits - 0x3F800000) / 8388608.0


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _bilinear(texels: NDArray[np.uint64], first: int | np.int64, size: int, u: float, v: float) -> np.int64:
    """Both channels times 65536 at (u, v) in tiles, on the level with ``size`` x ``size`` texels of a layer.

    Both channels are packed in one number and interpolated together, with weights in units of 1/256. ``first`` is the
    layer's first texel.
    """
    mask = size - 1
    # The offset makes numbers positive, so that truncation rounds down; the masks remove it again.
    scale = 256.0 * size
    x, y = np.int64(u * scale + (_POSITIVE - 128.0)), np.int64(v * scale + (_POSITIVE - 128.0))
    fx, fy = x & 255, y & 255
    i, j = (x >> 8) & mask, (y >> 8) & mask
    # Levels before this one hold SIZE^2 + SIZE^2/4 + ... texels. Unsigned indices need no check of the sign.
    base = first + 4 * ((SIZE * SIZE - size * size) // 3)
    upper, lower = base + size * j, base + size * ((j + 1) & mask)
    right = (i + 1) & mask
    a = np.int64(texels[np.uint64(upper + i)]) * (256 - fx) + np.int64(texels[np.uint64(upper + right)]) * fx
    b = np.int64(texels[np.uint64(lower + i)]) * (256 - fx) + np.int64(texels[np.uint64(lower + right)]) * fx
    return np.int64(a * (256 - fy) + b * fy)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def sample(
    texels: NDArray[np.uint64],
    per_tile: float,
    layer: int | np.int64,
    u: float,
    v: float,
    dudx: float,
    dvdx: float,
    dudy: float,
    dvdy: float,
    most: int,
) -> tuple[float, float]:
    """Second colour's share in [0, 1] and brightness of a layer at (u, v) metres, averaged over the pixel's footprint.

    Trilinear probes are taken along the longer side of the footprint. Their number is the ratio of its sides but at
    most ``most`` (up to 8), beyond which they blur (Heckbert, "Survey of texture mapping", 1986; the derivatives are
    Igehy's ray differentials, 1999). Two levels are blended only in the middle half between them; elsewhere one is
    used. ``texels`` and ``per_tile`` are those of :class:`Patterns`.
    """
    u, v = u * per_tile, v * per_tile
    ax, ay, bx, by = dudx * per_tile, dvdx * per_tile, dudy * per_tile, dvdy * per_tile
    long2, short2 = ax * ax + ay * ay, bx * bx + by * by
    # The footprint is a parallelogram; its width across the long side follows from its area.
    area = abs(ax * by - ay * bx)
    if long2 < short2:
        ax, ay, long2 = bx, by, short2
    size = SIZE
    first = layer * LAYER
    if long2 * (SIZE * SIZE) <= 1.0:
        total, step = _BLENDS * _bilinear(texels, first, size, u, v), 1.0
    else:
        longer = long2 / area
        probes = min(most, int(min(longer, SIZE * math.sqrt(long2))) + 1)
        narrowed = min(longer, float(probes))
        lod = 0.5 * _log2(max(1.0, SIZE * SIZE * long2 / (narrowed * narrowed)))
        lod = min(lod, LEVELS - 1.0)
        level = int(lod)
        blend = int(min(max(2 * _BLENDS * (lod - level) - 0.5 * (_BLENDS - 1), 0.0), float(_BLENDS)))
        if blend == _BLENDS:
            level, blend = level + 1, 0
        size >>= level
        step = _PARTS[probes]
        ax, ay = ax * step, ay * step
        at = 0.5 * (1 - probes)
        u, v = u + at * ax, v + at * ay
        total = np.int64(0)
        for _ in range(probes):
            if blend == 0:
                total += _BLENDS * _bilinear(texels, first, size, u, v)
            else:
                total += (_BLENDS - blend) * _bilinear(texels, first, size, u, v)
                total += blend * _bilinear(texels, first, size >> 1, u, v)
            u, v = u + ax, v + ay
    step *= 1.0 / (65536.0 * _BLENDS)
    return (total & 0xFFFFFFFF) * (step * (1 / 255.0)), (total >> 32) * (step * (1 / UNIT_BRIGHTNESS))
