"""Which traversals share a world: drives of one road may each have poses in a frame of their own.

Pairs tell. Where the true pose of a pair and the poses of both traversals say the same, the two are shown in one
world; else each is shown in its own, and queries stand where the truth puts them beside their keyframe.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.traversal import Traversal
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
    chosen = [known[i] for i in np.unique(np.linspace(0, len(known) - 1, min(_MOST, len(known))).astype(int))]
    if not chosen:
        return False
    metres, radians = np.median(differences(pair_set.cameras, chosen, ref, query), axis=0)
    return bool(metres <= _ALIKE_M and radians <= _ALIKE_RAD)


def differences(cameras: tuple[str, str], pairs: Iterable[Pair], reference: Traversal, query: Traversal) -> Array:
    """Metres and radians (N, 2) by which the poses of two traversals differ from the truth of the pairs that have both.

    N is the number of pairs whose truth is known and whose images have poses.

    Args:
        cameras: of keyframes and of queries.
    """
    apart = []
    for pair in pairs:
        posed = pair.ref_timestamp_ns in reference.poses and pair.query_timestamp_ns in query.poses
        if pair.T_query_ref is not None and posed:
            T_ref_world = invert(reference.T_world_cam(cameras[0], pair.ref_timestamp_ns))
            # inv(T_world_ref) T_world_query from poses, and from the truth
            difference = pair.T_query_ref @ T_ref_world @ query.T_world_cam(cameras[1], pair.query_timestamp_ns)
            apart.append((float(np.linalg.norm(difference[:3, 3])), float(rotation_angle(difference[:3, :3]))))
    return np.array(apart).reshape(-1, 2)
