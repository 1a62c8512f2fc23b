"""What moves in a town: where it is at one moment, and the mesh of all of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import IntEnum
from functools import partial
from typing import NamedTuple

import numpy as np

from relocbench.arrays import Array, Bytes, Indices, Mask
from relocbench.datasets.synthetic.town.cars import cars
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic, merge
from relocbench.datasets.synthetic.town.people import riders, standers, walkers
from relocbench.datasets.synthetic.town.shapes import quads, single

_FIRST_INSTANCE = 2**31
"""instance numbers of things that move: this, plus the seed of their look"""


class Kind(IntEnum):
    """What it is."""

    CAR = 0
    WALKER = 1
    STANDER = 2
    """a person who stands where others walk"""
    RIDER = 3
    """on a bicycle"""
    SHELTERED = 4
    """a walker with an umbrella"""


class Moving(NamedTuple):
    """One thing that moves, at one moment."""

    T_world_thing: Array
    """(4, 4) x forward, z up, origin on the ground"""
    variant: int
    """seed of its look, below 2**31; tells it from all others of a drive"""
    kind: Kind = Kind.CAR


Maker = Callable[[Array, Indices, Indices, Semantic], Mesh]
"""makes things from poses (N, 4, 4), variants (N,) and instance numbers (N,)"""

_MAKERS: dict[Kind, tuple[Maker, Semantic]] = {
    Kind.CAR: (cars, Semantic.MOVING_CAR),
    Kind.WALKER: (walkers, Semantic.PERSON),
    Kind.STANDER: (standers, Semantic.PERSON),
    Kind.RIDER: (riders, Semantic.CYCLIST),
    Kind.SHELTERED: (partial(walkers, umbrella=True), Semantic.PERSON),
}
_CLASSES = tuple(int(semantic) for _, semantic in _MAKERS.values())


def moves(semantic: Bytes) -> Mask:
    """Whether each of these semantic classes is one of things that move."""
    return np.isin(semantic, _CLASSES)


def moving_mesh(things: Sequence[Moving]) -> Mesh:
    """The mesh of what moves, without triangles if nothing does."""
    parts = [_NOTHING]
    for kind, (make, semantic) in _MAKERS.items():
        chosen = [thing for thing in things if thing.kind == kind]
        if chosen:
            transforms = np.stack([np.asarray(thing.T_world_thing, dtype=float) for thing in chosen])
            variants = np.array([thing.variant for thing in chosen])
            parts.append(make(transforms, variants, _FIRST_INSTANCE + variants, semantic))
    return merge(parts)


_NOTHING = single(quads(np.zeros((0, 4, 3)), Material.CAR_PAINT), 0, 0, Semantic.NONE)
