"""Triangle meshes with the attributes that rendering and ground truth need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Bytes, Floats, Mask

BOARD_M, POSTER_M, SIGN_M = 2.4, 0.9, 0.8
"""widths in surface coordinates of a board with a word, whose height is a quarter of it, and of a poster and of what is
on a traffic sign, whose heights are the same"""
PLATE_M = 0.52
"""the same of a number plate, whose height is a quarter of it"""


class Material(IntEnum):
    """Material of a triangle, which determines its appearance in every weather."""

    ASPHALT = 0
    """of a street, with the surface coordinates and variants of ``carriageway.py``, as have markings"""
    COBBLES = 1
    PAVEMENT = 2
    KERB = 3
    LANE_MARKING = 4
    GRASS = 5
    SOIL = 6
    BRICK = 7
    PLASTER = 8
    STONE = 9
    CONCRETE = 10
    ROOF_TILES = 11
    ROOF_FLAT = 12
    WINDOW = 13
    """glass in a wall, which reflects the sky and may be lit at night"""
    SHOP_WINDOW = 14
    DOOR = 15
    SHOP_SIGN = 16
    """a board with a word"""
    WOOD = 17
    METAL = 18
    BARK = 19
    LEAF = 20
    HEDGE = 21
    CAR_PAINT = 22
    CAR_GLASS = 23
    RUBBER = 24
    TRAFFIC_SIGN = 25
    """a red one"""
    LAMP = 26
    """the luminous part of a street lamp or headlight"""
    PLASTIC = 27
    PAINTED_WALL = 28
    """a wall that was painted after the town was built, in colours that plaster does not have"""
    FRESH_ASPHALT = 29
    SIGNAL_RED = 30
    SIGNAL_WHITE = 31
    CONTAINER = 32
    SHEET = 33
    """cloth on a scaffold"""
    CLOTH = 34
    """coats, jackets and bags"""
    TROUSERS = 35
    SKIN = 36
    HAIR = 37
    AWNING = 38
    GUIDE_SIGN = 39
    """a blue traffic sign"""
    STREET_NAME = 40
    POSTER = 41
    LIGHT_RED = 42
    """a lit lamp of a traffic light"""
    LIGHT_GREEN = 43
    CURTAIN = 44
    """curtains and blinds behind glass"""
    GOODS = 45
    """what is shown in shop windows, behind glass"""
    KERB_LINE = 46
    """yellow lines where nobody may park"""
    NUMBER_PLATE = 47
    LIGHT_METAL = 48
    """rims of wheels"""
    TAIL_LAMP = 49


class Semantic(IntEnum):
    """Class of an object, as stored in semantic masks."""

    NONE = 0
    ROAD = 1
    PAVEMENT = 2
    MARKING = 3
    TERRAIN = 4
    BUILDING = 5
    TREE = 6
    HEDGE = 7
    POLE = 8
    SIGN = 9
    FURNITURE = 10
    PARKED_CAR = 11
    MOVING_CAR = 12
    WORKS = 13
    """scaffolds, roadworks and containers"""
    PERSON = 14
    """on foot"""
    CYCLIST = 15
    """with the bicycle"""
    SKY = 255


_OF_TRIANGLES = ("uv", "material", "semantic", "instance", "variant", "rank")


@dataclass(frozen=True, eq=False)
class Mesh:
    """T triangles over V vertices."""

    vertices: Floats
    """(V, 3) metres, world frame"""
    triangles: NDArray[np.uint32]
    """(T, 3) rows of :attr:`vertices`, counter-clockwise seen from outside"""
    uv: Floats
    """(T, 3, 2) surface coordinates of the corners in metres, so that textures have the same density everywhere"""
    material: Bytes
    """(T,) :class:`Material`"""
    semantic: Bytes
    """(T,) :class:`Semantic`"""
    instance: NDArray[np.uint32]
    """(T,) number of the object, such as one building, car or tree; unique in a district, 0 is the ground"""
    variant: NDArray[np.uint32]
    """(T,) seed of the object's look (colour, pattern)"""
    rank: Floats
    """(T,) in [0, 1]: a leaf is present if the foliage exceeds its rank; 0 for everything else"""

    def __len__(self) -> int:
        return len(self.triangles)

    def select(self, keep: Mask) -> Mesh:
        """The mesh with the marked triangles (T,) only; all vertices remain."""
        return Mesh(self.vertices, self.triangles[keep], *(getattr(self, name)[keep] for name in _OF_TRIANGLES))


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """Concatenate meshes; instance numbers are not changed."""
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes)])[:-1]
    return Mesh(
        np.concatenate([m.vertices for m in meshes]).astype(np.float32),
        np.concatenate([m.triangles + np.uint32(o) for m, o in zip(meshes, offsets, strict=True)]).astype(np.uint32),
        *(np.concatenate([getattr(m, name) for m in meshes]) for name in _OF_TRIANGLES),
    )
