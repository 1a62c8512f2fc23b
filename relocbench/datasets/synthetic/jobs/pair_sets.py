"""The pair sets of a rendered dataset; each is computed and written by one worker."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import RuleOptions
from relocbench.datasets.core.layout import DatasetLayout, pair_set_name
from relocbench.datasets.core.pairfile import Pair, PairKey
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.pairs.correspondences import PairCorrespondences
from relocbench.datasets.pairs.different_places import with_different_places
from relocbench.datasets.pairs.pairing import make_pairs
from relocbench.datasets.pairs.writing import is_finished, write_measured
from relocbench.datasets.synthetic.conditions.presets import RepeatingStreet
from relocbench.datasets.synthetic.jobs.exact_correspondences import View, exact_correspondences
from relocbench.datasets.synthetic.jobs.pairs import DistanceSpread, drawn_pairs, nearest_miss
from relocbench.datasets.synthetic.jobs.plan import TraversalPlan
from relocbench.datasets.synthetic.jobs.selection import (
    EVERYTHING,
    Selection,
    on_repeating_street,
    sorted_by_street,
)
from relocbench.errors import DatasetError
from relocbench.execution import run_units

_WORTH_WORKERS = 600
"""pairs; fewer are finished before other processes have made their districts"""


@dataclass(frozen=True, eq=False)
class PairSetUnit:
    """One pair set to write."""

    layout: DatasetLayout
    split: str
    traversals: tuple[str, str]
    """of the keyframes and of the queries"""
    camera: str
    pairs: tuple[Pair, ...]
    """sorted by their keys"""
    references: dict[int, View]
    """by timestamp"""
    queries: dict[int, View]
    count: int
    seed: int
    selection: Selection = EVERYTHING

    @property
    def name(self) -> str:
        return pair_set_name(*self.traversals, self.camera)

    def __str__(self) -> str:
        return f"pair set {self.name}"


def plan_pair_sets(
    job: Build[RuleOptions],
    asked: Sequence[tuple[TraversalPlan, TraversalPlan]],
    spread: DistanceSpread,
    selection: Selection = Selection(),  # it is frozen
    repeating: RepeatingStreet = "keep",
) -> list[PairSetUnit]:
    """The pair sets of (reference, query) traversals for every camera.

    Raises:
        DatasetError: a pair set would be empty, or the road is too short for pairs of different places.
    """
    return [
        replace(_unit(job, *each, camera, spread, repeating), selection=selection)
        for each in asked
        for camera in each[0].cameras
    ]


def write_pair_sets(job: Build[RuleOptions], planned: Sequence[PairSetUnit]) -> Mapping[str, Sequence[str]]:
    """Write pair sets with correspondences. Those that an earlier run of the same build has finished are kept.

    A set of which the selection keeps nothing is left out.

    Returns:
        split -> names of its pair sets.

    Raises:
        DatasetError: the selection keeps nothing of any set.
    """
    units = []
    for unit in planned:
        some = not unit.selection.keeps_all
        if not is_finished(unit.layout, unit.name, unit.pairs, with_correspondences=unit.count > 0, some=some):
            units.append(unit)
    run = job.run if sum(len(u.pairs) for u in units) >= _WORTH_WORKERS else job.run.single_process()
    with job.reporter.stage("pairs and their correspondences", len(units)) as advance:
        for _ in run_units(write_set, units, run):
            advance(1)
    splits: dict[str, list[str]] = {}
    for unit in planned:
        if unit.layout.pair_file(unit.name).stat().st_size:
            splits.setdefault(unit.split, []).append(unit.name)
        else:
            unit.layout.pair_file(unit.name).unlink()
            job.reporter.note(f"{unit.name}: none of {len(unit.pairs)} pairs is {unit.selection.tier}; left out")
    if not splits:
        tier = planned[0].selection.tier
        raise DatasetError(
            f"no pair of any set is {tier}; expected other distances, angles or depths", job.writer.layout.root
        )
    return splits


def _unit(
    job: Build[RuleOptions],
    reference: TraversalPlan,
    query: TraversalPlan,
    camera: str,
    spread: DistanceSpread,
    repeating: RepeatingStreet,
) -> PairSetUnit:
    options, layout = job.options, job.writer.layout
    name = pair_set_name(reference.name, query.name, camera)
    frames = reference.frames(camera), query.frames(camera)
    same = reference is query
    if options.pair_rule is None:
        # All cameras of a rig use the same seed, so that their pairs are of the same moments wherever possible.
        rng = np.random.default_rng([options.seed, 6, reference.number, query.number])
        pairs = drawn_pairs(*frames, spread, rng, same_traversal=same)
        if pairs and options.elsewhere:
            pairs = with_different_places(pairs, *frames, options, layout.root)
    else:
        pairs = make_pairs(
            *frames,
            options,
            same_traversal=same,
            source="rendered poses",
            where=layout.root,
            sigma_translation_m=0.0,
            sigma_rotation_deg=0.0,
        )
    if repeating != "keep":
        repeats = {
            time: bool(there)
            for plan, posed in ((reference, frames[0]), (query, frames[1]))
            for time, there in zip(plan.times, on_repeating_street(plan.place, posed.T_world_cam), strict=True)
        }
        pairs = sorted_by_street(pairs, repeats, repeating)
    if not pairs:
        nearest = nearest_miss(*frames, spread, same_traversal=same)
        raise DatasetError(f"{name}: no keyframe of any query is {spread}; {nearest}", layout.root)
    if len({p.query_timestamp_ns for p in pairs}) < len(query.times) and options.pair_rule is None:
        job.reporter.note(
            f"{name}: {len(query.times) - len(pairs) + options.elsewhere} of {len(query.times)} queries are in no pair"
        )
    ordered = tuple(sorted(pairs, key=lambda p: p.key))
    keyframes, asking = {p.ref_timestamp_ns for p in ordered}, {p.query_timestamp_ns for p in ordered}
    return PairSetUnit(
        layout,
        reference.split,
        (reference.name, query.name),
        camera,
        ordered,
        _views(reference, camera, *frames[0].T_world_cam, wanted=keyframes),
        _views(query, camera, *frames[1].T_world_cam, wanted=asking),
        options.correspondences,
        options.seed,
    )


def _views(plan: TraversalPlan, camera: str, *T_world_cam: np.ndarray, wanted: set[int]) -> dict[int, View]:
    return {
        timestamp: View(plan.place, plan.condition.factors, plan.cameras[camera][0], pose, cars)
        for timestamp, pose, cars in zip(plan.times, T_world_cam, plan.moving, strict=True)
        if timestamp in wanted
    }


def write_set(unit: PairSetUnit) -> None:
    """Compute and write one pair set: the correspondences first, and last the pair file, which marks it as finished."""
    camera = unit.camera
    reference, query = (Traversal(unit.layout.traversal(name)) for name in unit.traversals)

    def measured() -> Iterator[tuple[PairKey, PairCorrespondences]]:
        for pair in unit.pairs:
            if pair.is_negative:
                continue
            assert pair.T_query_ref is not None
            rng = np.random.default_rng([unit.seed, 8, *pair.key])
            views = unit.references[pair.ref_timestamp_ns], unit.queries[pair.query_timestamp_ns]
            images = reference.reference(camera, pair.ref_timestamp_ns), query.image(camera, pair.query_timestamp_ns)
            yield pair.key, exact_correspondences(views, *images, pair.T_query_ref, unit.count, rng)

    if unit.selection.keeps_all:
        write_measured(unit.layout, unit.name, unit.pairs, measured(), with_correspondences=unit.count > 0)
        return
    found = dict(measured())
    kept = unit.selection.of(unit.pairs, found)
    chosen = ((pair.key, found[pair.key]) for pair in kept if pair.key in found)
    write_measured(unit.layout, unit.name, kept, chosen, with_correspondences=unit.count > 0)
