"""Signs show the words of their pages, and people are where they move."""

from __future__ import annotations

import numpy as np
import pytest

from relocbench.arrays import Array, Floats
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.renderer.lettering import invented_word
from relocbench.datasets.synthetic.renderer.patterns import SIZE
from relocbench.datasets.synthetic.renderer.render import Renderer
from relocbench.datasets.synthetic.renderer.textures import bake
from relocbench.datasets.synthetic.town.houses.facades import name_board
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic
from relocbench.datasets.synthetic.town.moving import Kind, Moving, moving_mesh
from relocbench.datasets.synthetic.town.people import BUILDS, rider, stander, walker
from relocbench.datasets.synthetic.town.shapes import poses, single
from relocbench.geometry import Camera

SEED = 5
COLUMNS, ROWS = 2, 8
"""of cells"""
CAMERA = Camera("pinhole", 192, 48, 320.0, 320.0, 95.5, 23.5)
"""sees 2.4 m x 0.6 m at 4 m"""
CLEAR = Factors(cloud_cover=1.0, read_noise=0.0, shot_noise=0.0, vignetting=0.0)


def cells() -> list[Floats]:
    """What the first page of boards has, each (rows, columns) from above, as large as the camera's images."""
    page = bake(SEED).second(int(Material.SHOP_SIGN))[::-1]
    height, width = SIZE // ROWS, SIZE // COLUMNS
    rows, columns = np.arange(48) * height // 48, np.arange(192) * width // 192
    return [page[r * height + rows][:, c * width + columns] for r in range(ROWS) for c in range(COLUMNS)]


def board(variant: int) -> Mesh:
    """A board over the whole picture, whose front looks to -y."""
    return single(name_board(np.array([-1.2, 1.2, 4.7, 5.3]), 0.0, variant), 1, 0, Semantic.BUILDING)


def likeness(a: Array, b: Floats) -> float:
    return abs(float(np.corrcoef(a.ravel(), b.ravel())[0, 1]))


@pytest.mark.thorough
def test_a_board_shows_one_word_upright_and_not_mirrored() -> None:
    around = Renderer(board(0), CLEAR, np.zeros((0, 3)), SEED).surroundings
    T_world_cam = np.array([[1.0, 0, 0, 0], [0, 0, 1, -4], [0, -1, 0, 5], [0, 0, 0, 1]])
    found = set()
    for variant in range(1, 25):
        renderer = Renderer(board(variant), CLEAR, np.zeros((0, 3)), SEED, around)
        picture = renderer.render(CAMERA, T_world_cam, 0).rgb.astype(float).mean(axis=2)
        alike = [likeness(picture, cell) for cell in cells()]
        best = int(np.argmax(alike))
        if alike[best] > 0.85:  # the others are on further pages
            found.add(best)
            assert likeness(picture[:, ::-1], cells()[best]) < 0.7
            assert likeness(picture[::-1], cells()[best]) < 0.7
    assert len(found) >= 3


def test_words_can_be_spoken_and_seldom_repeat() -> None:
    rng = np.random.default_rng(1)
    words = [invented_word(rng) for _ in range(200)]
    assert len(set(words)) > 190
    assert all(word.isalpha() and word[0].isupper() and 3 <= len(word) <= 14 for word in words)


@pytest.mark.parametrize("build", range(BUILDS))
def test_people_are_as_large_as_people_and_stand_on_the_ground(build: int) -> None:
    for shape in (*(walker(build, phase) for phase in range(8)), *(stander(build, way) for way in range(4))):
        low, high = shape.vertices.min(0), shape.vertices.max(0)
        assert -0.03 < low[2] < 0.04
        assert 1.6 < high[2] < 1.85
        assert (high - low)[:2].max() < 1.3
        assert len(shape) < 500
    assert rider(build, 0).vertices[:, 2].min() == pytest.approx(0.0, abs=0.03)


def test_who_walks_on_takes_steps_and_keeps_name_and_clothes() -> None:
    def at(x: float) -> Array:
        mesh = moving_mesh([Moving(poses(x, 0.0, 0.0, 0.0)[0], 77, Kind.WALKER)])
        assert set(mesh.instance.tolist()) == {2**31 + 77}
        assert set(mesh.semantic.tolist()) == {Semantic.PERSON}
        out: Array = mesh.vertices - np.array([x, 0, 0])
        return out

    assert np.abs(at(0.01) - at(0.02)).max() < 1e-6
    assert np.abs(at(0.01) - at(0.5)).max() > 0.2
    assert np.abs(at(0.01) - at(0.01 + 1.45)).max() < 1e-5
