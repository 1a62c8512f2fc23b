"""Surfaces show no period at which two poses could be taken for each other."""

from __future__ import annotations

import math

import numpy as np
import pytest

from relocbench.arrays import Array
from relocbench.datasets.synthetic.renderer.textures import MACRO, Patterns, bake, sample
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.kernels import njit

GROUND = (Material.ASPHALT, Material.COBBLES, Material.PAVEMENT, Material.GRASS, Material.SOIL, Material.LANE_MARKING)
WALLS = (Material.BRICK, Material.STONE, Material.PLASTER, Material.CONCRETE, Material.ROOF_TILES, Material.HEDGE)
STRIPS = (Material.KERB, Material.WOOD, Material.DOOR)
PERIODIC = (*GROUND, *WALLS, *STRIPS)
PATTERNS = bake(5)
STEP_M = 0.02


@njit(cache=True)
def _paint(
    patterns: Patterns, layer: int, salt: int, u0: float, v0: float, step: float, columns: int, rows: int
) -> Array:
    out = np.empty((rows, columns, 2))
    for j in range(rows):
        for i in range(columns):
            share, bright = sample(patterns, layer, salt, 1.0, u0 + step * i, v0 + step * j, step, 0.0, 0.0, step, 6)
            out[j, i, 0], out[j, i, 1] = share, bright
    return out


def paint(layer: int, u0: float, v0: float, columns: int, rows: int, salt: int = 9, step: float = STEP_M) -> Array:
    """Second colour and brightness (rows, columns, 2) of a rectangle of a surface."""
    out: Array = _paint(PATTERNS, int(layer), salt, u0, v0, step, columns, rows)
    return out


def likeness(a: Array, b: Array) -> float:
    """Correlation of two pictures without the average look of units, of which brick walls have a period by nature."""
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def tile_m(layer: int) -> float:
    return 1.0 / float(PATTERNS.per_tile[layer])


@pytest.mark.parametrize("material", PERIODIC, ids=lambda material: material.name)
def test_a_surface_one_tile_on_is_another(material: Material) -> None:
    """Joints may repeat, and what is between them may not: brightness of places that have no joint is compared."""
    columns, rows = int(1.5 / STEP_M), 12 if material in STRIPS else int(1.5 / STEP_M)
    alike = []
    for k in range(40):
        u0, v0 = 5.7 * k, 0.0 if material in STRIPS else 1.3 * k
        here = paint(material, u0, v0, columns, rows)
        for tiles in (1, 2) if material in STRIPS else (1, 2, 1j):
            du, dv = np.real(tiles) * tile_m(material), np.imag(tiles) * tile_m(material)
            there = paint(material, u0 + du, v0 + dv, columns, rows)
            inside = (here[..., 0] < 0.5) & (there[..., 0] < 0.5) if PATTERNS.laying[material, 0] > 0 else ...
            alike.append(likeness(here[..., 1][inside], there[..., 1][inside]))
    # Few units in a tile are the same ones by chance now and then.
    assert np.median(np.abs(alike)) < 0.35
    assert np.mean(np.array(alike) > 0.9) < 0.25


@pytest.mark.parametrize("salt", [0, 1])
def test_stains_and_puddles_have_no_period(salt: int) -> None:
    period = tile_m(MACRO)
    here = paint(MACRO, 0.0, 0.0, 90, 90, salt, 0.3)
    for tiles in (1, 2, 3):
        there = paint(MACRO, tiles * period, 0.0, 90, 90, salt, 0.3)
        assert abs(likeness(here[..., 0], there[..., 0])) < 0.4


@pytest.mark.parametrize("layer", [Material.ASPHALT, Material.GRASS, Material.PLASTER, MACRO])
def test_noise_looks_the_same_on_the_borders_of_tiles(layer: int) -> None:
    """Mean and spread on the border of tiles are those of the middle of tiles, and nothing jumps there."""
    tile = tile_m(layer)
    border, middle = (
        np.stack([paint(layer, (k + x) * tile, 0.21 * k * tile, 1, 400, step=tile / 64) for k in range(60)])
        for x in (0.0, 0.5)
    )
    for channel in (0, 1):
        a, b = border[..., channel], middle[..., channel]
        assert a.mean() == pytest.approx(b.mean(), abs=0.25 * b.std())
        assert a.std() == pytest.approx(b.std(), rel=0.25)
    hair = 1e-6 * tile
    for k in range(1, 20):
        left, right = (paint(layer, k * tile + x, 0.0, 1, 50)[..., 1] for x in (-hair, hair))
        np.testing.assert_allclose(left, right, atol=1.0 / 64)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "material", [m for m in PERIODIC if PATTERNS.laying[m, 0] > 0], ids=lambda material: material.name
)
def test_joints_go_on_from_tile_to_tile(material: Material) -> None:
    """Units meet in joints: along the middle of a row there are as many joints as units, evenly spaced."""
    columns, rows, _ = PATTERNS.laying[material]
    tile = tile_m(material)
    unit, height = tile / columns, tile / max(float(rows), 1.0)
    parts = 64
    for row in range(3 if rows > 1 else 1):
        line = paint(material, 0.25 * unit, (row + 0.5) * height, parts * 24, 1, step=unit / parts)[0, :, 0]
        offsets = np.array([np.mean(line[k::parts]) for k in range(parts)])
        at = int(np.argmax(offsets))
        apart = np.abs((np.arange(parts) - at + parts // 2) % parts - parts // 2)
        assert offsets[at] > offsets[apart > 12].max() + 0.15
        assert np.min(line[at::parts]) > np.median(line)


def test_surfaces_of_other_objects_are_laid_otherwise() -> None:
    a, b = (paint(Material.ASPHALT, 0.0, 0.0, 80, 80, salt)[..., 1] for salt in (3, 4))
    assert abs(likeness(a, b)) < 0.3


def test_the_average_over_many_tiles_is_the_pattern_s() -> None:
    for material in Material:
        wide = paint(int(material), 0.3, 0.3, 40, 40, step=tile_m(material) * 3.7)
        mean = PATTERNS.mean[material] / (255.0, 128.0)
        np.testing.assert_allclose(wide.mean(axis=(0, 1)), mean, atol=0.03)
        assert math.isfinite(float(wide.std()))


def test_number_plates_differ() -> None:
    written = PATTERNS.second(Material.NUMBER_PLATE)
    plates = [written[32 * k : 32 * k + 32, 128 * j : 128 * j + 128] for k in range(8) for j in range(2)]
    assert all(0.05 < plate.mean() < 0.4 for plate in plates)
    assert len({plate.tobytes() for plate in plates}) == 16
    assert not any(plate[[0, -1]].any() or plate[:, [0, -1]].any() for plate in plates)
