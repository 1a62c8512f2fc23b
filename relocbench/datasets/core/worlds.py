"""Which traversals share a world: drives of one road may each have poses in a frame of their own.

Pairs tell. Where the true pose of a pair and the poses of both traversals say the same, the two are shown in one
world; else each is shown in its own, and queries stand where the truth puts them beside their keyframe.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.geometry import invert, rotation_angle

_ALIKE_M = 0.5
_ALIKE_RAD = np.radians(5.0)
"""greatest medians by which poses and truth may differ in one world: odometry drifts, other frames are far off"""
_MOST = 200
"""pairs of a set that are looked at"""


def world_of_traversals(dataset: Dataset, pair_sets: Iterable[PairSet]) -> dict[str, str]:
    """For each traversal of these pair sets, the name of the world: that of the first traversal which shares it."""
    sets = list(pair_sets)
    of = {name: name for s in sets for name in (s.reference, s.query)}
    for pair_set in sets:
        ref, query = of[pair_set.reference], of[pair_set.query]
        if ref != query and share_a_world(dataset, pair_set):
            of = {name: ref if world == query else world for name, world in of.items()}
    return of


def share_a_world(dataset: Dataset, pair_set: PairSet) -> bool:
    """Whether the poses of both traversals agree with the true poses of their pairs, in the median."""
    ref, query = dataset.traversal(pair_set.reference), dataset.traversal(pair_set.query)
    posed = [p for p in pair_set.pairs if p.ref_timestamp_ns in ref.poses and p.query_timestamp_ns in query.poses]
    known = [p for p in posed if p.T_query_ref is not None]
    if not known:
        return False
    chosen = [known[i] for i in np.unique(np.linspace(0, len(known) - 1, min(_MOST, len(known))).astype(int))]
    apart = []
    for pair in chosen:
        T_world_ref = ref.T_world_cam(pair_set.camera, pair.ref_timestamp_ns)
        T_world_query = query.T_world_cam(pair_set.camera, pair.query_timestamp_ns)
        assert pair.T_query_ref is not None
        # inv(T_world_ref) T_world_query from poses, and from the truth
        difference = pair.T_query_ref @ invert(T_world_ref) @ T_world_query
        apart.append((float(np.linalg.norm(difference[:3, 3])), float(rotation_angle(difference[:3, :3]))))
    metres, radians = np.median(np.array(apart), axis=0)
    return bool(metres <= _ALIKE_M and radians <= _ALIKE_RAD)
