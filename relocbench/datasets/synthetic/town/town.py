"""Districts from seeds, and their meshes in a condition: static objects, foliage, and parked and moving cars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.conditions.presets import SPLITS
from relocbench.datasets.synthetic.town.ageing import Inventory, together
from relocbench.datasets.synthetic.town.cars import cars
from relocbench.datasets.synthetic.town.crossings import equip_crossings
from relocbench.datasets.synthetic.town.footpaths import Footpath, make_footpaths
from relocbench.datasets.synthetic.town.ground import ground
from relocbench.datasets.synthetic.town.mesh import Mesh, Semantic, merge
from relocbench.datasets.synthetic.town.moving import Moving, moving_mesh
from relocbench.datasets.synthetic.town.network import LANE_M, StreetNetwork, make_network
from relocbench.datasets.synthetic.town.planting import (
    Planting,
    free_places,
    line_streets,
    plant_gardens,
    plant_outskirts,
    plant_square,
)
from relocbench.datasets.synthetic.town.polylines import edge_frame
from relocbench.datasets.synthetic.town.rows import PeriodicFront, Plot, build, plots_of
from relocbench.datasets.synthetic.town.shapes import poses
from relocbench.datasets.synthetic.town.skyline import skyline
from relocbench.datasets.synthetic.town.streets import Block, bays_of, make_blocks, periodic_street
from relocbench.datasets.synthetic.town.wires import string_wires
from relocbench.errors import ConfigError, available

SMALLEST_M = 180.0
_SKYLINE = 12
"""the part of a district's stream of random numbers from which what lies outside is drawn"""
_OUTERMOST_M = 40.0
"""from the outer streets to behind the outermost houses"""
_SEEDS_OF_CARS = 2**20
_OF_LIFE = 8
"""number of the random stream of traffic lights and wires"""
_PARKED_ANEW = 4096
"""added to ``parked_seed`` for the cars that come over months"""
_RELAID_FROM_M, _RELAID_EVERY_M = 16.0, 9.0
"""distance of new patches of asphalt from crossings and bends, and from each other"""


@dataclass(frozen=True, eq=False)
class Periodic:
    """The street with repeating facades, along which places a whole number of periods apart look alike."""

    street: int
    """id in the network; :attr:`Path.streets` has the sections where a drive follows it"""
    fronts: tuple[PeriodicFront, ...]
    """the rows of houses on its two sides"""


@dataclass(frozen=True, eq=False)
class District:
    """A piece of town. Districts of different seeds or splits share no street."""

    seed: int
    split: str
    static: Mesh
    """ground, roads, markings, houses, street furniture, and the wood of trees and hedges"""
    foliage: Mesh
    """leaves with their ranks"""
    bays: Array
    """(N, 4, 4) T_world_bay: x along a parked car, z up, origin on the road in the middle of the bay"""
    lamps: Array
    """(L, 3) positions of lamp heads"""
    network: StreetNetwork
    periodic: Periodic
    footpaths: tuple[Footpath, ...]
    inventory: Inventory
    """what changes over months"""
    first_car: int
    """smallest instance number of a car"""


def make_district(seed: int, split: str = "test", extent_m: float = 250.0) -> District:
    """Make the district of a seed and split in a square of ``extent_m``; the same arguments give the same bytes.

    Raises:
        ConfigError: the split is unknown, the seed is negative, or the extent is below 180 m.
    """
    if split not in SPLITS:
        raise ConfigError(f"no split '{split}'{available(split, SPLITS)}")
    if seed < 0:
        raise ConfigError(f"the seed of a district must not be negative, got {seed}")
    if not extent_m >= SMALLEST_M:
        raise ConfigError(f"a district must be at least {SMALLEST_M:.0f} m wide, got {extent_m}")
    streams = [np.random.default_rng([seed, SPLITS.index(split), part]) for part in (0, 1, 2, 3, _OF_LIFE)]
    network = make_network(streams[0], extent_m)
    repeated = periodic_street(network)
    blocks = make_blocks(network, streams[1], repeated)
    names = count(1)
    meshes = [ground(network, blocks)]
    planting = Planting(streams[3], names)
    fronts: list[PeriodicFront] = []
    houses: list[tuple[int, Plot]] = []
    plots_in: dict[int, list[Plot]] = {}
    for number, block in enumerate(blocks):
        plots, rows = plots_of(block, streams[2])
        plots_in[number] = plots
        fronts += rows
        built = build(plots, names)
        meshes += built
        houses += [(int(mesh.instance[0]), plot) for mesh, plot in zip(built, plots, strict=True)]
        line_streets(planting, network, block, fronts[0].start if fronts else None)
        equip_crossings(planting, network, block, streams[4])
        plant_gardens(planting, block, plots)
        if block.kind == "square":
            plant_square(planting, block)
        elif block.kind == "outside":
            plant_outskirts(planting, block)
    pavements = [place for block in blocks for place in free_places(network, block, planting.places())]
    static, foliage = planting.finish()
    static += string_wires(network, blocks, plots_in, names, streams[4])
    bays = _bays(network, blocks)
    far = np.random.default_rng([seed, SPLITS.index(split), _SKYLINE])
    edge_m = float(np.linalg.norm(network.nodes, axis=1).max()) + _OUTERMOST_M
    land, woods = skyline(far, edge_m, names)
    return District(
        seed,
        split,
        merge([*meshes, *static, land]),
        merge([*foliage, woods]),
        bays,
        np.array(planting.lamps).reshape(-1, 3),
        network,
        Periodic(repeated, tuple(fronts)),
        make_footpaths(network, blocks),
        Inventory(
            (seed, SPLITS.index(split)),
            tuple(houses),
            together(planting.near),
            planting.bins,
            bays,
            np.array(pavements).reshape(-1, 4, 4),
            _lane_places(network),
        ),
        next(names),
    )


