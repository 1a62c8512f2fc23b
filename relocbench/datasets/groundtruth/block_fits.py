"""How single blocks of two drives fit each other: what the local edges of the graph are made of."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.block_store import BlockStore
from relocbench.datasets.groundtruth.local_edges import LocalFit
from relocbench.datasets.groundtruth.planes import PlaneMap, PlaneOptions
from relocbench.datasets.groundtruth.refinement import Linearised, linearise
from relocbench.datasets.groundtruth.submaps import Submap

Array = NDArray[np.float64]

_OPTIONS = PlaneOptions(thinning_m=(0.0,), reach_m=(0.3,), samples=(1500,), near_m=(1e9,))
_KEPT = 64
_SCALE_M = 0.05
_REACH_M = 0.2


class BlockFits:
    """Distances from points of a query's block to planes of a reference's block.

    Each block's planes and points are made once and kept while neighbours ask for them.
    """

    def __init__(self, reference: BlockStore, query: BlockStore) -> None:
        self._stores = reference, query
        self._kept: OrderedDict[tuple[int, int], PlaneMap] = OrderedDict()

    def __call__(self, ref: int, query: int, T_ref_query: Array, /) -> LocalFit:
        """The fit at a pose ``T_ref_query`` (4, 4), node to node."""
        planes, points = self._planes(0, ref).level(0), self._planes(1, query).sample(0)
        found: Linearised = linearise(
            planes,
            points.points,
            points.normals,
            T_ref_query,
            _REACH_M,
            weights=points.weights,
            scale_m=_SCALE_M,
        )
        sigma = found.sigma_m if found.count else 0.0
        return LocalFit(found.H, found.g, sigma, found.count)

    def _planes(self, side: int, node: int) -> PlaneMap:
        key = side, node
        if key in self._kept:
            self._kept.move_to_end(key)
        else:
            self._kept[key] = PlaneMap(as_submap(self._stores[side], node), _OPTIONS)
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return self._kept[key]


def as_submap(store: BlockStore, node: int) -> Submap:
    """One block on its own."""
    block = store.get(node)
    numbers = np.full(len(block), node, dtype=np.int32)
    return Submap(node, block.points, block.normals, block.origins, block.surface, block.steady, numbers)
