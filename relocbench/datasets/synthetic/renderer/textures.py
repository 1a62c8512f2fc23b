"""Surface patterns as mip pyramids, laid without a period, and their filtering over a pixel's footprint.

A pattern has two channels: the share of the material's second colour (mortar, dirt, grain), and brightness. It is
tileable, but a surface that showed the same tile side by side would look the same from poses one tile apart. So every
tile of a surface shows its pattern from another place, drawn by a hash of the tile and the object (see ``_shift``).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Floats
from relocbench.datasets.synthetic.renderer.lettering import PAGES, Lettering, make_lettering, page
from relocbench.datasets.synthetic.renderer.materials import scramble
from relocbench.datasets.synthetic.renderer.patterns import ALIKE, NOISE, SIZE, Laying, noise, pattern
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.kernels import njit

LEVELS = 9
LAYER = (4 * SIZE * SIZE - 1) // 3
"""number of texels in all levels of a layer"""
MACRO = len(Material)
"""the layer of low-frequency noise with uniform distribution, for stains, puddles and snow drifts"""
_DRAWN_AS = {MACRO: 28}
"""numbers of layers in the order in which they were added, where it is another: what is drawn for each stays"""
MACRO_TILE_M = 29.0
UNIT_BRIGHTNESS = 128.0
_POSITIVE = 2.0**40
_BLENDS = 16
"""blending steps between two levels; eight probes times these still fit into the bits of a channel"""
_PARTS = np.array([0, *(1 / k for k in range(1, 9))])
_ZONE = 0.08
"""half the width of the zone, in tiles, in which neighbouring tiles of noise change into each other"""


class Patterns(NamedTuple):
    """All layers: one for each material, :data:`MACRO`, and further pages of signs."""

    texels: NDArray[np.uint64]
    """layer by layer, and in each layer level by level; a texel is second + 2^32 brightness"""
    per_tile: Floats
    """(layer,) tiles per metre"""
    laying: Floats
    """(layer, 3) the :class:`Laying` of each"""
    mean: Floats
    """(layer, 2) mean of both channels, in texels' units"""
    lettering: Lettering

    def second(self, layer: int) -> Floats:
        """The first channel (SIZE, SIZE) of a layer's finest level, in [0, 1]."""
        finest = self.texels[layer * LAYER : layer * LAYER + SIZE * SIZE].reshape(SIZE, SIZE)
        return (finest & 0xFF).astype(np.float32) / np.float32(255)


@lru_cache(maxsize=2)
def bake(seed: int) -> Patterns:
    """Make the patterns of all materials; the same seed gives the same bytes."""
    layers = [
        _layer(layer, np.random.default_rng([seed, 21, _DRAWN_AS.get(layer, layer)])) for layer in range(MACRO + 1)
    ]
    for material, (grid, _, kinds) in PAGES.items():
        rng = np.random.default_rng([seed, 22, material])
        layers += [(*page(kind, SIZE, grid, rng), *layers[material][2:]) for kind in kinds[1:]]
    texels = np.stack([_pyramid(np.clip(np.stack([a * 255, b * UNIT_BRIGHTNESS], -1), 0, 255)) for a, b, *_ in layers])
    last = texels[:, -1]
    mean = np.stack([last & np.uint64(0xFFFFFFFF), last >> np.uint64(32)], axis=1).astype(np.float32)
    per_tile = (1 / np.array([tile for *_, tile, _ in layers])).astype(np.float32)
    layings = np.array([laying for *_, laying in layers], dtype=np.float32)
    return Patterns(texels.ravel(), per_tile, layings, mean, make_lettering(MACRO + 1))


def _layer(layer: int, rng: np.random.Generator) -> tuple[Floats, Floats, float, Laying]:
    """What :func:`pattern` returns, of any layer."""
    if layer == MACRO:
        slow = noise(rng, 5, 6, 0.55)
        rank = np.argsort(np.argsort(slow.ravel(), kind="stable"), kind="stable")
        return (
            (rank.reshape(slow.shape) / slow.size).astype(np.float32),
            1 + 0.5 * noise(rng, 7, 4),
            MACRO_TILE_M,
            NOISE,
        )
    if Material(layer) in PAGES:
        grid, width, kinds = PAGES[Material(layer)]
        return *page(kinds[0], SIZE, grid, rng), grid[0] * width, ALIKE
    return pattern(Material(layer), rng)


