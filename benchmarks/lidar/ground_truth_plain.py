"""Registration without the builder's stages for ``ground_truth.py``: single pairs, and the plain recipe along a drive.

``open3d_pairs`` is the plain recipe with Open3D (:mod:`relocbench.datasets.groundtruth.recipe`), begun anew for each
pair. ``open3d_chain`` is ``--recipe open3d``: each pair starts from the one before. ``own_pairs`` is this package's
search (three seeded runs of RANSAC) and refinement of single pairs, of which the best fit is taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ground_truth_work import Spent, timed

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.alignment.two_drives import AlignmentOptions
from relocbench.datasets.groundtruth.icp.icp import run_icp
from relocbench.datasets.groundtruth.pairs.outcome import PairOutcome
from relocbench.datasets.groundtruth.recipe.answers import outcomes_of
from relocbench.datasets.groundtruth.recipe.chain import ChainUnit, RawSubmaps, follow
from relocbench.datasets.groundtruth.recipe.open3d_pair import Cloud, Open3dOptions, refine, search
from relocbench.datasets.groundtruth.registration.global_registration import describe, guesses
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap


@dataclass(frozen=True, eq=False)
class AloneUnit:
    """Node pairs (reference, query) of two drives."""

    reference: Drive
    query: Drive
    nodes: tuple[tuple[int, int], ...]
    options: AlignmentOptions


Answers = list[tuple[Array, Spent, int]]
"""``T_ref_query`` from node to node, its cost, and the points of both submaps"""


def open3d_pairs(unit: AloneUnit) -> Answers:
    """The plain recipe; the time to assemble the raw points of the submaps is not counted."""
    submaps = [RawSubmaps(drive.recording, unit.options.submap_m) for drive in (unit.reference, unit.query)]
    out = []
    for ref, query in unit.nodes:
        times = unit.reference.nodes.times_ns[ref], unit.query.nodes.times_ns[query]
        clouds = [raw.around(int(time)) for raw, time in zip(submaps, times, strict=True)]
        T, spent = timed(lambda: _open3d_pair(*clouds))  # noqa: B023
        out.append((T, spent, sum(map(len, clouds))))
    return out


def _open3d_pair(ref: Array, query: Array) -> Array:
    """``T_ref_query``."""
    options = Open3dOptions()
    clouds = Cloud.of(ref, options), Cloud.of(query, options)
    return refine(*clouds, search(*clouds, options), options).T_ref_query


def open3d_chain(unit: ChainUnit) -> tuple[list[PairOutcome], Spent]:
    """The plain recipe along a drive, and its cost."""
    found, spent = timed(lambda: follow(unit))
    return outcomes_of(unit, found), spent


def own_pairs(unit: AloneUnit) -> Answers:
    """Search and refinement of each pair on its own."""
    out = []
    windows = unit.reference.window(unit.options.submap_m), unit.query.window(unit.options.submap_m)
    for ref, query in unit.nodes:
        submaps = windows[0].at(ref), windows[1].at(query)
        T, spent = timed(lambda: _own_pair(*map(PreparedSubmap, submaps), unit.options))  # noqa: B023
        out.append((T, spent, sum(map(len, submaps))))
    return out


def _own_pair(ref: PreparedSubmap, query: PreparedSubmap, options: AlignmentOptions) -> Array:
    search, icp = options.registration.search, options.registration.register.icp
    found = guesses(describe(ref.submap, search), describe(query.submap, search), None, search)
    refined = [run_icp(ref.planes, query.planes, T, icp) for T in found]
    if not refined:
        return np.full((4, 4), np.nan)
    return max(refined, key=lambda r: r.count).T_ref_query
