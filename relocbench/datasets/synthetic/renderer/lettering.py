"""Invented words, and the pages of cells that hold what is on signs and posters.

A page is a pattern (SIZE, SIZE) that is divided into cells of equal size, of which the look of an object chooses one.
Its channels are those of :mod:`relocbench.datasets.synthetic.renderer.textures`: the share of the second colour, which
is white or nearly so, and brightness, which makes black of it. Words are drawn with OpenCV's stroke fonts and have no
meaning.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from relocbench.arrays import Bytes, Floats, Indices
from relocbench.datasets.synthetic.town.mesh import BOARD_M, PLATE_M, POSTER_M, SIGN_M, Material
from relocbench.kernels import njit

Cell = tuple[Floats, Floats]
"""share of the second colour and brightness (h, w), first row on top"""

_BOARDS, _SQUARES = (2, 8), (4, 4)
PAGES: dict[Material, tuple[tuple[int, int], float, tuple[str, ...]]] = {
    Material.SHOP_SIGN: (_BOARDS, BOARD_M, ("board", "negative", "board", "negative")),
    Material.STREET_NAME: (_BOARDS, BOARD_M, ("street", "street")),
    Material.POSTER: (_SQUARES, POSTER_M, ("poster", "poster")),
    Material.NUMBER_PLATE: (_BOARDS, PLATE_M, ("plate",)),
    Material.TRAFFIC_SIGN: (_SQUARES, SIGN_M, ("pictograms",)),
    Material.GUIDE_SIGN: (_SQUARES, SIGN_M, ("pictograms",)),
}
"""material -> columns and rows of cells, width of a cell in metres, and the kinds of its pages, of which the first is
in the material's own layer and the others in layers behind all materials"""
_ROWS_BY_SHAPE = (Material.TRAFFIC_SIGN, Material.GUIDE_SIGN)
"""of these the look chooses the column only; the row belongs to the shape of the sign"""


class Lettering(NamedTuple):
    """What the looks of objects choose from."""

    second: Indices
    """(material,) layer of the second page"""
    pages: Indices
    """(material,) number of pages; 0 for materials that are no signs"""
    cells: Indices
    """(material, 2) columns and rows from which the look chooses"""


def make_lettering(layers: int) -> Lettering:
    """The tables for pages that are behind so many layers."""
    second, pages, cells = np.zeros(layers, np.int64), np.zeros(layers, np.int64), np.ones((layers, 2), np.int64)
    behind = layers
    for material, (grid, _, kinds) in PAGES.items():
        second[material], pages[material] = behind, len(kinds)
        cells[material] = (grid[0], 1) if material in _ROWS_BY_SHAPE else grid
        behind += len(kinds) - 1
    return Lettering(second, pages, cells)


@njit(cache=True, nogil=True, error_model="numpy")
def chosen_cell(lettering: Lettering, material: np.int64, dice: np.int64) -> tuple[np.int64, float, float]:
    """Layer of the page of an object's sign, and where its cell begins in the page, in tiles."""
    k = dice % lettering.pages[material]
    layer = material if k == 0 else lettering.second[material] + k - 1
    columns, rows = lettering.cells[material, 0], lettering.cells[material, 1]
    return layer, ((dice >> 4) % columns) / columns, ((dice >> 8) % rows) / rows


_FINER = 4
"""pixels per texel in which cells are drawn"""
_ONSETS = ("b", "br", "d", "f", "fl", "g", "gr", "h", "k", "l", "m", "n", "p", "r", "s", "st", "t", "tr", "v", "w")
_VOWELS = ("a", "e", "i", "o", "u", "ei", "au", "ie")
_CODAS = ("", "", "", "l", "n", "r", "s", "rt", "nd", "lm", "x", "ck")
_FONTS = (
    cv2.FONT_HERSHEY_SIMPLEX,
    cv2.FONT_HERSHEY_DUPLEX,
    cv2.FONT_HERSHEY_COMPLEX,
    cv2.FONT_HERSHEY_TRIPLEX,
)
_INK, _NEARLY_BLACK = 255, 0.13


def invented_word(rng: np.random.Generator, syllables: int = 2) -> str:
    """A word of some syllables with a capital letter."""
    parts = [f"{rng.choice(_ONSETS)}{rng.choice(_VOWELS)}" for _ in range(syllables)]
    return ("".join(parts) + str(rng.choice(_CODAS))).capitalize()


def written(text: str, height: int, width: int, font: int, weight: float = 1.0) -> Floats:
    """A line of text in [0, 1] (height, width), as large as fits and in the middle; ``weight`` thickens the strokes."""
    large = np.zeros((height * _FINER, width * _FINER), dtype=np.uint8)
    (w, h), below = cv2.getTextSize(text, font, 4.0, 1)
    tall = h + below
    size = 4.0 * min(large.shape[1] * 0.94 / w, large.shape[0] * 0.92 / tall)
    thick = max(1, round(weight * size * 2.6))
    (w, h), below = cv2.getTextSize(text, font, size, thick)
    at = (large.shape[1] - w) // 2, (large.shape[0] + h) // 2 - below // 3
    cv2.putText(large, text, at, font, size, _INK, thick, cv2.LINE_AA)
    return _small(large)


