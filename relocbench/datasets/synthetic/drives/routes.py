"""The routes of a district.

``common`` is the route that all traversals of a dataset follow by default. ``other-lane`` drives along it in the lane
on the left, as a car does that overtakes; ``return`` drives it from its end to its beginning, in that lane; ``detour``
leaves it for other streets and comes back; ``crossing`` passes one of its crossings in another direction; ``periodic``
runs along the street with repeating facades. All of this happens within the driven part
of the path, which begins and ends ``MARGIN_M`` from its ends.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Literal, get_args

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.drives.drive import MARGIN_M
from relocbench.datasets.synthetic.town.network import RUN_IN_M, Path, StreetNetwork
from relocbench.datasets.synthetic.town.polylines import arc_lengths, turns_of
from relocbench.errors import ConfigError

RouteName = Literal["common", "detour", "crossing", "return", "periodic", "other-lane"]
ROUTES: tuple[RouteName, ...] = get_args(RouteName)
_INSIDE_M = 15.0
"""least length driven before leaving the common route or passing the crossing, and after coming back"""
_SHARPEST = np.radians(125)
_LONGEST_DETOUR_M = 320.0
"""greatest length through other streets"""

Street = tuple[int, int]
"""the nodes at its ends, the smaller first"""


def check_routes(names: Sequence[str]) -> None:
    """Raise ConfigError unless there are one or more different routes."""
    if len(set(names)) != len(names) or not names:
        raise ConfigError(f"--route takes one or more different routes, got {','.join(names) or 'none'}")


def route(network: StreetNetwork, periodic: int, name: RouteName, length_m: float, seed: int) -> Path:
    """The path of a route, ``length_m`` metres long; the common one is the network's drive for the seed.

    ``periodic`` is the street with repeating facades.

    Raises:
        ConfigError: no detour or crossing fits into a drive of this length.
    """
    if name == "common":
        return network.drive(length_m, seed)
    if name == "other-lane":
        return network.path(network.walk(length_m, seed), RUN_IN_M, length_m, left_lane=True)
    common = network.walk(length_m + _LONGEST_DETOUR_M, seed)
    if name == "detour":
        return network.path(_detour(network, common, length_m), RUN_IN_M, length_m)
    if name == "return":
        return _back(network, network.walk(length_m, seed), length_m)
    middle = network.nodes_of(periodic)
    if name == "crossing":
        middle = _across(network, common, length_m)
    chain = _extended(network, middle, length_m, _driven(network, common, length_m))
    at = _along(network, chain)
    first = _index_of(chain, middle)
    centre = at[first + 1] if name == "crossing" else (at[first] + at[first + len(middle) - 1]) / 2
    # A path assigns places to streets correctly only if its chain of nodes begins where the path does.
    start = centre - length_m / 2
    skipped = int(np.flatnonzero(at <= start - RUN_IN_M)[-1])
    return network.path(chain[skipped:], start - at[skipped], length_m)


def _back(network: StreetNetwork, common: Sequence[int], length_m: float) -> Path:
    """The path along a walk the other way round, between the places where the walk's own path ends and begins."""
    back = list(common)[::-1]
    start = float(_along(network, back)[-1]) - RUN_IN_M - length_m
    # The other lane is shorter at some bends, so that the walk has to go on beyond its beginning.
    chain = _grown(network, back, 0.0, set())
    at = _along(network, chain)
    skipped = int(np.flatnonzero(at <= max(start - RUN_IN_M, 0.0))[-1])
    return network.path(chain[skipped:], start - at[skipped], length_m)


def _along(network: StreetNetwork, chain: Sequence[int]) -> Array:
    """Distances (N,) of the nodes along the middle of the road."""
    return arc_lengths(network.nodes[list(chain)])


def _street(u: int, v: int) -> Street:
    return (u, v) if u < v else (v, u)


def _driven(network: StreetNetwork, chain: Sequence[int], length_m: float) -> set[Street]:
    """The streets of a walk up to the end of the path."""
    at = _along(network, chain)
    return {_street(u, v) for k, (u, v) in enumerate(pairwise(chain)) if at[k] < RUN_IN_M + length_m}


def _ways_on(network: StreetNetwork, before: int, node: int) -> Iterator[int]:
    """The nodes to which one can continue without turning back or making a hairpin turn."""
    for onward in network.neighbours(node):
        if onward != before and abs(float(turns_of(network.nodes[[before, node, onward]])[0])) < _SHARPEST:
            yield onward


