"""The lidars of one drive against each other: where the car turns, extrinsics that are far off put a street twice.

Each lidar passes the same walls at another time. With the right extrinsics what one of them measured lies on what the
others did. If one is turned by 180 degrees, it does not anywhere; if all are, it does on straight roads, but not where
the car turns. Small errors are estimated later (:mod:`relocbench.datasets.groundtruth.calibration`).
"""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.groundtruth.blocks.blocks import Block, Nodes
from relocbench.datasets.groundtruth.blocks.store import BlockStore
from relocbench.datasets.groundtruth.registration.mounts import remounted
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap
from relocbench.datasets.groundtruth.submaps.submaps import SubmapWindow
from relocbench.datasets.groundtruth.verification.alternatives import ShiftOptions, fit
from relocbench.geometry import invert, rotation_angle

_PLACES = 3
"""where the car turns most, so many places are looked at"""
_APART_M = 6.0
"""least distance between them"""
_HALF_M = 15.0
"""half of the road of each"""
_TURN_M = 10.0
"""the turn of a place is that from so far before to so far behind"""
_AGREE = 0.6
"""share of surfaces that fit from which on nothing is wrong; 0.8 do in streets"""
_LEAST, _TIMES = 0.45, 1.3
"""least share that must fit with another mount, and how many times what fits with the given one"""


def contradicting_mount(drive: Drive) -> str:
    """With which other mount the lidars of a drive would agree, in words; empty if they do, or if there is one alone.

    Raises DatasetError if a block is missing or damaged.
    """
    if len(drive.recording.lidars) < 2:
        return ""
    places = sharpest_places(drive.nodes)
    given = np.array([_agreement(drive.store(), drive.nodes, node) for node in places])
    doubtful = given < _AGREE
    if 2 * np.count_nonzero(doubtful) <= len(places):
        return ""
    best, words = 0.0, ""
    for name, store in remounted(drive):
        fits = np.array([_agreement(store, drive.nodes, node) for node in places])
        better: Mask = doubtful & (fits >= np.maximum(_LEAST, _TIMES * given))
        if 2 * np.count_nonzero(better) > len(places) and float(fits[better].mean()) > best:
            best, words = float(fits[better].mean()), name
    return words and (
        f"{100 * given[doubtful].mean():.0f} % of what one lidar of {drive.name} measured fits what others did, and "
        f"{100 * best:.0f} % with {words}: the extrinsics are wrong"
    )


def sharpest_places(nodes: Nodes) -> list[int]:
    """The nodes around which the car turns most, apart from each other."""
    way, segments = nodes.travelled_m, nodes.segments()
    turns = np.zeros(len(nodes))
    for node in range(len(nodes)):
        near = np.flatnonzero((np.abs(way - way[node]) <= _TURN_M) & (segments == segments[node]))
        T = invert(nodes.T_odom_node[near[0]]) @ nodes.T_odom_node[near[-1]]
        turns[node] = rotation_angle(T[:3, :3])
    chosen: list[int] = []
    for node in np.argsort(-turns, kind="stable").tolist():
        if len(chosen) < _PLACES and all(abs(way[node] - way[other]) >= _APART_M for other in chosen):
            chosen.append(node)
    return chosen


def _agreement(store: BlockStore, nodes: Nodes, node: int) -> float:
    """Share of the first lidar's surfaces around a node that lie on those of the others, and of those on its own."""
    one, others = (PlaneMap(SubmapWindow(nodes, _Part(store, first), _HALF_M).at(node)) for first in (True, False))
    if not len(one) or not len(others):
        return 1.0
    same: Array = np.eye(4)
    return (fit(one, others, same, ShiftOptions()) + fit(others, one, same, ShiftOptions())) / 2


class _Part(BlockStore):
    """The blocks of the first lidar, or of all others."""

    def __init__(self, store: BlockStore, first: bool) -> None:
        super().__init__(store.folder)
        self._store, self._first = store, first

    def get(self, node: int) -> Block:
        """The part of a block. Raises DatasetError with the file if it is missing or damaged."""
        block = self._store.get(node)
        own = np.zeros(len(block), bool) if block.lidar is None else (block.lidar == 0) == self._first
        return Block(*(getattr(block, name)[own] for name in ("points", "normals", "origins", "surface", "steady")))
