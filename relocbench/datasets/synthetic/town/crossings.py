"""What stands at crossings: traffic lights, and plates with the names of streets."""

from __future__ import annotations

import numpy as np

from relocbench.datasets.synthetic.town import furniture
from relocbench.datasets.synthetic.town.mesh import Semantic
from relocbench.datasets.synthetic.town.network import STOP_M, StreetNetwork
from relocbench.datasets.synthetic.town.planting import Planting
from relocbench.datasets.synthetic.town.polylines import edge_frame
from relocbench.datasets.synthetic.town.streets import Block

_LIGHT_M, _BEFORE_ZEBRA_M = STOP_M - 0.3, STOP_M + 4.4
"""distance of a traffic light from the middle of the crossing, and where there is a zebra before it"""
_FROM_KERB_M = 0.5
_NAMED = 0.55
"""share of the corners with a plate"""


def equip_crossings(planting: Planting, network: StreetNetwork, block: Block, rng: np.random.Generator) -> None:
    """Add traffic lights at a block's corners, if the crossing has them, and plates with names.

    Half of the crossings have lights: those with an even number. Streets that cross have green in turn.
    """
    for i in range(len(block.face)):
        u, v = block.edge(i)
        if network.degree(u) < 3:
            continue
        d, inward, _ = edge_frame(network.nodes[u], network.nodes[v])
        first, _ = block.straight(i, network.nodes[u], d)
        at_kerb = network.nodes[u] + (network.kerb[(u, v)] + _FROM_KERB_M) * inward
        s = max(first + 0.3, _BEFORE_ZEBRA_M if (v, u) in network.zebras else _LIGHT_M)
        look = int(rng.integers(1, 2**31))
        if u % 2 == 0:
            green = bool(abs(d[0]) > abs(d[1])) ^ bool(u % 4)
            planting.add(furniture.traffic_light(green), at_kerb + s * d, d, Semantic.POLE, look)
        if rng.random() < _NAMED:
            place = at_kerb + (max(first + 0.3, _LIGHT_M) + 0.9) * d
            across = network.street[(block.face[i - 1], u)]
            planting.add(furniture.street_name(), place, d, Semantic.SIGN, _look(across))
            planting.add(furniture.street_name(), place, -inward, Semantic.SIGN, _look(network.street[(u, v)]))


def _look(street: int) -> int:
    """The look of all plates of a street."""
    return 1 + 7919 * street
