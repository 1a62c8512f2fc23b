"""Appearance of each material: the colours that a variant can choose, gloss, and the effect of water."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from relocbench.arrays import Floats
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.kernels import njit

Colour = tuple[int, int, int]
CHOICES = 6


@dataclass(frozen=True)
class Look:
    """Appearance of a material. Colours are 8-bit sRGB here and are converted to linear albedo for rendering."""

    first: tuple[Colour, ...]
    """main colours, of which the variant chooses one"""
    second: Colour
    """colour of the pattern, such as mortar, dirt or grain"""
    spread: float = 0.06
    """variation of brightness between objects"""
    gloss: float = 0.0
    """strength of the specular reflection when dry"""
    porous: float = 0.0
    """share of the diffuse light that is lost when the surface is soaked"""
    film: float = 0.0
    """strength of the specular reflection when wet and horizontal"""
    hollows: float = 0.0
    """how readily puddles form on it"""


LOOKS: dict[Material, Look] = {
    Material.ASPHALT: Look(((86, 85, 85),), (64, 63, 64), 0.0, 0.0, 0.5, 0.6, 1.0),
    Material.COBBLES: Look(((128, 122, 116),), (72, 66, 60), 0.0, 0.0, 0.45, 0.5, 0.8),
    Material.PAVEMENT: Look(((158, 154, 148),), (108, 104, 98), 0.0, 0.0, 0.4, 0.4, 0.7),
    Material.KERB: Look(((172, 170, 165),), (100, 98, 94), 0.0, 0.0, 0.35, 0.3, 0.0),
    Material.LANE_MARKING: Look(((222, 222, 215),), (88, 87, 86), 0.0, 0.0, 0.1, 0.6, 1.0),
    Material.GRASS: Look(((96, 122, 58),), (124, 126, 74), 0.0, 0.0, 0.2, 0.02, 0.0),
    Material.SOIL: Look(((122, 100, 76),), (92, 74, 56), 0.0, 0.0, 0.5, 0.1, 0.6),
    Material.BRICK: Look(
        ((140, 84, 66), (124, 72, 58), (150, 104, 80), (170, 142, 108), (112, 72, 64), (186, 172, 146)),
        (168, 160, 148),
        0.06,
        0.0,
        0.3,
    ),
    Material.PLASTER: Look(
        ((220, 210, 188), (200, 178, 142), (208, 188, 170), (180, 186, 184), (204, 192, 156), (226, 224, 216)),
        (138, 128, 114),
        0.05,
        0.0,
        0.22,
    ),
    Material.STONE: Look(
        ((196, 186, 166), (176, 170, 160), (206, 192, 160), (160, 158, 154)), (126, 118, 106), 0.06, 0.0, 0.3
    ),
    Material.CONCRETE: Look(((176, 174, 170), (150, 150, 148), (188, 184, 172)), (122, 120, 116), 0.05, 0.0, 0.35),
    Material.ROOF_TILES: Look(
        ((126, 78, 62), (104, 70, 60), (84, 82, 84), (138, 94, 74), (96, 92, 90), (108, 84, 72)),
        (70, 58, 50),
        0.08,
        0.0,
        0.3,
    ),
    Material.ROOF_FLAT: Look(((112, 112, 112),), (86, 86, 84), 0.05, 0.0, 0.4, 0.3, 0.5),
    Material.WINDOW: Look(((38, 42, 46), (58, 58, 56), (30, 32, 36), (126, 122, 112)), (66, 64, 60), 0.1, 1.0),
    Material.SHOP_WINDOW: Look(((74, 66, 56), (56, 58, 62), (94, 84, 70)), (150, 128, 98), 0.15, 1.0),
    Material.CURTAIN: Look(
        ((198, 194, 184), (168, 164, 154), (182, 170, 148), (150, 152, 156), (206, 206, 204), (140, 120, 104)),
        (108, 104, 98),
        0.12,
        1.0,
    ),
    Material.GOODS: Look(
        ((176, 164, 146), (132, 60, 52), (64, 82, 118), (196, 188, 176), (92, 84, 76), (168, 136, 76)),
        (62, 58, 54),
        0.2,
        1.0,
    ),
    Material.DOOR: Look(
        ((88, 52, 36), (40, 62, 84), (46, 72, 52), (120, 34, 34), (64, 60, 58), (182, 176, 164)),
        (52, 40, 34),
        0.08,
        0.04,
    ),
    Material.SHOP_SIGN: Look(
        ((164, 38, 36), (36, 66, 128), (34, 98, 66), (168, 92, 28), (54, 50, 52), (92, 34, 62)),
        (240, 232, 214),
        0.05,
        0.03,
    ),
    Material.WOOD: Look(((122, 88, 58), (146, 112, 78), (216, 212, 202), (94, 72, 54)), (78, 58, 42), 0.06, 0.0, 0.3),
    Material.METAL: Look(((86, 90, 94), (58, 61, 64), (120, 122, 124), (70, 72, 74)), (66, 60, 56), 0.06, 0.15),
    Material.BARK: Look(((104, 88, 72), (122, 112, 98), (86, 74, 64)), (62, 52, 44), 0.06, 0.0, 0.4),
    Material.LEAF: Look(((92, 122, 52),), (70, 98, 40), 0.1, 0.02, 0.1),
    Material.HEDGE: Look(((62, 76, 46),), (46, 58, 36), 0.1, 0.0, 0.1),
    Material.CAR_PAINT: Look(
        ((216, 216, 214), (30, 31, 34), (138, 142, 147), (150, 24, 26), (26, 56, 122), (60, 78, 70)),
        (120, 120, 120),
        0.05,
        1.0,
    ),
    Material.CAR_GLASS: Look(((22, 25, 27),), (52, 56, 58), 0.0, 1.0),
    Material.RUBBER: Look(((38, 38, 39),), (58, 56, 54), 0.0, 0.0, 0.2),
    Material.TRAFFIC_SIGN: Look(((196, 36, 38),), (240, 240, 238), 0.0, 0.05),
    Material.LAMP: Look(((226, 224, 214),), (226, 224, 214), 0.0, 0.1),
    Material.PLASTIC: Look(((48, 50, 52), (66, 68, 68), (134, 136, 138)), (70, 70, 70), 0.05, 0.1),
    Material.PAINTED_WALL: Look(
        ((150, 176, 190), (196, 132, 104), (204, 168, 84), (156, 172, 140), (214, 160, 152), (128, 138, 158)),
        (128, 120, 108),
        0.05,
        0.0,
        0.22,
    ),
    Material.FRESH_ASPHALT: Look(((58, 58, 61),), (40, 40, 43), 0.05, 0.0, 0.4, 0.6, 0.3),
    Material.SIGNAL_RED: Look(((196, 44, 34),), (150, 60, 50), 0.03, 0.05),
    Material.SIGNAL_WHITE: Look(((230, 230, 226),), (170, 168, 162), 0.03, 0.05),
    Material.CONTAINER: Look(
        ((206, 160, 40), (44, 82, 140), (150, 74, 42), (58, 104, 62), (128, 130, 130), (196, 92, 34)),
        (92, 74, 58),
        0.06,
        0.1,
    ),
    Material.SHEET: Look(((214, 216, 212), (92, 132, 100), (96, 122, 156), (178, 182, 180)), (150, 152, 148), 0.05),
    Material.CLOTH: Look(
        ((38, 42, 54), (28, 28, 30), (120, 36, 40), (96, 100, 104), (168, 152, 124), (64, 84, 112)),
        (24, 26, 32),
        0.3,
        0.0,
        0.2,
    ),
    Material.TROUSERS: Look(
        ((52, 62, 86), (34, 35, 40), (30, 30, 32), (108, 98, 82), (74, 76, 80), (62, 72, 98)),
        (30, 32, 40),
        0.25,
        0.0,
        0.2,
    ),
    Material.SKIN: Look(
        ((214, 168, 140), (196, 146, 116), (224, 182, 156), (142, 98, 74), (96, 66, 50)), (170, 118, 96), 0.08, 0.02
    ),
    Material.HAIR: Look(
        ((46, 34, 26), (26, 22, 20), (92, 68, 46), (150, 122, 82), (140, 136, 132)), (30, 24, 20), 0.15, 0.02
    ),
    Material.AWNING: Look(
        ((164, 38, 36), (36, 66, 128), (34, 98, 66), (222, 184, 60), (54, 50, 52), (228, 222, 208)),
        (240, 232, 214),
        0.05,
    ),
    Material.GUIDE_SIGN: Look(((36, 82, 160),), (240, 240, 238), 0.0, 0.05),
    Material.STREET_NAME: Look(((30, 58, 122),), (236, 236, 232), 0.0, 0.05),
    Material.POSTER: Look(
        ((176, 44, 40), (34, 72, 150), (32, 110, 84), (206, 150, 40), (70, 46, 110), (196, 86, 36)),
        (238, 236, 228),
        0.08,
    ),
    Material.LIGHT_RED: Look(((255, 40, 30),), (255, 40, 30)),
    Material.LIGHT_GREEN: Look(((30, 255, 150),), (30, 255, 150)),
    Material.KERB_LINE: Look(((206, 166, 62),), (88, 87, 86), 0.0, 0.0, 0.1, 0.6, 1.0),
    Material.NUMBER_PLATE: Look(
        ((222, 221, 212), (222, 221, 212), (216, 186, 74), (222, 221, 212), (216, 186, 74), (222, 221, 212)),
        (28, 28, 30),
        0.05,
    ),
    Material.LIGHT_METAL: Look(
        ((150, 152, 154), (166, 168, 170), (96, 98, 100), (164, 164, 162)), (90, 86, 82), 0.1, 0.3
    ),
    Material.TAIL_LAMP: Look(((150, 22, 20),), (110, 16, 18), 0.1, 0.6),
}

SPRING: tuple[Colour, ...] = (
    *((96, 110, 58), (84, 104, 62), (102, 112, 68), (88, 108, 54)),
    *((106, 114, 62), (86, 100, 66), (96, 104, 56), (110, 96, 72)),
)
SUMMER: tuple[Colour, ...] = (
    *((64, 74, 42), (54, 68, 44), (72, 80, 50), (58, 74, 40)),
    *((76, 82, 46), (52, 64, 44), (68, 74, 40), (72, 60, 50)),
)
AUTUMN: tuple[Colour, ...] = (
    *((182, 138, 56), (158, 92, 48), (192, 158, 70), (132, 66, 44)),
    *((150, 118, 64), (112, 104, 56), (172, 120, 48), (120, 80, 56)),
)
"""leaves of eight kinds of trees"""


class Looks(NamedTuple):
    """:data:`LOOKS` as tables, colours as linear albedo."""

    first: Floats
    """(material, CHOICES, 3)"""
    second: Floats
    """(material, 3)"""
    spread: Floats
    gloss: Floats
    porous: Floats
    film: Floats
    hollows: Floats
    foliage: Floats
    """(8, 3) leaf colours of eight kinds of trees in the season"""


def linear(colour: Colour) -> Floats:
    """Linear albedo (3,) of an 8-bit sRGB colour."""
    c = np.array(colour) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4).astype(np.float32)


def make_looks(leaf_colour: float) -> Looks:
    """Tables of all looks for a season, given by :attr:`Factors.leaf_colour`."""
    ends = (SPRING, SUMMER) if leaf_colour <= 0.5 else (SUMMER, AUTUMN)
    part = np.float32(2 * leaf_colour - (leaf_colour > 0.5))
    leaves = [linear(a) + (linear(b) - linear(a)) * part for a, b in zip(*ends, strict=True)]
    looks = [LOOKS[m] for m in Material]
    return Looks(
        np.stack([np.stack([linear(k.first[i % len(k.first)]) for i in range(CHOICES)]) for k in looks]),
        np.stack([linear(k.second) for k in looks]),
        np.array([k.spread for k in looks], np.float32),
        np.array([k.gloss for k in looks], np.float32),
        np.array([k.porous for k in looks], np.float32),
        np.array([k.film for k in looks], np.float32),
        np.array([k.hollows for k in looks], np.float32),
        np.stack(leaves).astype(np.float32),
    )


@njit(cache=True, nogil=True)
def scramble(a: int | np.int64, b: int | np.int64) -> int:
    """Hash of two numbers to 32 bits (finaliser of MurmurHash3, public domain)."""
    x = (a * 0x9E3779B1 + b * 0x85EBCA6B + 0x7F4A7C15) & 0xFFFFFFFF
    x ^= x >> 16
    x = (x * 0x85EBCA6B) & 0xFFFFFFFF
    x ^= x >> 13
    x = (x * 0xC2B2AE35) & 0xFFFFFFFF
    return int(x ^ (x >> 16))
