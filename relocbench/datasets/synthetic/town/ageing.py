"""How a street changes over months: which objects have changed, come or gone, and the meshes that follow.

Of each kind of object, the share that has changed after ``m`` months is ``limit (1 - exp(-m / time))``
(:class:`Course`). Every object has a number in [0, 1), drawn from the district's seed by the kind of change and the
object's index, and has changed when the share exceeds it. What has changed after six months therefore has changed after
twelve, too, and looks the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property

import numpy as np

from relocbench.arrays import Array, Indices, Mask
from relocbench.datasets.synthetic.town.furniture import wheeled_bin
from relocbench.datasets.synthetic.town.houses.house import door_x
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic
from relocbench.datasets.synthetic.town.rows import Plot
from relocbench.datasets.synthetic.town.shapes import Shape, instances, poses
from relocbench.datasets.synthetic.town.vegetation import crown
from relocbench.datasets.synthetic.town.works import container, patch, roadworks, scaffold


class Change(IntEnum):
    """What can happen to an object; the number chooses its stream of random numbers."""

    PARKED_ANEW = 0
    """bay: another car, or none"""
    REPAINTED = 1
    """house: its walls have a colour of :attr:`Material.PAINTED_WALL`"""
    OTHER_SHOP = 2
    """house: signs, awnings, windows and frames of its shops"""
    OTHER_DOOR = 3
    """house: its doors"""
    SCAFFOLDED = 4
    """house: a scaffold before its front"""
    BINS_CAME = 5
    """house: bins beside its door"""
    BIN_MOVED = 6
    """bin: it is gone, or stands a step away"""
    DUG_UP = 7
    """bay or free place of a pavement: roadworks"""
    CONTAINER_CAME = 8
    """bay: a container for rubble"""
    RELAID = 9
    """place in a lane: a patch of new asphalt"""
    TRIMMED = 10
    """tree at a street: the outer part of its crown is cut off"""
    FELLED = 11
    """tree at a street: it is gone"""


@dataclass(frozen=True)
class Course:
    """How the share of changed objects grows."""

    limit: float
    """the share after a very long time"""
    time: float
    """months after which 63 % of the limit are reached"""

    def share(self, months: float) -> float:
        """``limit (1 - exp(-months / time))``."""
        return self.limit * -float(np.expm1(-months / self.time))


COURSES: dict[Change, Course] = {
    Change.PARKED_ANEW: Course(1.0, 0.5),
    Change.REPAINTED: Course(0.7, 24.0),
    Change.OTHER_SHOP: Course(0.9, 24.0),
    Change.OTHER_DOOR: Course(0.7, 24.0),
    Change.SCAFFOLDED: Course(0.15, 12.0),
    Change.BINS_CAME: Course(0.3, 4.0),
    Change.BIN_MOVED: Course(0.9, 2.0),
    Change.DUG_UP: Course(0.12, 12.0),
    Change.CONTAINER_CAME: Course(0.06, 12.0),
    Change.RELAID: Course(0.6, 18.0),
    Change.TRIMMED: Course(0.6, 18.0),
    Change.FELLED: Course(0.2, 24.0),
}

_CAME = 2**30 + 2**23
"""instance numbers of things that came: this, plus 2^16 times the change, plus the object's index"""
_SHOP_VARIANTS = np.array([0x71 + 257 * n for n in range(16)], dtype=np.uint32)
"""variants of shop fronts within their house"""
_GONE_BINS = 0.4
"""share of the moved bins that are gone"""
_STEP_M = 0.45
"""farthest that a bin is moved along each axis"""
_CROWN = 0.68
"""size of a trimmed crown relative to the whole one"""
_STEM_M = 0.35
"""radius around the trunk's foot in which wood below the crown is kept"""
_LEAST_SCAFFOLD_M = 4.0
"""width of the narrowest house that gets a scaffold"""
_FIRST = np.zeros(1, dtype=np.int64)
_BAY_WORKS_M = (5.2, 2.0)
_PAVEMENT_WORKS_M = (3.6, 1.3)


@dataclass(frozen=True, eq=False)
class Rows:
    """N objects of one kind."""

    names: Indices
    """(N,) instance numbers"""
    transforms: Array
    """(N, 4, 4) ``T_world_object``, with scale"""
    kinds: Indices
    """(N,)"""


def no_rows() -> Rows:
    """None of a kind."""
    return together([])


def together(rows: Sequence[Rows]) -> Rows:
    """All of them as objects of one kind."""
    return Rows(
        np.concatenate([np.zeros(0, dtype=np.int64), *(r.names for r in rows)]),
        np.concatenate([np.zeros((0, 4, 4)), *(r.transforms for r in rows)]),
        np.concatenate([np.zeros(0, dtype=np.int64), *(r.kinds for r in rows)]),
    )