def _pyramid(image: NDArray[np.floating]) -> NDArray[np.uint64]:
    """All mip levels of an image (SIZE, SIZE, 2), concatenated; each texel is the mean of 2 x 2 of the level before."""
    levels = [image]
    while len(levels[-1]) > 1:
        last = levels[-1]
        levels.append((last[::2, ::2] + last[1::2, ::2] + last[::2, 1::2] + last[1::2, 1::2]) / 4)
    flat = np.concatenate([np.rint(level).reshape(-1, 2) for level in levels]).astype(np.uint64)
    return np.asarray(flat[:, 0] + (flat[:, 1] << np.uint64(32)))


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _log2(x: float) -> float:
    """Base-2 logarithm, linear between powers of two; it is at most 0.09 too small, which blending does not show."""
    bits = np.int64(np.float32(x).view(np.int32))
    return (bits - 0x3F800000) / 8388608.0


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
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


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _blended(texels: NDArray[np.uint64], first: int | np.int64, size: int, blend: int, u: float, v: float) -> np.int64:
    """Both channels times 65536 ``_BLENDS`` at (u, v) in tiles, ``blend`` parts of them from the level below."""
    total = (_BLENDS - blend) * _bilinear(texels, first, size, u, v)
    if blend > 0:
        total += blend * _bilinear(texels, first, size >> 1, u, v)
    return np.int64(total)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _shift(
    columns: float, rows: float, bond: float, column: int, row: int, salt: int | np.int64
) -> tuple[float, float]:
    """Where in the pattern a tile of a surface begins, in tiles: whole units, for noise anywhere.

    A bond goes on when rows are shifted in pairs. A single row, of a kerb or a fence, has no joints along it, so that
    it begins anywhere on that side and does not change there.
    """
    drawn = scramble(scramble(column, 0 if rows == 1.0 else row), salt)
    a, b = drawn & 0xFFFF, drawn >> 16
    du, dv = a / 65536.0, b / 65536.0
    if columns > 0.0:
        du = math.floor(du * columns) / columns
    if rows > 1.0:
        step = 2.0 if bond > 0.0 else 1.0
        dv = math.floor(dv * rows / step) * step / rows
    return du, dv


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _shares(x: float) -> tuple[int, float, float]:
    """The neighbour on the nearer side of a place in tiles, -1 or 1, and the shares of the own tile and of it.

    The squares of the shares sum to one, so that the sum of two independent patterns varies as each does.
    """
    part = x - math.floor(x)
    to_border = min(part, 1.0 - part)
    if to_border >= _ZONE:
        return 1, 1.0, 0.0
    t = 0.5 + 0.5 * to_border / _ZONE
    own = t * t * (3.0 - 2.0 * t)
    norm = 1.0 / math.sqrt(own * own + (1.0 - own) * (1.0 - own))
    return (-1 if part < 0.5 else 1), own * norm, (1.0 - own) * norm


