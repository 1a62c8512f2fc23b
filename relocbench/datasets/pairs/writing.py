"""Writing the pairs of a pair set, with their measures and correspondences."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.core.layout import DatasetLayout, pair_set_name
from relocbench.datasets.core.pair_table import read_pairs, write_pairs
from relocbench.datasets.core.pairfile import Pair, PairKey
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.pairs.correspondences import PairCorrespondences, pair_correspondences
from relocbench.datasets.pairs.measures import PairMeasures
from relocbench.datasets.pairs.visibility import DepthView
from relocbench.errors import DatasetError
from relocbench.execution import run_units

_WORTH_WORKERS = 40
"""pairs; fewer are finished before worker processes have started"""


@dataclass(frozen=True, eq=False)
class _Unit:
    """One pair to process."""

    reference: Traversal
    query: Traversal
    cameras: tuple[str, str]
    """of keyframes and queries"""
    pair: Pair
    count: int
    seed: int


def _work(unit: _Unit) -> PairCorrespondences:
    pair, (of_keyframes, of_queries) = unit.pair, unit.cameras
    assert pair.T_query_ref is not None
    entry = unit.query.file.cameras[of_queries]
    seen_by = unit.query.camera(of_queries, pair.query_timestamp_ns)
    query = DepthView(seen_by, unit.query.depth(of_queries, pair.query_timestamp_ns), entry.depth_sigma)
    rng = np.random.default_rng([unit.seed, *(time % 2**64 for time in pair.key)])
    reference = unit.reference.reference(of_keyframes, pair.ref_timestamp_ns)
    image = unit.query.image(of_queries, pair.query_timestamp_ns)
    return pair_correspondences(reference, pair.T_query_ref, query, unit.count, rng, _sigma_pose(pair), image)


def _sigma_pose(pair: Pair) -> tuple[float, float] | None:
    """Sigma of the pose in metres and radians; None if unknown."""
    if pair.sigma_translation_m is None or pair.sigma_rotation_deg is None:
        return None
    return pair.sigma_translation_m, float(np.radians(pair.sigma_rotation_deg))


def write_pair_set(
    job: Build[ImportOptions],
    reference: str,
    query: str,
    camera: str,
    pairs: Sequence[Pair],
    query_camera: str = "",
) -> None:
    """Write a pair set with what the query of each pair sees and, if the options want any, a file of correspondences.

    The traversals must have been written before. Pairs of poses alone, and pairs that are rejected, have no pose or
    show different places, get no measures and no correspondences. A set that an earlier run of the
    same build has finished is kept unchanged.

    Args:
        query_camera: that of the queries, where it is not the keyframes'.
    """
    cameras = camera, query_camera or camera
    layout, count = job.writer.layout, job.options.correspondences
    name = pair_set_name(reference, query, *cameras)
    ordered = sorted(pairs, key=lambda p: p.key)
    traversals = [Traversal(layout.traversal(t)) for t in (reference, query)]
    if any(c in traversal.frames for c, traversal in zip(cameras, traversals, strict=True)):
        job.writer.pairs(reference, query, camera, ordered, query_camera)
        return
    if is_finished(layout, name, ordered, with_correspondences=count > 0):
        return
    measured = [p for p in ordered if p.accepted and p.T_query_ref is not None and not p.is_negative]
    units = [_Unit(traversals[0], traversals[1], cameras, pair, count, job.options.seed) for pair in measured]
    run = job.run if len(units) >= _WORTH_WORKERS else job.run.single_process()
    with job.reporter.stage(f"correspondences of {name}", len(units)) as advance:

        def results() -> Iterator[tuple[PairKey, PairCorrespondences]]:
            for index, found in _in_order(run_units(_work, units, run)):
                yield measured[index].key, found
                advance(1)

        sigma = any(_sigma_pose(p) is not None for p in measured)
        write_measured(layout, name, ordered, results(), with_correspondences=count > 0, sigma=sigma)


def write_measured(
    layout: DatasetLayout,
    name: str,
    pairs: Sequence[Pair],
    measured: Iterable[tuple[PairKey, PairCorrespondences]],
    *,
    with_correspondences: bool,
    sigma: bool = False,
) -> None:
    """Write a pair set: first its correspondences, if wanted, and last its pairs with what was measured of them.

    Args:
        pairs: all pairs of the set, sorted by their keys.
        measured: results for some or all of the pairs, which are consumed one at a time.
        sigma: as in :func:`write_correspondences`.
    """
    measures: dict[PairKey, PairMeasures] = {}

    def noted() -> Iterator[tuple[PairKey, PairCorrespondences]]:
        for key, found in measured:
            measures[key] = found.measures
            yield key, found

    if with_correspondences:
        from relocbench.datasets.pairs.correspondence_file import write_correspondences  # loads pyarrow

        write_correspondences(layout.correspondence_file(name), noted(), sigma=sigma)
    else:
        for _ in noted():
            pass
    complete = [replace(pair, **vars(measures[pair.key])) if pair.key in measures else pair for pair in pairs]
    write_pairs(layout.pair_file(name), layout.pair_table(name), complete)


def is_finished(
    layout: DatasetLayout, name: str, pairs: Sequence[Pair], *, with_correspondences: bool, some: bool = False
) -> bool:
    """Whether an earlier run has written this pair set; its pairs are written after the correspondences.

    Args:
        some: the set may hold some of the pairs alone.
    """
    if not (layout.pair_file(name).exists() and layout.pair_table(name).exists()):
        return False
    try:
        if with_correspondences:
            from relocbench.datasets.pairs.correspondence_file import open_correspondences  # loads pyarrow

            with open_correspondences(layout.correspondence_file(name)):
                pass
        known = read_pairs(layout.pair_file(name), layout.pair_table(name))
    except DatasetError:
        return False
    if some:
        return {p.key for p in known} <= {p.key for p in pairs}
    return [p.key for p in known] == [p.key for p in pairs]


def _in_order(results: Iterable[tuple[int, PairCorrespondences]]) -> Iterator[tuple[int, PairCorrespondences]]:
    """The results in order of their indices; early ones wait for those before them."""
    waiting: dict[int, PairCorrespondences] = {}
    due = 0
    for index, result in results:
        waiting[index] = result
        while due in waiting:
            yield due, waiting.pop(due)
            due += 1