def _detour(network: StreetNetwork, common: Sequence[int], length_m: float) -> list[int]:
    """The walk with a part replaced by other streets.

    Preferred are detours of about the same length as the replaced part and near the middle of the path; a detour may
    also return to an earlier node of the walk.
    """
    at = _along(network, common) - RUN_IN_M
    first, last = MARGIN_M + _INSIDE_M, length_m - MARGIN_M - _INSIDE_M
    taken = _driven(network, common, length_m)
    found: list[tuple[float, list[int]]] = []
    for i in range(1, len(common) - 1):
        if not first <= at[i] <= last:
            continue
        for j, way in _ways_back(network, common, i, taken):
            long = float(_along(network, way)[-1])
            if at[i] + long <= last and MARGIN_M <= at[j] <= last:
                centred = abs(at[i] + long / 2 - length_m / 2)
                chain = [*common[: i + 1], *way[1:-1], *common[j:]]
                found.append((abs(long - (at[j] - at[i])) + 0.2 * centred, chain))
    if not found:
        raise ConfigError(
            f"a route of {length_m - 2 * MARGIN_M:.0f} m has no detour that leaves and rejoins it; increase --steps or "
            "change --seed"
        )
    return min(found)[1]


def _ways_back(
    network: StreetNetwork, common: Sequence[int], i: int, taken: set[Street]
) -> Iterator[tuple[int, list[int]]]:
    """Shortest connections (j, nodes) from node i of a walk to its nodes j over streets that are not ``taken``."""
    start = (common[i - 1], common[i])
    best: dict[tuple[int, int], float] = {start: 0.0}
    before: dict[tuple[int, int], tuple[int, int]] = {}
    waiting = [(0.0, start)]
    while waiting:
        long, edge = heapq.heappop(waiting)
        if long > best[edge]:
            continue
        for onward in _ways_on(network, *edge):
            step = (edge[1], onward)
            reached = long + float(np.linalg.norm(network.nodes[onward] - network.nodes[edge[1]]))
            if _street(*step) in taken or reached > _LONGEST_DETOUR_M or reached >= best.get(step, np.inf):
                continue
            best[step], before[step] = reached, edge
            heapq.heappush(waiting, (reached, step))
    for j in range(1, len(common) - 1):
        ends = [e for e in before if e[1] == common[j] and common[j + 1] in _ways_on(network, *e)]
        if ends:
            edge = min(ends, key=lambda e: (best[e], e))
            way = [edge[1]]
            while edge != start:
                edge = before[edge]
                way.append(edge[1])
            yield j, way[::-1]


def _across(network: StreetNetwork, common: Sequence[int], length_m: float) -> list[int]:
    """Three nodes that pass a crossing of the walk by two streets that the walk does not take, or at least one."""
    at = _along(network, common) - RUN_IN_M
    taken = _driven(network, common, length_m)
    found: list[tuple[int, float, list[int]]] = []
    for k in range(1, len(common) - 1):
        if not MARGIN_M + _INSIDE_M <= at[k] <= length_m - MARGIN_M - _INSIDE_M:
            continue
        node = common[k]
        for before in network.neighbours(node):
            for onward in _ways_on(network, before, node):
                shared = (_street(before, node) in taken) + (_street(node, onward) in taken)
                if shared < 2:
                    found.append((shared, abs(float(at[k]) - length_m / 2), [before, node, onward]))
    if not found:
        raise ConfigError(
            f"a route of {length_m - 2 * MARGIN_M:.0f} m has no crossing with other streets; increase --steps or "
            "change --seed"
        )
    return min(found)[2]


def _extended(network: StreetNetwork, middle: Sequence[int], length_m: float, avoided: set[Street]) -> list[int]:
    """A walk through the nodes ``middle``, extended far enough before and after them, avoiding streets if possible."""
    ahead = _grown(network, middle, length_m, avoided)
    return _grown(network, ahead[::-1], length_m, avoided)[::-1]


def _grown(network: StreetNetwork, chain: Sequence[int], by_m: float, avoided: set[Street]) -> list[int]:
    out, driven = list(chain), dict.fromkeys((_street(u, v) for u, v in pairwise(chain)), 1)
    far = float(_along(network, chain)[-1]) + 0.7 * by_m + 60.0
    while _along(network, out)[-1] < far:
        node = out[-1]
        ways = list(_ways_on(network, out[-2], node)) or [w for w in network.neighbours(node) if w != out[-2]]
        streets = {w: _street(node, w) for w in ways}
        out.append(min(ways, key=lambda w: (2 * driven.get(streets[w], 0) + (streets[w] in avoided), w)))
        driven[streets[out[-1]]] = driven.get(streets[out[-1]], 0) + 1
    return out


def _index_of(chain: Sequence[int], part: Sequence[int]) -> int:
    """The index at which ``part`` begins in the chain; of several, the one nearest to the middle."""
    starts = [k for k in range(len(chain) - len(part) + 1) if list(chain[k : k + len(part)]) == list(part)]
    return min(starts, key=lambda k: abs(k - (len(chain) - len(part)) / 2))
