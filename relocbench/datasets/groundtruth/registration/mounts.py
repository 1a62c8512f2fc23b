"""Lidars that are mounted otherwise than the extrinsics say, found by what fits the other drive.

Extrinsics that are off by a half turn, of the wrong handedness, or given as their inverse make a street that looks like
one and fits no other drive's. Where nothing holds, the query's blocks are put as such errors would have them, lidar by
lidar, and searched for anew. The result names the cause; no pose comes from it, since the drives do not show whose
extrinsics are wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.blocks import Block
from relocbench.datasets.groundtruth.blocks.store import BlockStore
from relocbench.datasets.groundtruth.registration.global_registration import GlobalOptions
from relocbench.datasets.groundtruth.registration.hypotheses import (
    HypothesisOptions,
    choose_hypothesis,
    settle,
    with_alternatives,
)
from relocbench.datasets.groundtruth.registration.place_recognition import MapPrior, guesses_of_node
from relocbench.datasets.groundtruth.registration.submap_pair import Guess, PreparedDrive, RegisterOptions
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.groundtruth.submaps.submaps import SubmapWindow
from relocbench.datasets.groundtruth.verification.alternatives import ShiftOptions
from relocbench.datasets.groundtruth.verification.verification import Thresholds
from relocbench.geometry import invert, make_transform, so3_exp

_PLACES = (0.5, 0.25)
"""parts of the query's drive at which other mounts are tried, at the second one only if one fitted at the first"""
_BETTER = 0.15
"""another mount must fit by so much better than the one that is given"""
_ITERATIONS = 10_000
"""of RANSAC, for each mount"""
_SHIFT = ShiftOptions(points=300)
_THRESHOLDS = Thresholds(least_overlap=0.4, most_violations=0.05, least_detail=0.6)
"""blocks that were cut with wrong extrinsics lack points, so that much is not found again; what is there must fit"""


def _turned(axis: int) -> Callable[[Array], Array]:
    rotation = so3_exp(np.pi * np.eye(3)[axis])
    return lambda T: make_transform(rotation @ T[:3, :3], T[:3, 3])


def _mirrored(T: Array) -> Array:
    return make_transform(np.diag([1.0, -1.0, 1.0]) @ T[:3, :3], T[:3, 3])


MOUNTS: dict[str, Callable[[Array], Array]] = {
    "turned by 180 deg about the vertical axis": _turned(2),
    "with left and right exchanged": _mirrored,
    "upside down": _turned(0),
    "with their extrinsics inverted": invert,
}
"""typical errors of extrinsics, undone: words -> extrinsics (4, 4) as they are given -> as they would be"""


class RemountedStore(BlockStore):
    """The blocks of a drive as other extrinsics would have put them; the rig hardly turns within a block."""

    def __init__(self, folder: Path, T_given: dict[int, Array], how: Callable[[Array], Array]) -> None:
        """
        Args:
            T_given: number of each lidar that is mounted otherwise -> its extrinsics (4, 4) as they are given.
        """
        super().__init__(folder)
        self._moves = {number: (how(T), T) for number, T in T_given.items()}

    def get(self, node: int) -> Block:
        """The block of a node. Raises DatasetError with the file if it is missing or damaged."""
        block = super().get(node)
        points, normals, origins = (np.array(part) for part in (block.points, block.normals, block.origins))
        for number, (T, T_given) in self._moves.items():
            own = slice(None) if block.lidar is None else block.lidar == number
            turn = (T[:3, :3] @ T_given[:3, :3].T).astype(np.float32)
            beams = points[own] - origins[own]
            origins[own] += (T[:3, 3] - T_given[:3, 3]).astype(np.float32)
            points[own] = origins[own] + beams @ turn.T
            normals[own] = normals[own] @ turn.T
        return replace(block, points=points, normals=normals, origins=origins)


def wrong_mount(
    reference: Drive,
    query: Drive,
    prior: MapPrior | None,
    length_m: float,
    search: GlobalOptions,
    hypotheses: HypothesisOptions,
    register_options: RegisterOptions,
) -> str:
    """With which other mount of the query's lidars the drives fit each other, in words; empty if with none.

    Args:
        length_m: length of road of a submap.
    """
    leniently = replace(register_options, thresholds=_THRESHOLDS)
    quick = replace(search, iterations=_ITERATIONS, seeds=search.seeds[:1])
    ref = PreparedDrive(reference.window(length_m), reference.nodes)
    given = PreparedDrive(query.window(length_m), query.nodes)

    def fitting(drive: PreparedDrive, node: int) -> tuple[float, list[Guess]]:
        """The best fit of guesses, and the guesses."""
        guesses = guesses_of_node(ref, drive, prior, node, quick)
        return max((settle(ref, drive, guess, _SHIFT).fit for guess in guesses), default=0.0), guesses

    for node in (int(place * len(query.nodes)) for place in _PLACES):
        least = max(fitting(given, node)[0] + _BETTER, hypotheses.poor_fit)
        fits: list[tuple[float, str, PreparedDrive, list[Guess]]] = []
        for words, store in remounted(query):
            drive = PreparedDrive(SubmapWindow(query.nodes, store, length_m / 2), query.nodes)
            fit, guesses = fitting(drive, node)
            if fit >= least:
                fits.append((fit, words, drive, guesses))
        for _, words, drive, guesses in sorted(fits, key=lambda one: -one[0]):
            starts = with_alternatives(ref, drive, guesses, ShiftOptions(), hypotheses.most_tried)
            if choose_hypothesis(ref, drive, starts, hypotheses, leniently).best is not None:
                return f"the drives fit only with {words} of {query.name}: the extrinsics of one of the two are wrong"
        if not fits:
            break
    return ""


def remounted(query: Drive) -> Iterator[tuple[str, BlockStore]]:
    """Other mounts of all lidars and of single ones, in words, and the blocks that they would give."""
    lidars = query.recording.lidars
    every = {number: np.asarray(lidar.T_rig_lidar) for number, lidar in enumerate(lidars)}
    groups = [every] if len(lidars) == 1 else [every, *({number: T} for number, T in every.items())]
    for chosen in groups:
        names = " and ".join(lidars[number].name for number in chosen)
        for words, how in MOUNTS.items():
            yield f"{names} {words}", RemountedStore(query.blocks, chosen, how)
