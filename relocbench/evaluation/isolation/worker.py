"""What workers of all evaluations share: units of work, the trackers that are kept, and what these are shown."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import groupby
from pathlib import Path

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.layout import DatasetLayout, pair_set_name
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.datasets.core.traversal import Traversal
from relocbench.evaluation.isolation.handles import LocalTracker, TrackerHandle
from relocbench.evaluation.isolation.tracker import IsolatedTracker
from relocbench.evaluation.isolation.views import masked_query, masked_reference
from relocbench.execution import MANY_TIMES, Run, Sandbox, chunks, on_one_core, step
from relocbench.methods import MethodSpec
from relocbench.tracking import Query

CONSTRUCTOR = "constructor"
PREPARE = "prepare"
_PAIRS_A_UNIT = 16


@dataclass(frozen=True)
class Visibility:
    """What a method sees of the evaluation besides images, cameras and depth."""

    isolated: bool = True
    """it runs in a process that holds no dataset"""
    times: bool = False
    """it declares that it uses the times of images"""
    sandbox: Sandbox = field(default_factory=Sandbox)
    """where its process runs"""
    one_core: bool = False
    """its process is bound to a single core"""


@dataclass(frozen=True)
class Unit:
    """Some pairs of one reference, to be answered by one worker."""

    spec: MethodSpec
    dataset: Path
    reference: str
    query: str
    reference_camera: str
    query_camera: str
    keys: tuple[PairKey, ...]
    journal: Path
    visibility: Visibility
    patient: bool
    """whether the first call of a process may take many times the limit, as compilation does"""
    shows_neighbours: bool
    """whether frames around a keyframe may be shown, with their true poses"""

    def __str__(self) -> str:
        return f"{self.spec.label} on {self.pair_set}, pair {self.keys[0]}"

    @property
    def pair_set(self) -> str:
        """The name of the pair set."""
        return pair_set_name(self.reference, self.query, self.reference_camera, self.query_camera)


@dataclass(frozen=True, eq=False)
class Assignment:
    """A dataset whose pairs a method answers, where it runs and what it sees."""

    dataset: Dataset
    spec: MethodSpec
    run: Run
    visibility: Visibility
    seed: int = 0

    @classmethod
    def of(cls, dataset: Dataset, spec: MethodSpec, run: Run, seed: int = 0) -> Assignment:
        """The assignment with what a method sees in a run. Raises MethodError and ConfigError."""
        seen = Visibility(run.in_subprocess, spec.uses_times(), run.sandbox_of_methods(), run.one_core)
        return cls(dataset, spec, run, seen, seed)

    def units(self, pair_set: PairSet, journal: Path, keys: Sequence[PairKey]) -> list[Unit]:
        """Units of work for the pairs of ``keys``, each with pairs of a single reference.

        Their order is drawn from the seed and the dataset's fingerprint, which no method knows: it says nothing about
        the drive. A method that uses times gets the pairs in the order of their times.
        """
        by_keyframe = [list(group) for _, group in groupby(sorted(keys), key=lambda key: key[0])]
        if not self.visibility.times:
            drawn_from = f"{self.seed} {self.dataset.fingerprint} {pair_set.name}"
            rng = np.random.default_rng(list(hashlib.sha256(drawn_from.encode()).digest()))
            by_keyframe = [[group[i] for i in rng.permutation(len(group))] for group in by_keyframe]
            by_keyframe = [by_keyframe[i] for i in rng.permutation(len(by_keyframe))]
        common = (self.spec, self.dataset.root.resolve(), pair_set.reference, pair_set.query, *pair_set.cameras)
        # Where a set asks the keyframe's drive for its queries, the frames around a keyframe are the answers there.
        asked = any(one.query == pair_set.reference for one in self.dataset.pair_sets())
        return [
            Unit(*common, tuple(chunk), journal.resolve(), self.visibility, patient=True, shows_neighbours=not asked)
            for group in by_keyframe
            for chunk in chunks(group, _PAIRS_A_UNIT)
        ]


def show_keyframe(unit: Unit, tracker: TrackerHandle) -> str | None:
    """Show the tracker the unit's keyframe; returns how it crashed on it, if it did. Raises DatasetError."""
    if tracker.declared.fault:
        return tracker.declared.fault
    traversal = traversal_of(unit.dataset, unit.reference)
    neighbours = tracker.declared.neighbours if unit.shows_neighbours else 0
    keyframe = traversal.reference(unit.reference_camera, unit.keys[0][0], neighbours)
    with step(PREPARE, unit.keys, MANY_TIMES):
        return tracker.prepare(masked_reference(keyframe, unit.visibility.times))


def query_of(unit: Unit, key: PairKey) -> Query:
    """The query of a pair as the tracker sees it. Raises DatasetError."""
    query = traversal_of(unit.dataset, unit.query).query(unit.query_camera, key[1])
    return masked_query(query, unit.visibility.times)


@cache
def traversal_of(dataset: Path, name: str) -> Traversal:
    """A traversal of a dataset, kept for the life of the process."""
    return Traversal(DatasetLayout(dataset).traversal(name))


_called: set[tuple[str, str]] = set()


def is_first_call(function: str, spec: MethodSpec) -> bool:
    """Whether this is the first call of a method's function in the process."""
    call = function, repr(spec)
    if call in _called:
        return False
    _called.add(call)
    return True


def time_factor(function: str, unit: Unit, pairs: int = 1) -> float:
    """The factor on the time limit of a call: the first one in a process may compile, or start a program."""
    first = is_first_call(function, unit.spec) and unit.patient
    return MANY_TIMES if first else min(float(pairs), MANY_TIMES)


_trackers: dict[tuple[str, str, Path, str], TrackerHandle] = {}
"""the tracker of this process, by what it is and by the pair set that it is asked about"""


def tracker_of(unit: Unit) -> TrackerHandle:
    """The tracker of a unit, made once for each process and pair set; making it may load weights.

    What it saw in one pair set it must not remember in the next, where a drive that was the map may be asked: its
    process ends with the set, and its home and temporary files with it.
    """
    known = repr(unit.spec), repr(unit.visibility), unit.dataset, unit.pair_set
    if known not in _trackers:
        _trackers.clear()
        _called.clear()
        with step(CONSTRUCTOR, times=MANY_TIMES):
            _trackers[known] = _made(unit)
    return _trackers[known]


def _made(unit: Unit) -> TrackerHandle:
    if unit.visibility.isolated:
        with on_one_core(unit.visibility.one_core):
            return IsolatedTracker(unit.spec, unit.visibility.sandbox)
    return LocalTracker(unit.spec.create())
