"""The pair sets of a rendered dataset; each is computed and written by one worker."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from relocbench.datasets.core.build import Build, work
from relocbench.datasets.core.build_options import RuleOptions
from relocbench.datasets.core.layout import DatasetLayout, pair_set_name
from relocbench.datasets.core.pairfile import Pair, PairKey
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.pairs.correspondences import PairCorrespondences
from relocbench.datasets.pairs.different_places import with_different_places
from relocbench.datasets.pairs.pairing import make_pairs
from relocbench.datasets.pairs.writing import is_finished, write_measured
from relocbench.datasets.synthetic.conditions.presets import RepeatingStreet
from relocbench.datasets.synthetic.jobs.exact_correspondences import (
    View,
    exact_correspondences,
    guessed_overlap_of_query,
)
from relocbench.datasets.synthetic.jobs.latest import forget_renderer
from relocbench.datasets.synthetic.jobs.pairs import DistanceSpread, drawn_pairs, nearest_miss
from relocbench.datasets.synthetic.jobs.plan import TraversalPlan
from relocbench.datasets.synthetic.jobs.selection import Selection, on_repeating_street, sorted_by_street
from relocbench.errors import DatasetError

_WORTH_WORKERS = 600
"""pairs; fewer are finished before other processes have made their districts"""
_ON_STREET = "all pairs stand on the repeating street, and --repeating-street avoid leaves none"


@dataclass(frozen=True, eq=False)
class PairSetUnit:
    """One pair set to write."""

    layout: DatasetLayout
    split: str
    traversals: tuple[str, str]
    """of the keyframes and of the queries"""
    cameras: tuple[str, str]
    """of the keyframes and of the queries"""
    pairs: tuple[Pair, ...]
    """sorted by their keys"""
    references: dict[int, View]
    """by timestamp"""
    queries: dict[int, View]
    count: int
    seed: int
    selection: Selection

    @property
    def name(self) -> str:
        return pair_set_name(*self.traversals, *self.cameras)

    def __str__(self) -> str:
        return f"pair set {self.name}"


def plan_pair_sets(
    job: Build[RuleOptions],
    asked: Sequence[tuple[TraversalPlan, TraversalPlan]],
    spread: DistanceSpread,
    selection: Selection,
    repeating: RepeatingStreet,
    *,
    across: bool,
) -> list[PairSetUnit]:
    """The pair sets of (reference, query) traversals for every camera.

    Args:
        across: whether each query is paired with the keyframe of whichever camera sees most of the same. There is a
            set for each two cameras that have such pairs.

    A set whose pairs all stand on the repeating street, if these are to be avoided, is left out with a note.

    Raises:
        DatasetError: a set has no pair within the bounds, none is left of any set, or the road is too short for pairs
            of different places.
    """
    units: list[PairSetUnit] = []
    for reference, query in asked:
        drives = _Drives(job, reference, query, spread, selection, repeating)
        found = drives.across_cameras() if across else map(drives.of_camera, reference.cameras)
        units += (unit for unit in found if unit.pairs)
    if not units:
        raise DatasetError(_ON_STREET, job.writer.layout.root)
    return units


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
    work("pairs and their correspondences", write_set, units, run, job.reporter)
    splits: dict[str, list[str]] = {}
    for unit in planned:
        if unit.layout.pair_file(unit.name).stat().st_size:
            splits.setdefault(unit.split, []).append(unit.name)
        else:
            _remove(unit)
            job.reporter.note(f"{unit.name}: none of {len(unit.pairs)} pairs is {unit.selection.tier}; left out")
    if not splits:
        tier = planned[0].selection.tier
        raise DatasetError(
            f"no pair of any set is {tier}; expected other distances, angles or depths", job.writer.layout.root
        )
    return splits


def _remove(unit: PairSetUnit) -> None:
    """Remove what was written of a set; its pairs, which mark it as finished, last."""
    layout = unit.layout
    for of in (layout.correspondence_file, layout.pair_table, layout.pair_file):
        of(unit.name).unlink(missing_ok=True)


@dataclass(frozen=True, eq=False)
class _Drives:
    """Two traversals whose frames are to be paired, and how."""

    job: Build[RuleOptions]
    reference: TraversalPlan
    query: TraversalPlan
    spread: DistanceSpread
    selection: Selection
    repeating: RepeatingStreet

    @property
    def same(self) -> bool:
        """Whether they are one traversal."""
        return self.reference is self.query

    def of_camera(self, camera: str) -> PairSetUnit:
        """A pair set of one camera."""
        job, options, layout = self.job, self.job.options, self.job.writer.layout
        name, times = pair_set_name(self.reference.name, self.query.name, camera), self.query.times
        frames = self.reference.frames(camera), self.query.frames(camera)
        if options.pair_rule is None:
            pairs = drawn_pairs(*frames, self.spread, self._rng(), same_traversal=self.same)
        else:
            pairs = make_pairs(
                *frames,
                options.model_copy(update={"elsewhere": 0}),
                same_traversal=self.same,
                source="rendered poses",
                where=layout.root,
                sigma_translation_m=0.0,
                sigma_rotation_deg=0.0,
            )
        if not pairs:
            nearest = nearest_miss([frames], self.spread, same_traversal=self.same)
            raise DatasetError(f"{name}: no keyframe of any query is {self.spread}; {nearest}", layout.root)
        pairs = self._by_street((camera, camera), pairs)
        if not pairs:
            job.reporter.note(f"{name}: {_ON_STREET}; left out")
        elif len({p.query_timestamp_ns for p in pairs}) < len(times) and options.pair_rule is None:
            job.reporter.note(f"{name}: {len(times) - len(pairs)} of {len(times)} queries are in no pair")
        if options.elsewhere and pairs:
            # Those of one place that are left, since a method must not know an image from negative pairs alone.
            pairs = with_different_places(pairs, *frames, options, layout.root)
        return self._unit((camera, camera), pairs)

    def across_cameras(self) -> list[PairSetUnit]:
        """The pair sets of all cameras."""
        job, reference, query = self.job, self.reference, self.query
        found: dict[tuple[str, str], list[Pair]] = {c: [] for c in product(reference.cameras, query.cameras)}
        with job.reporter.stage(f"cameras of {reference.name} and {query.name}", len(query.cameras)) as advance:
            for of_query in query.cameras:
                asked_of: dict[int, list[tuple[str, Pair]]] = {}
                for of_reference in reference.cameras:
                    frames = reference.frames(of_reference), query.frames(of_query)
                    for pair in drawn_pairs(*frames, self.spread, self._rng(), same_traversal=self.same):
                        asked_of.setdefault(pair.query_timestamp_ns, []).append((of_reference, pair))
                for candidates in asked_of.values():
                    overlaps = [self._overlap((c, of_query), pair) for c, pair in candidates]
                    best = int(np.argmax(overlaps))
                    if overlaps[best] > 0:
                        found[candidates[best][0], of_query].append(candidates[best][1])
                advance(1)
        asking = len(query.times) * len(query.cameras)
        where = f"{reference.name}__{query.name}"
        if not any(found.values()):
            sides = [(reference.frames(a), query.frames(b)) for a, b in found]
            nearest = nearest_miss(sides, self.spread, same_traversal=self.same)
            raise DatasetError(
                f"{where}: no keyframe of any camera that sees something of a query is {self.spread}; {nearest}",
                job.writer.layout.root,
            )
        found = {cameras: self._by_street(cameras, pairs) for cameras, pairs in found.items()}
        paired = sum(map(len, found.values()))
        if not paired:
            job.reporter.note(f"{where}: {_ON_STREET}; left out")
        elif paired < asking:
            job.reporter.note(f"{where}: {asking - paired} of {asking} queries of all cameras are in no pair")
        return [self._unit(cameras, pairs) for cameras, pairs in found.items()]

    def _by_street(self, cameras: tuple[str, str], pairs: list[Pair]) -> list[Pair]:
        """The pairs by the rule for the street whose houses repeat themselves."""
        if self.repeating == "keep":
            return pairs
        repeats: dict[int, bool] = {}
        for plan, camera in zip((self.reference, self.query), cameras, strict=True):
            there = on_repeating_street(plan.place, plan.frames(camera).T_world_cam)
            repeats |= dict(zip(plan.times, there.tolist(), strict=True))
        return sorted_by_street(pairs, repeats, avoid=self.repeating == "avoid")

    def _rng(self) -> np.random.Generator:
        """The same for all cameras of a rig, so that their pairs are of the same moments wherever possible."""
        return np.random.default_rng([self.job.options.seed, 6, self.reference.number, self.query.number])

    def _overlap(self, cameras: tuple[str, str], pair: Pair) -> float:
        """How much of what a query sees a keyframe has seen, without moving cars."""
        views = []
        for plan, name, time in zip((self.reference, self.query), cameras, pair.key, strict=True):
            camera, T_rig_cam = plan.cameras[name]
            T_world_cam = plan.drive.T_world_rig[plan.times.index(time)] @ T_rig_cam
            views.append(View(plan.place, plan.condition.factors, camera, T_world_cam))
        return guessed_overlap_of_query(*views)

    def _unit(self, cameras: tuple[str, str], pairs: Sequence[Pair]) -> PairSetUnit:
        return PairSetUnit(
            self.job.writer.layout,
            self.reference.split,
            (self.reference.name, self.query.name),
            cameras,
            tuple(sorted(pairs, key=lambda p: p.key)),
            _views(self.reference, cameras[0], {p.ref_timestamp_ns for p in pairs}),
            _views(self.query, cameras[1], {p.query_timestamp_ns for p in pairs}),
            self.job.options.correspondences,
            self.job.options.seed,
            self.selection,
        )


def _views(plan: TraversalPlan, camera: str, wanted: set[int]) -> dict[int, View]:
    T_world_cam = plan.frames(camera).T_world_cam
    return {
        timestamp: View(plan.place, plan.condition.factors, plan.cameras[camera][0], pose, cars)
        for timestamp, pose, cars in zip(plan.times, T_world_cam, plan.moving, strict=True)
        if timestamp in wanted
    }


def write_set(unit: PairSetUnit) -> None:
    """Compute and write one pair set: the correspondences first, and last the pair file, which marks it as finished."""
    forget_renderer()
    of_keyframes, of_queries = unit.cameras
    reference, query = (Traversal(unit.layout.traversal(name)) for name in unit.traversals)

    def measured() -> Iterator[tuple[PairKey, PairCorrespondences]]:
        for pair in unit.pairs:
            if pair.is_negative:
                continue
            assert pair.T_query_ref is not None
            rng = np.random.default_rng([unit.seed, 8, *pair.key])
            views = unit.references[pair.ref_timestamp_ns], unit.queries[pair.query_timestamp_ns]
            keyframe = reference.reference(of_keyframes, pair.ref_timestamp_ns)
            image = query.image(of_queries, pair.query_timestamp_ns)
            yield pair.key, exact_correspondences(views, keyframe, image, pair.T_query_ref, unit.count, rng)

    if unit.selection.keeps_all:
        write_measured(unit.layout, unit.name, unit.pairs, measured(), with_correspondences=unit.count > 0)
        return
    found = dict(measured())
    kept = unit.selection.of(unit.pairs, found)
    chosen = ((pair.key, found[pair.key]) for pair in kept if pair.key in found)
    write_measured(unit.layout, unit.name, kept, chosen, with_correspondences=unit.count > 0)