@dataclass(frozen=True, eq=False)
class Inventory:
    """The objects of a district that can change."""

    key: tuple[int, ...]
    """of the random streams: the district's seed and the number of its split"""
    houses: tuple[tuple[int, Plot], ...]
    """instance number and place; the halves of a corner house have the same number"""
    trees: Rows
    """those along streets and in front gardens"""
    bins: Rows
    """bins of households on pavements"""
    bays: Array
    """(B, 4, 4) poses of the parking bays"""
    pavements: Array
    """(P, 4, 4) free places on pavements without a parking lane: x along the kerb, z up from the pavement"""
    lanes: Array
    """(L, 4, 4) places in the middle of lanes: x along the lane, z up from the road"""

    def draw(self, change: Change) -> np.random.Generator:
        """The random stream of a change."""
        return np.random.default_rng([*self.key, 6, int(change)])

    def happened(self, change: Change, count: int, months: float) -> Mask:
        """Mask (count,) of the objects to which it has happened."""
        return np.asarray(self.draw(change).random(count) < COURSES[change].share(months))

    def parked_anew(self, months: float) -> Mask:
        """Mask (B,) of the bays in which another car is parked than at first, or none."""
        return self.happened(Change.PARKED_ANEW, len(self.bays), months)

    def out_of_use(self, months: float) -> Mask:
        """Mask (B,) of the bays that roadworks or containers take."""
        return np.asarray(self._dug_up(months)[: len(self.bays)] | self._containers(months))

    def aged(self, mesh: Mesh, months: float) -> Mesh:
        """The mesh of what was built, or of its leaves, without what is gone and in its new colours."""
        return self._in_new_colours(mesh, months).select(self._kept(mesh, months))

    def came(self, months: float) -> list[Mesh]:
        """The meshes of what came: scaffolds, bins, roadworks, containers and patches of asphalt."""
        bays = len(self.bays)
        dug = self._dug_up(months)
        in_bays, on_pavements = np.flatnonzero(dug[:bays]), np.flatnonzero(dug[bays:])
        return [
            *self._scaffolds(months),
            *self._bins(months),
            *_stand(roadworks(*_BAY_WORKS_M), self.bays, in_bays, Change.DUG_UP),
            *_stand(roadworks(*_PAVEMENT_WORKS_M), self.pavements, on_pavements, Change.DUG_UP, bays),
            *_stand(container(), self.bays, np.flatnonzero(self._containers(months)), Change.CONTAINER_CAME),
            *self._patches(months),
        ]

    @cached_property
    def _numbers(self) -> tuple[Indices, Indices]:
        """The houses' instance numbers (H,) in ascending order, and the row in it of each of :attr:`houses`."""
        numbers, rows = np.unique([name for name, _ in self.houses], return_inverse=True)
        return numbers, rows.ravel()

    def _houses(self, change: Change, months: float) -> Mask:
        """Mask (H,) of the houses to which it has happened."""
        return self.happened(change, len(self._numbers[0]), months)

    def _dug_up(self, months: float) -> Mask:
        """Mask (B + P,) of the bays and places on pavements that are dug up."""
        return self.happened(Change.DUG_UP, len(self.bays) + len(self.pavements), months)

    def _containers(self, months: float) -> Mask:
        """Mask (B,) of the bays with a container; none comes to where roadworks will be."""
        came = self.happened(Change.CONTAINER_CAME, len(self.bays), months)
        return np.asarray(came & ~self._dug_up(np.inf)[: len(self.bays)])

    def _in_new_colours(self, mesh: Mesh, months: float) -> Mesh:
        """The mesh with other materials and variants on repainted walls, shop fronts and doors."""
        numbers, rows = self._numbers
        looks, walls = np.zeros((2, len(numbers)), dtype=np.int64)
        looks[rows] = [plot.house.variant for _, plot in self.houses]
        walls[rows] = [int(plot.house.front.wall) for _, plot in self.houses]
        place = np.full(int(mesh.instance.max(initial=0)) + 2, len(numbers))
        place[numbers[numbers < len(place)]] = np.flatnonzero(numbers < len(place))
        house = place[mesh.instance]
        of_shop = np.isin(mesh.material, (Material.SHOP_SIGN, Material.SHOP_WINDOW, Material.AWNING))
        of_shop |= (mesh.material == Material.WOOD) & np.isin(mesh.variant ^ np.append(looks, 0)[house], _SHOP_VARIANTS)
        material, variant = mesh.material.copy(), mesh.variant.copy()
        for change, surface in (
            (Change.REPAINTED, mesh.material == np.append(walls, -1)[house]),
            (Change.OTHER_SHOP, of_shop),
            (Change.OTHER_DOOR, mesh.material == Material.DOOR),
        ):
            salts = np.random.default_rng([*self.key, 7, int(change)]).integers(1, 2**31, len(numbers))
            salt = np.append(np.where(self._houses(change, months), salts, 0), 0)[house]
            variant[surface] ^= salt[surface].astype(np.uint32)
            if change is Change.REPAINTED:
                material[surface & (salt > 0)] = Material.PAINTED_WALL
        return replace(mesh, material=material, variant=variant)

    def _kept(self, mesh: Mesh, months: float) -> Mask:
        """Mask (T,) of the triangles that are left of felled and trimmed trees and moved bins, and of all else."""
        felled = self.happened(Change.FELLED, len(self.trees.names), months)
        moved = self.happened(Change.BIN_MOVED, len(self.bins.names), months)
        kept = ~np.isin(mesh.instance, np.concatenate([self.trees.names[felled], self.bins.names[moved]]))
        trimmed = self.happened(Change.TRIMMED, len(self.trees.names), months) & ~felled
        rows = np.flatnonzero(np.isin(mesh.instance, self.trees.names[trimmed]))
        order = np.argsort(self.trees.names)
        tree = order[np.searchsorted(self.trees.names[order], mesh.instance[rows])]
        T_world_tree = self.trees.transforms[tree]
        offset = mesh.vertices[mesh.triangles[rows]] - T_world_tree[:, None, :3, 3]
        size = np.linalg.norm(T_world_tree[:, :3, 0], axis=1)[:, None]
        aside, up = np.hypot(offset[..., 0], offset[..., 1]) / size, offset[..., 2] / size
        low, high, spread = np.array([crown(kind) for kind in self.trees.kinds]).reshape(-1, 3)[tree].T[..., None]
        middle, half = low + _CROWN * (high - low) / 2, _CROWN * (high - low) / 2 + 0.3
        inside = (aside / (_CROWN * spread)) ** 2 + ((up - middle) / half) ** 2 <= 1
        kept[rows] = (inside | ((aside < _STEM_M) & (up < middle + half))).all(axis=1)
        return np.asarray(kept)

    def _scaffolds(self, months: float) -> Iterator[Mesh]:
        rows = self._numbers[1]
        rng = np.random.default_rng([*self.key, 7, int(Change.SCAFFOLDED)])
        sheets = rng.random((len(self._numbers[0]), 13))
        for k in np.flatnonzero(self._houses(Change.SCAFFOLDED, months)[rows]):
            plot = self.houses[k][1]
            if _takes_scaffold(plot):
                cloth = sheets[rows[k]] if sheets[rows[k], 0] < 0.5 else None
                shape = scaffold(plot.width, plot.house.wall_m, cloth)
                yield from _stand(shape, plot.T_world_house[None], _FIRST, Change.SCAFFOLDED, int(rows[k]))

    def _bins(self, months: float) -> Iterator[Mesh]:
        """Bins that were moved, and those that came to houses."""
        rng = np.random.default_rng([*self.key, 7, int(Change.BIN_MOVED)])
        count = len(self.bins.names)
        shift, gone = rng.uniform(-_STEP_M, _STEP_M, (count, 2)), rng.random(count) < _GONE_BINS
        there = self.bins.transforms @ poses(0.0, shift[:, 0], 0.0, 4 * shift[:, 1])
        moved = np.flatnonzero(self.happened(Change.BIN_MOVED, count, months) & ~gone)
        yield from _stand(wheeled_bin(), there, moved, Change.BIN_MOVED, semantic=Semantic.FURNITURE)
        rows = self._numbers[1]
        at_door = self._houses(Change.BINS_CAME, months) & ~self._houses(Change.SCAFFOLDED, np.inf)
        for k in np.flatnonzero(at_door[rows]):
            plot = self.houses[k][1]
            x = door_x(plot.house, plot.width)
            x += 1.35 if x < plot.width / 2 else -1.35
            if 0.6 < x < plot.width - 0.6 and not plot.house.shop and plot.house.bays == 0:
                place = plot.T_world_house @ poses(x, -0.5, 0.0, -np.pi / 2)
                yield from _stand(
                    wheeled_bin(), place, _FIRST, Change.BINS_CAME, int(rows[k]), semantic=Semantic.FURNITURE
                )

    def _patches(self, months: float) -> Iterator[Mesh]:
        rng = np.random.default_rng([*self.key, 7, int(Change.RELAID)])
        sizes = rng.uniform([1.2, 0.7, -0.5], [6.5, 1.7, 0.5], (len(self.lanes), 3))
        for k in np.flatnonzero(self.happened(Change.RELAID, len(self.lanes), months)):
            length, width, aside = sizes[k]
            shape = patch(float(length), float(width))
            look = np.array([_variant(Change.RELAID, int(k))])
            yield instances(shape, self.lanes[k] @ poses(0.0, aside, 0.0, 0.0), np.zeros(1), look, Semantic.ROAD)


def _takes_scaffold(plot: Plot) -> bool:
    """Whether a scaffold can stand before a house: nothing reaches out of its wall, and it is not at a corner."""
    house = plot.house
    plain = house.front.balconies == 0 and house.bays == 0 and not (house.shop and house.awning)
    return plain and plot.corner < 0 and plot.width >= _LEAST_SCAFFOLD_M


def _variant(change: Change, index: int) -> int:
    return 1 + int(change) * 65537 + 7919 * index


def _stand(
    shape: Shape,
    places: Array,
    chosen: Indices,
    change: Change,
    first: int = 0,
    semantic: Semantic = Semantic.WORKS,
) -> Iterator[Mesh]:
    """Copies of a shape at the ``chosen`` rows of places (N, 4, 4), of which the first is object ``first``."""
    if len(chosen):
        names = _CAME + 2**16 * int(change) + first + chosen
        looks = np.array([_variant(change, first + int(k)) for k in chosen])
        yield instances(shape, places[chosen], names, looks, semantic)
