"""Selection of the buildings of a town that become places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.datasets.synthetic.town.mesh import Semantic
from relocbench.datasets.synthetic.town.polylines import inside
from relocbench.datasets.synthetic.town.rows import PeriodicFront
from relocbench.datasets.synthetic.town.town import District

_LEAST_FOOTPRINT_M = 4.5
"""least shorter side of a building that is a place; excludes the links between houses"""
_FROM_PERIODIC_M = 14.0
"""distance to keep from rows with repeating facades, whose houses are copies of one model and indistinguishable"""


@dataclass(frozen=True, eq=False)
class Building:
    """The bounding box of a house."""

    instance: int
    """instance number in the town"""
    centre: Array
    """(2,) metres"""
    sides_m: Array
    """(2,) along x and y"""
    height_m: float


@dataclass(frozen=True, eq=False)
class PlaceOfTown:
    """One class of the set."""

    label: str
    """the folder's name, four digits"""
    town: DistrictSpec
    building: Building
    distractor: bool = False
    """whether it is in galleries only"""


def buildings(district: District, *, every: bool = False) -> list[Building]:
    """The houses of a town that can be places, or ``every`` house, ordered by instance number.

    Houses beyond the outer streets are excluded, because half of their surroundings is open land.
    """
    mesh = district.static
    chosen = mesh.semantic == Semantic.BUILDING
    names, index = np.unique(mesh.instance[chosen], return_inverse=True)
    low, high = np.full((len(names), 3), np.inf), np.full((len(names), 3), -np.inf)
    corners = mesh.vertices[mesh.triangles[chosen]].astype(np.float64)
    np.minimum.at(low, index, corners.min(axis=1))
    np.maximum.at(high, index, corners.max(axis=1))
    middle, size = (low + high) / 2, high - low
    found = [Building(int(name), middle[k, :2], size[k, :2], float(high[k, 2])) for k, name in enumerate(names)]
    if every:
        return found
    roomy = size[:, :2].min(axis=1) >= _LEAST_FOOTPRINT_M
    for front in district.periodic.fronts:
        roomy &= _distance(middle[:, :2], front) > _FROM_PERIODIC_M
    streets = district.network.nodes[list(district.network.faces[-1])]
    return [found[k] for k in np.flatnonzero(roomy) if inside(streets, found[k].centre)]


def spread(found: list[Building], spacing_m: float, rng: np.random.Generator) -> list[Building]:
    """Buildings in random order, leaving out those nearer than the spacing to an earlier one."""
    chosen: list[Building] = []
    for k in rng.permutation(len(found)):
        if all(np.hypot(*(found[k].centre - other.centre)) >= spacing_m for other in chosen):
            chosen.append(found[k])
    return chosen


def _distance(points: Array, front: PeriodicFront) -> Array:
    """Distances (N,) of points (N, 2) from the row's line of facades."""
    along = front.end - front.start
    t = np.clip((points - front.start) @ along / float(along @ along), 0, 1)
    return np.asarray(np.linalg.norm(points - front.start - t[:, None] * along, axis=1))
