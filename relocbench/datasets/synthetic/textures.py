"""Tileable surface patterns as mip pyramids, and their filtering over a pixel's footprint.

A pattern has two channels: how much of the material's second colour shows (mortar, dirt, grain), and brightness.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from relocbench.datasets.synthetic.mesh import Material

Floats = NDArray[np.float32]
SIZE = 256
"""texels along a side of the finest level"""
LEVELS = 9
MACRO = len(Material)
"""the layer of slow noise with uniform distribution: stains, puddles, drifts of snow"""
MACRO_TILE_M = 29.0
UNIT_BRIGHTNESS = 128.0


class Patterns(NamedTuple):
    """All layers: one per material, then :data:`MACRO`."""

    texels: NDArray[np.uint8]
    """(layer, texel of all levels, 2)"""
    start: NDArray[np.int64]
    """(LEVELS,) first texel of a level"""
    tile_m: Floats
    """(layer,) metres that the pattern spans before it repeats"""


def _noise(rng: np.random.Generator, cells: int, octaves: int, gain: float = 0.5, stretch: int = 1) -> Floats:
    """Tileable value noise (SIZE, SIZE), zero mean and unit deviation; ``stretch`` lengthens it along v."""
    total = np.zeros((SIZE, SIZE))
    for k in range(octaves):
        n = min(cells * 2**k, SIZE)
        m = max(1, n // stretch)
        total += gain**k * _enlarge(_enlarge(rng.standard_normal((m, n)), 0), 1)
    return np.asarray((total - total.mean()) / total.std(), dtype=np.float32)


def _enlarge(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Periodic smooth interpolation to SIZE along an axis."""
    n = values.shape[axis]
    x = np.arange(SIZE) * n / SIZE
    i = np.floor(x).astype(int)
    t = x - i
    t = t * t * (3 - 2 * t)
    shape = [1, 1]
    shape[axis] = SIZE
    t = t.reshape(shape)
    return values.take(i % n, axis) * (1 - t) + values.take((i + 1) % n, axis) * t


def _bricks(
    rng: np.random.Generator, columns: int, rows: int, joint: float, shift: float = 0.5
) -> tuple[Floats, Floats]:
    """Running bond: mask of the joints and a brightness of each brick; ``joint`` in texels."""
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
    """Share of the second colour, brightness (1 in the mean, about) and metres a tile."""
    fine, coarse = _noise(rng, 64, 3), _noise(rng, 6, 5, 0.6)
    none = np.zeros((SIZE, SIZE), dtype=np.float32)
    match material:
        case Material.ASPHALT:
            y, x = np.mgrid[:SIZE, :SIZE] / SIZE
            crack = np.abs(y - 0.5 - 0.12 * np.sin(2 * np.pi * x) - 0.03 * _noise(rng, 12, 3))
            cracks = np.clip(1 - crack / 0.006, 0, 1) * (_noise(rng, 3, 1) > 0.2)
            return np.clip(0.25 + 0.3 * coarse + cracks, 0, 1), 1 + 0.16 * fine + 0.08 * coarse - 0.3 * cracks, 3.1
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
    """Patterns of all materials; the same seed gives the same bytes."""
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
    sizes = [(SIZE >> k) ** 2 for k in range(LEVELS)]
    start = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    return Patterns(np.stack(layers), start, np.array(tiles, dtype=np.float32))


def _pyramid(image: NDArray[np.floating]) -> NDArray[np.uint8]:
    """All levels of (SIZE, SIZE, 2) one after the other, each the mean of 2 x 2 of the one before."""
    levels = [image]
    while len(levels[-1]) > 1:
        last = levels[-1]
        levels.append((last[::2, ::2] + last[1::2, ::2] + last[::2, 1::2] + last[1::2, 1::2]) / 4)
    return np.concatenate([np.rint(level).astype(np.uint8).reshape(-1, 2) for level in levels])


@njit(cache=True, nogil=True, error_model="numpy")
def _bilinear(
    texels: NDArray[np.uint8], start: NDArray[np.int64], layer: int | np.int64, level: int, u: float, v: float
) -> tuple[float, float]:
    """Both channels at (u, v) in tiles, on one level."""
    size = SIZE >> level
    x, y = u * size - 0.5, v * size - 0.5
    x0, y0 = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - x0, y - y0
    x0, y0 = x0 & (size - 1), y0 & (size - 1)
    x1, y1 = (x0 + 1) & (size - 1), (y0 + 1) & (size - 1)
    base = start[level]
    a, b = base + y0 * size, base + y1 * size
    w00, w10, w01, w11 = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    t = texels
    return (
        w00 * t[layer, a + x0, 0] + w10 * t[layer, a + x1, 0] + w01 * t[layer, b + x0, 0] + w11 * t[layer, b + x1, 0],
        w00 * t[layer, a + x0, 1] + w10 * t[layer, a + x1, 1] + w01 * t[layer, b + x0, 1] + w11 * t[layer, b + x1, 1],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def sample(
    patterns: Patterns,
    layer: int | np.int64,
    u: float,
    v: float,
    dudx: float,
    dvdx: float,
    dudy: float,
    dvdy: float,
    most: int,
) -> tuple[float, float]:
    """Second colour's share [0, 1] and brightness of a layer at (u, v) metres, averaged over the pixel's footprint.

    Trilinear probes along the longer side of the footprint, as many as it is longer than the shorter one but at most
    ``most``, beyond which they blur (Heckbert, "Survey of texture mapping", 1986; the derivatives are Igehy's ray
    differentials, 1999).
    """
    per_tile = 1.0 / patterns.tile_m[layer]
    u, v = u * per_tile, v * per_tile
    ax, ay, bx, by = dudx * per_tile, dvdx * per_tile, dudy * per_tile, dvdy * per_tile
    long2, short2 = ax * ax + ay * ay, bx * bx + by * by
    if long2 < short2:
        ax, ay, bx, by = bx, by, ax, ay
        long2, short2 = short2, long2
    # The footprint is a parallelogram: across its long side it is as wide as its area says.
    length = np.sqrt(long2)
    width = abs(ax * by - ay * bx) / max(length, 1e-12)
    probes = min(most, max(1, int(np.ceil(length / max(width, 1.0 / SIZE, 1e-9)))))
    lod = max(0.0, np.log2(max(width, length / probes) * SIZE + 1e-9))
    level = min(int(lod), LEVELS - 1)
    blend = min(lod - level, 1.0)
    second, bright = 0.0, 0.0
    for k in range(probes):
        at = (k + 0.5) / probes - 0.5
        s, b = _bilinear(patterns.texels, patterns.start, layer, level, u + at * ax, v + at * ay)
        if blend > 0.0 and level < LEVELS - 1:
            s1, b1 = _bilinear(patterns.texels, patterns.start, layer, level + 1, u + at * ax, v + at * ay)
            s, b = s + blend * (s1 - s), b + blend * (b1 - b)
        second += s
        bright += b
    return second / (255.0 * probes), bright / (UNIT_BRIGHTNESS * probes)