def _small(large: Bytes) -> Floats:
    shape = large.shape[1] // _FINER, large.shape[0] // _FINER
    return np.asarray(cv2.resize(large, shape, interpolation=cv2.INTER_AREA), dtype=np.float32) / np.float32(255)


def _name_board(rng: np.random.Generator, height: int, width: int) -> Cell:
    """The word above a shop, in some beside a round or square mark."""
    word = invented_word(rng, int(rng.choice([2, 2, 3])))
    word = word.upper() if rng.random() < 0.5 else word
    out = np.zeros((height, width), dtype=np.float32)
    mark = height if rng.random() < 0.35 else 0
    inner = written(word, height - 8, width - mark - 6, int(rng.choice(_FONTS)), float(rng.uniform(0.8, 1.5)))
    out[4:-4, mark + 3 : width - 3] = inner
    if mark:
        large = np.zeros((height * _FINER, height * _FINER), dtype=np.uint8)
        middle, radius = height * _FINER // 2, height * _FINER // 3
        cv2.circle(large, (middle, middle), radius, _INK, -1 if rng.random() < 0.5 else radius // 3, cv2.LINE_AA)
        out[:, :mark] = _small(large)
    return out, np.ones_like(out)


def _negative(rng: np.random.Generator, height: int, width: int) -> Cell:
    """A board with letters of the first colour on white."""
    share, bright = _name_board(rng, height, width)
    return 1 - share, bright


def _street_name(rng: np.random.Generator, height: int, width: int) -> Cell:
    """White letters in a white frame."""
    word = invented_word(rng, int(rng.choice([2, 3])))
    out = np.zeros((height, width), dtype=np.float32)
    out[1:-1, 1:-1] = 1
    out[2:-2, 2:-2] = 0
    out[5:-5, 6:-6] = written(word, height - 10, width - 12, cv2.FONT_HERSHEY_DUPLEX)
    return out, np.ones_like(out)


def _number_plate(rng: np.random.Generator, height: int, width: int) -> Cell:
    """Letters and digits in the second colour."""
    letters = "".join(rng.choice(list("ABCDEFGHKLMNPRSTUVWXYZ"), 4))
    text = f"{letters[:2]}{rng.integers(10, 99)} {letters[2:]}{rng.integers(1, 9)}"
    out = np.zeros((height, width), dtype=np.float32)
    out[4:-4, 6:-6] = written(text, height - 8, width - 12, cv2.FONT_HERSHEY_SIMPLEX, 1.3)
    return out, np.ones_like(out)


def _poster(rng: np.random.Generator, height: int, width: int) -> Cell:
    """A large word, a shape and some lines of text, on light or coloured paper."""
    light = rng.random() < 0.5
    share = np.full((height, width), 0.92 if light else 0.04, dtype=np.float32)
    bright = np.ones((height, width), dtype=np.float32)
    y, x = np.mgrid[:height, :width] / np.array([height, width])[:, None, None]
    cx, cy, size = rng.uniform(0.3, 0.7), rng.uniform(0.45, 0.65), rng.uniform(0.15, 0.3)
    kind = rng.integers(3)
    if kind == 0:
        shape = np.hypot(x - cx, y - cy) < size
    elif kind == 1:
        shape = (np.abs(x - cx) < size * (y - 0.25) * 2) & (y > 0.3) & (y < 0.8)
    else:
        shape = np.abs(x - cx + rng.uniform(-0.8, 0.8) * (y - cy)) < 0.5 * size
    share[shape] = 0.0 if light else 0.9
    bright[shape] *= float(rng.uniform(0.6, 1.1))
    bright *= (1 + 0.25 * (0.5 - y)).astype(np.float32)
    ink = np.zeros((height, width), dtype=np.float32)
    top = height // 4
    ink[2:top, 2:-2] = written(invented_word(rng), top - 2, width - 4, cv2.FONT_HERSHEY_DUPLEX, 1.6)
    low = height * 13 // 16
    for row in range(low, height - 5, 6):
        words = " ".join(invented_word(rng, 2) for _ in range(3))
        ink[row : row + 5, 4:-4] = written(words, 5, width - 8, cv2.FONT_HERSHEY_SIMPLEX)
    dark = light or rng.random() < 0.3
    share = share + (1 - share) * ink * (0.0 if dark else 1.0)
    bright = bright * (1 - ink * (1 - _NEARLY_BLACK) * (1.0 if dark else 0.0))
    return share.astype(np.float32), bright.astype(np.float32)


def _pictograms(height: int, width: int) -> list[list[Cell]]:
    """Rows of cells: what is on prohibiting discs, warning triangles, blue plates and blue discs."""
    side = width * _FINER
    middle = side // 2

    def canvas() -> Bytes:
        return np.zeros((height * _FINER, side), dtype=np.uint8)

    def text(word: str, part: float) -> Floats:
        h, w = round(height * part), round(width * part)
        out = np.zeros((height, width), dtype=np.float32)
        top, left = (height - h) // 2, (width - w) // 2
        out[top : top + h, left : left + w] = written(word, h, w, cv2.FONT_HERSHEY_DUPLEX, 1.4)
        return out

    def lines(*ways: tuple[tuple[float, float], ...], thick: float = 0.1) -> Floats:
        large = canvas()
        for way in ways:
            points = np.round(np.array(way) * side).astype(np.int32)
            cv2.polylines(large, [points], False, _INK, round(thick * side), cv2.LINE_AA)
        return _small(large)

    def disc(part: float) -> Floats:
        large = canvas()
        cv2.circle(large, (middle, middle), round(part * side), _INK, -1, cv2.LINE_AA)
        return _small(large)

    large = canvas()
    corners = np.array([[0.12, 0.83], [0.88, 0.83], [0.5, 0.17]])
    inner = corners.mean(0) + 0.62 * (corners - corners.mean(0))
    cv2.fillPoly(large, [np.round(inner * side).astype(np.int32)], _INK, cv2.LINE_AA)
    white, ring = _small(large), disc(0.29)
    none = np.zeros((height, width), dtype=np.float32)
    arrow = lines(((0.5, 0.74), (0.5, 0.28)), ((0.36, 0.42), (0.5, 0.27), (0.64, 0.42)))
    aside = lines(((0.28, 0.5), (0.7, 0.5)), ((0.56, 0.36), (0.71, 0.5), (0.56, 0.64)))
    walker = np.maximum(
        lines(((0.5, 0.4), (0.48, 0.58), (0.38, 0.76)), ((0.48, 0.58), (0.6, 0.75)), ((0.4, 0.52), (0.6, 0.5))),
        lines(((0.51, 0.29), (0.51, 0.3)), thick=0.12),
    )
    bumps = lines(((0.3, 0.74), (0.42, 0.64), (0.5, 0.74), (0.6, 0.64), (0.7, 0.74)), thick=0.06)
    mark = lines(((0.5, 0.45), (0.5, 0.62)), ((0.5, 0.71), (0.5, 0.72)), thick=0.07)
    fork = lines(((0.5, 0.75), (0.5, 0.45)), ((0.4, 0.64), (0.6, 0.64)), thick=0.06)

    def black(ground: Floats, ink: Floats) -> Cell:
        return ground, (1 - (1 - _NEARLY_BLACK) * ink).astype(np.float32)

    def plain(ink: Floats) -> Cell:
        return ink, np.ones_like(ink)

    small = lines(((0.5, 0.52), (0.46, 0.72)), ((0.5, 0.6), (0.56, 0.72)), ((0.42, 0.58), (0.58, 0.57)), thick=0.05)
    wheels = np.maximum(lines(((0.36, 0.56), (0.46, 0.44), (0.6, 0.44), (0.66, 0.56)), thick=0.05), _wheels(side))
    return [
        [plain(lines(((0.28, 0.5), (0.72, 0.5)), thick=0.13)), black(ring, text("30", 0.44)),
         black(ring, text("50", 0.44)), black(ring, none)],
        [black(white, mark), black(white, small), black(white, bumps), black(white, fork)],
        [plain(text("P", 0.62)), plain(walker), plain(arrow), plain(text("i", 0.6))],
        [plain(aside), plain(arrow), plain(wheels), plain(walker)],
    ]  # fmt: skip


def _wheels(side: int) -> Floats:
    large = np.zeros((side, side), dtype=np.uint8)
    for x in (0.36, 0.66):
        cv2.circle(
            large, (round(x * side), round(0.56 * side)), round(0.12 * side), _INK, round(0.04 * side), cv2.LINE_AA
        )
    return _small(large)


def _page(size: int, cells: tuple[int, int], draw: Callable[[int, int, int, int], Cell]) -> Cell:
    """A page of (columns, rows) of cells, from below upwards as surface coordinates go."""
    columns, rows = cells
    width, height = size // columns, size // rows
    share, bright = np.zeros((2, size, size), dtype=np.float32)
    for row in range(rows):
        for column in range(columns):
            place = np.s_[row * height : (row + 1) * height, column * width : (column + 1) * width]
            one, other = draw(column, row, height, width)
            share[place], bright[place] = one[::-1], other[::-1]
    return share, bright


_DRAWN: dict[str, Callable[[np.random.Generator, int, int], Cell]] = {
    "board": _name_board,
    "negative": _negative,
    "street": _street_name,
    "plate": _number_plate,
    "poster": _poster,
}


def page(kind: str, size: int, cells: tuple[int, int], rng: np.random.Generator) -> Cell:
    """A page of a kind: board, negative (of letters on white), street, plate, poster or pictograms.

    Args:
        size: texels along each side.
        cells: columns and rows.
    """
    if kind == "pictograms":
        drawn = _pictograms(size // cells[1], size // cells[0])
        return _page(size, cells, lambda column, row, height, width: drawn[row][column])
    return _page(size, cells, lambda column, row, height, width: _DRAWN[kind](rng, height, width))