@njit(cache=True, nogil=True, error_model="numpy")
def _across(
    patterns: Patterns, layer: int | np.int64, salt: int | np.int64, size: int, blend: int, u: float, v: float
) -> tuple[float, float]:
    """Both channels times 65536 ``_BLENDS`` at (u, v) in tiles, near the border of a tile or not.

    Tiles of units, such as bricks, meet in the joints between units. Tiles of noise change into each other with their
    mean and variance kept (Heitz and Neyret, "High-Performance By-Example Noise using a Histogram-Preserving Blending
    Operator", 2018, equation 2; tiles are squares here, which touch in narrow zones, instead of their triangles, which
    overlap everywhere).
    """
    texels, first = patterns.texels, layer * LAYER
    columns, rows, bond = patterns.laying[layer, 0], patterns.laying[layer, 1], patterns.laying[layer, 2]
    column, row = math.floor(u), math.floor(v)
    if columns > 0.0:
        along = u + bond / columns * (math.floor(v * rows) & 1)
        du, dv = _shift(columns, rows, bond, math.floor(along), row, salt)
        total = _blended(texels, first, size, blend, u + du, v + dv)
        return float(total & 0xFFFFFFFF), float(total >> 32)
    next_u, own_u, other_u = _shares(u)
    next_v, own_v, other_v = _shares(v)
    rest = (1.0 - (own_u + other_u) * (own_v + other_v)) * (65536.0 * _BLENDS)
    second, bright = rest * patterns.mean[layer, 0], rest * patterns.mean[layer, 1]
    for k in range(4):
        share = (other_u if k & 1 else own_u) * (other_v if k & 2 else own_v)
        if share > 0.0:
            du, dv = _shift(columns, rows, bond, column + next_u * (k & 1), row + next_v * (k >> 1), salt)
            total = _blended(texels, first, size, blend, u + du, v + dv)
            second, bright = second + share * (total & 0xFFFFFFFF), bright + share * (total >> 32)
    return second, bright


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _within_one_tile(columns: float, rows: float, bond: float, u: float, v: float, du: float, dv: float) -> bool:
    """Whether all that is within (du, dv) of a place in tiles shows one tile alone."""
    if columns < 0.0:
        return True
    zone = _ZONE if columns == 0.0 else 0.0
    right = bond / columns if columns > 0.0 else zone
    return math.floor(u - du - zone) == math.floor(u + du + right) and (
        math.floor(v - dv - zone) == math.floor(v + dv + zone) or rows == 1.0
    )


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def sample(
    patterns: Patterns,
    layer: int | np.int64,
    salt: int | np.int64,
    density: float,
    u: float,
    v: float,
    dudx: float,
    dvdx: float,
    dudy: float,
    dvdy: float,
    most: int | np.int64,
) -> tuple[float, float]:
    """Second colour's share in [0, 1] and brightness of a layer at (u, v) metres, averaged over the pixel's footprint.

    Trilinear probes are taken along the longer side of the footprint. Their number is the ratio of its sides but at
    most ``most`` (up to 8), beyond which they blur (Heckbert, "Survey of texture mapping", 1986; the derivatives are
    Igehy's ray differentials, 1999). Two levels are blended only in the middle half between them; elsewhere one is
    used. Surfaces with another ``salt`` are laid otherwise; ``density`` multiplies the layer's tiles per metre.
    """
    per_tile = density * patterns.per_tile[layer]
    u, v = u * per_tile, v * per_tile
    ax, ay, bx, by = dudx * per_tile, dvdx * per_tile, dudy * per_tile, dvdy * per_tile
    long2, short2 = ax * ax + ay * ay, bx * bx + by * by
    # The footprint is a parallelogram; its width across the long side follows from its area.
    area = abs(ax * by - ay * bx)
    if long2 < short2:
        ax, ay, long2 = bx, by, short2
    size, blend, step = SIZE, 0, 1.0
    probes: int | np.int64 = 1
    if long2 * (SIZE * SIZE) > 1.0:
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
    texels, first = patterns.texels, layer * LAYER
    columns, rows, bond = patterns.laying[layer, 0], patterns.laying[layer, 1], patterns.laying[layer, 2]
    reach = 0.5 * (probes - 1)
    second = bright = 0.0
    if _within_one_tile(columns, rows, bond, u, v, reach * abs(ax), reach * abs(ay)):
        du = dv = 0.0
        if columns >= 0.0:
            du, dv = _shift(columns, rows, bond, math.floor(u), math.floor(v), salt)
        u, v = u - reach * ax + du, v - reach * ay + dv
        total = np.int64(0)
        for _ in range(probes):
            total += _blended(texels, first, size, blend, u, v)
            u, v = u + ax, v + ay
        second, bright = float(total & 0xFFFFFFFF), float(total >> 32)
    else:
        u, v = u - reach * ax, v - reach * ay
        for _ in range(probes):
            a, b = _across(patterns, layer, salt, size, blend, u, v)
            second, bright = second + a, bright + b
            u, v = u + ax, v + ay
    step *= 1.0 / (65536.0 * _BLENDS)
    share = min(max(second * (step * (1 / 255.0)), 0.0), 1.0)
    return share, max(bright * (step * (1 / UNIT_BRIGHTNESS)), 0.0)
