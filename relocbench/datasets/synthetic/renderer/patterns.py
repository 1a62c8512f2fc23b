"""The pattern of each material: the share of its second colour, and brightness."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from relocbench.arrays import Array, Floats
from relocbench.datasets.synthetic.town.mesh import Material

SIZE = 256
"""texels along a side of a pattern"""


class Laying(NamedTuple):
    """How tiles of a pattern lie side by side."""

    columns: int
    """units such as bricks in a tile; 0: noise, whose tiles change into each other; -1: all tiles are alike"""
    rows: int = 0
    bond: float = 0.0
    """by how much of a unit odd rows are shifted"""


NOISE, ALIKE = Laying(0), Laying(-1)


def noise(rng: np.random.Generator, cells: int, octaves: int, gain: float = 0.5, stretch: int = 1) -> Floats:
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


def pattern(material: Material, rng: np.random.Generator) -> tuple[Floats, Floats, float, Laying]:
    """Share of the second colour, brightness (about 1 on average), metres per tile, and how tiles are laid."""
    fine, coarse = noise(rng, 64, 3), noise(rng, 6, 5, 0.6)
    none = np.zeros((SIZE, SIZE), dtype=np.float32)
    match material:
        case Material.ASPHALT | Material.FRESH_ASPHALT:
            y, x = np.mgrid[:SIZE, :SIZE] / SIZE
            wander = 0.12 * np.sin(2 * np.pi * x) + 0.02 * noise(rng, 12, 3)
            crack = np.clip(1 - np.abs(y - 0.5 - wander) / 0.004, 0, 1) * (noise(rng, 3, 1) > 0.6)
            crack = crack if material == Material.ASPHALT else none
            # Stones of one to three centimetres in bitumen, some of them light, with dark gaps in between.
            stones, grit = noise(rng, 128, 1), noise(rng, 256, 1)
            light = np.clip(grit - 1.3, 0, 1)
            second = np.clip(0.35 + 0.12 * coarse + 0.3 * np.clip(-stones - 0.6, 0, 1) + 0.7 * crack, 0, 1)
            return second, 1 + 0.05 * stones + 0.08 * grit + 0.25 * light + 0.05 * coarse - 0.25 * crack, 4.1, NOISE
        case Material.COBBLES:
            joints, tone = _bricks(rng, 16, 16, 2.2)
            return joints, 1 + 0.16 * tone + 0.07 * fine - 0.25 * joints, 2.0, Laying(16, 16, 0.5)
        case Material.PAVEMENT:
            # Slabs of half a metre. Their rows are even in number, so that the bond goes on from tile to tile.
            joints, tone = _bricks(rng, 6, 6, 0.8)
            bright = 1 + 0.09 * tone + 0.05 * fine + 0.04 * coarse
            return np.clip(joints + 0.15 * coarse, 0, 1), bright, 3.0, Laying(6, 6, 0.5)
        case Material.KERB:
            joints, tone = _bricks(rng, 3, 1, 0.8)
            joints[:] = joints[SIZE // 2]  # those across the kerb alone
            return joints, 1 + 0.05 * tone + 0.06 * fine, 3.0, Laying(3, 1)
        case Material.LANE_MARKING | Material.KERB_LINE:
            # Paint goes first where stones stand out.
            flaked = np.clip(0.6 * coarse + 0.5 * noise(rng, 128, 2) - 0.55, 0, 1)
            return np.asarray(flaked, np.float32), np.asarray(1 + 0.05 * fine, np.float32), 2.0, NOISE
        case Material.GRASS | Material.HEDGE | Material.LEAF:
            laying = ALIKE if material == Material.LEAF else NOISE
            return np.clip(0.4 + 0.35 * coarse, 0, 1), 1 + 0.22 * fine + 0.12 * coarse, 1.7, laying
        case Material.SOIL:
            return np.clip(0.4 + 0.3 * coarse, 0, 1), 1 + 0.2 * fine + 0.1 * coarse, 2.3, NOISE
        case Material.BRICK:
            joints, tone = _bricks(rng, 8, 24, 0.9)
            return joints, 1 + 0.13 * tone + 0.05 * fine, 2.0, Laying(8, 24, 0.5)
        case Material.STONE:
            joints, tone = _bricks(rng, 4, 8, 0.9)
            return joints * 0.8, 1 + 0.09 * tone + 0.05 * fine + 0.04 * coarse, 2.8, Laying(4, 8, 0.5)
        case Material.PLASTER | Material.PAINTED_WALL:
            streaks = noise(rng, 24, 2, stretch=12)
            return np.clip(0.15 * coarse + 0.12 * streaks, 0, 1), 1 + 0.05 * coarse + 0.03 * fine, 3.7, NOISE
        case Material.CONCRETE:
            joints, tone = _bricks(rng, 4, 4, 0.8, 0.0)
            streaks = noise(rng, 16, 3, stretch=8)
            return np.clip(0.25 * streaks + joints, 0, 1), 1 + 0.05 * tone + 0.06 * coarse, 4.8, Laying(4, 4)
        case Material.ROOF_TILES:
            y = np.mgrid[:SIZE, :SIZE][0] / SIZE
            joints, tone = _bricks(rng, 10, 8, 1.0)
            bright = 0.85 + 0.3 * ((y * 8) % 1) + 0.12 * tone + 0.05 * coarse
            return joints, bright, 2.4, Laying(10, 8, 0.5)
        case Material.CAR_GLASS:
            return _through_a_car(), 1 + 0.06 * coarse, 2.0, ALIKE
        case Material.WINDOW | Material.SHOP_WINDOW:
            return np.clip(0.5 + 0.5 * coarse, 0, 1), 1 + 0.12 * coarse, 2.9, ALIKE
        case Material.CURTAIN:
            folds = noise(rng, 48, 2, stretch=24)
            return np.clip(0.3 + 0.3 * folds, 0, 1), 1 + 0.1 * folds, 1.6, ALIKE
        case Material.GOODS:
            things = noise(rng, 24, 2)
            return (things > 0.2) * np.float32(0.8), 1 + 0.2 * things, 2.1, ALIKE
        case Material.WOOD | Material.DOOR:
            joints, tone = _bricks(rng, 8, 1, 0.8, 0.0)
            joints[:] = joints[SIZE // 2]  # planks without an end
            grain = noise(rng, 64, 2, stretch=16)
            return np.clip(joints + 0.2 * grain, 0, 1), 1 + 0.06 * tone + 0.07 * grain, 1.0, Laying(8, 1)
        case Material.BARK:
            ridges = noise(rng, 32, 3, stretch=6)
            return np.clip(0.4 + 0.4 * ridges, 0, 1), 1 + 0.18 * ridges, 0.9, ALIKE
        case Material.AWNING:
            stripes = (np.mgrid[:SIZE, :SIZE][1] * 8 // SIZE % 2) * 0.9
            return stripes.astype(np.float32), 1 + 0.04 * coarse, 2.4, ALIKE
        case Material.SHEET | Material.CLOTH | Material.TROUSERS:
            folds = noise(rng, 8, 3, stretch=8)
            tile = 2.6 if material == Material.SHEET else 1.1
            return np.clip(0.2 * folds, 0, 1), 1 + 0.1 * folds + 0.03 * fine, tile, NOISE
        case (
            Material.METAL | Material.RUBBER | Material.PLASTIC | Material.ROOF_FLAT
            | Material.LIGHT_METAL | Material.SIGNAL_RED | Material.SIGNAL_WHITE | Material.CONTAINER
        ):  # fmt: skip
            return np.clip(0.25 * coarse - 0.1, 0, 1), 1 + 0.05 * coarse + 0.03 * fine, 2.1, ALIKE
        case _:
            return none, np.ones_like(none), 2.0, ALIKE


def _through_a_car() -> Floats:
    """How much light comes through a car's side windows from those of the other side, past the seats (SIZE, SIZE)."""
    v, u = np.mgrid[:SIZE, :SIZE] * (2.0 / SIZE)
    band = np.clip((v - 0.72) / 0.08, 0, 1) * np.clip((1.04 - v) / 0.08, 0, 1)
    from_seat = np.abs((u + 0.35) % 1.0 - 0.5)
    seats = (np.hypot(from_seat / 0.17, np.maximum(v - 0.86, 0) / 0.12) < 1) | (from_seat > 0.46)
    return np.asarray(0.1 + 0.8 * band * ~seats, dtype=np.float32)