def _bays(network: StreetNetwork, blocks: Sequence[Block]) -> Array:
    """Poses (N, 4, 4) of the parking bays of all blocks."""
    found = [bay for block in blocks for bay in bays_of(network, block)]
    place = np.array([p for p, _ in found]).reshape(-1, 2)
    direction = np.array([d for _, d in found]).reshape(-1, 2)
    return poses(place[:, 0], place[:, 1], 0.0, np.arctan2(direction[:, 1], direction[:, 0]))


def _lane_places(network: StreetNetwork) -> Array:
    """Poses (N, 4, 4) in the middle of lanes, x along the lane, away from crossings and bends."""
    found = []
    for u, v in sorted(network.street):
        d, inward, length = edge_frame(network.nodes[u], network.nodes[v])
        for s in np.arange(_RELAID_FROM_M, length - _RELAID_FROM_M, _RELAID_EVERY_M):
            place = network.nodes[u] + s * d + LANE_M / 2 * inward
            found.append(poses(place[0], place[1], 0.0, np.arctan2(d[1], d[0])))
    return np.concatenate([np.zeros((0, 4, 4)), *found])


def compose(district: District, factors: Factors, moving: Sequence[Moving] = ()) -> Mesh:
    """The mesh of a district under the factors: static objects first, then leaves, parked cars, and what moves.

    With ``factors.months``, what came over the months stands between leaves and cars.
    Leaves are present if their rank is below ``factors.foliage``. Instance numbers of parked cars depend on the bay and
    on ``parked_seed``, so that a different car in the same bay is a different object; those of what moves start at
    2**31.
    """
    shown = district.foliage.rank < factors.foliage
    parts = [district.static, *([district.foliage.select(shown)] if shown.any() else [])]
    if factors.months > 0:
        aged = [district.inventory.aged(part, factors.months) for part in parts]
        parts = [*aged, *district.inventory.came(factors.months)]
    return merge([*parts, *_parked(district, factors), moving_mesh(moving)])


def _parked(district: District, factors: Factors) -> list[Mesh]:
    """The parked cars; over months other cars than the first come to bays, and works take some of them."""
    everywhere = np.ones(len(district.bays), dtype=bool)
    if factors.months == 0:
        return _cars_of(district, factors.parked_seed, factors.parked_share, everywhere)
    free = ~district.inventory.out_of_use(factors.months)
    anew = district.inventory.parked_anew(factors.months)
    return [
        *_cars_of(district, factors.parked_seed, factors.parked_share, free & ~anew),
        *_cars_of(district, factors.parked_seed + _PARKED_ANEW, factors.parked_share, free & anew),
    ]


def _cars_of(district: District, parked_seed: int, share: float, allowed: Mask) -> list[Mesh]:
    """Parked cars in the first ``share`` of the bays in a random order, each slightly askew, where ``allowed`` (B,)."""
    bays = len(district.bays)
    rng = np.random.default_rng([district.seed, SPLITS.index(district.split), 5, parked_seed])
    variant = rng.integers(1, 2**31, bays)
    shift = rng.uniform([-0.35, -0.1], [0.35, 0.1], (bays, 2))
    yaw = rng.normal(0, 0.015, bays).clip(-0.04, 0.04) + np.pi * (rng.random(bays) < 0.08)
    taken = np.sort(rng.permutation(bays)[: round(share * bays)])
    taken = taken[allowed[taken]]
    if len(taken) == 0:
        return []
    askew = poses(shift[:, 0], shift[:, 1], 0.0, yaw)
    name = district.first_car + taken + bays * (parked_seed % _SEEDS_OF_CARS)
    return [cars((district.bays @ askew)[taken], variant[taken], name, Semantic.PARKED_CAR)]
