"""What workers of all evaluations share: units of work, trackers that are kept, and journals."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import IO, Any

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.datasets.core.traversal import Traversal
from relocbench.evaluation.isolation.handles import LocalTracker, TrackerHandle
from relocbench.evaluation.isolation.tracker import IsolatedTracker
from relocbench.evaluation.isolation.views import masked_query, masked_reference
from relocbench.execution import MANY_TIMES, Run, chunks, step
from relocbench.files import read_journal
from relocbench.methods import SUBPROCESS, MethodSpec
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


@dataclass(frozen=True)
class Unit:
    """Some pairs of one reference, to be answered by one worker."""

    spec: MethodSpec
    dataset: Path
    reference: str
    query: str
    camera: str
    keys: tuple[PairKey, ...]
    journal: Path
    visibility: Visibility
    patient: bool
    """whether the first call of a process may take many times the limit, as compilation does"""

    def __str__(self) -> str:
        return f"{self.spec.label} on {self.reference}__{self.query}__{self.camera}, pair {self.keys[0]}"


def visibility_of(spec: MethodSpec, run: Run) -> Visibility:
    """What a method sees in a run. Raises MethodError."""
    return Visibility(isolated=run.in_subprocess, times=spec.uses_times())


def units_of(
    dataset: Dataset,
    pair_set: PairSet,
    spec: MethodSpec,
    journal: Path,
    keys: Sequence[PairKey],
    visibility: Visibility,
    seed: int = 0,
) -> list[Unit]:
    """Units of work for the pairs of ``keys``, each with pairs of a single reference.

    Their order is drawn from ``seed`` and the dataset's fingerprint, which no method knows: it says nothing about
    the drive. A method that uses times gets the pairs in the order of their times.
    """
    by_keyframe = [list(group) for _, group in groupby(sorted(keys), key=lambda key: key[0])]
    if not visibility.times:
        rng = _rng(f"{seed} {dataset.fingerprint} {pair_set.name}")
        by_keyframe = [[group[i] for i in rng.permutation(len(group))] for group in by_keyframe]
        by_keyframe = [by_keyframe[i] for i in rng.permutation(len(by_keyframe))]
    common = (spec, dataset.root.resolve(), pair_set.reference, pair_set.query, pair_set.camera)
    return [
        Unit(*common, tuple(chunk), journal.resolve(), visibility, patient=True)
        for group in by_keyframe
        for chunk in chunks(group, _PAIRS_A_UNIT)
    ]


def _rng(text: str) -> np.random.Generator:
    return np.random.default_rng(list(hashlib.sha256(text.encode()).digest()))


def show_keyframe(unit: Unit, tracker: TrackerHandle) -> str | None:
    """Show the tracker the unit's keyframe; returns how it crashed on it, if it did. Raises DatasetError."""
    if tracker.declared.fault:
        return tracker.declared.fault
    traversal = traversal_of(unit.dataset, unit.reference)
    # Where queries are of the keyframe's own drive, its posed neighbours are queries, or stand around one.
    neighbours = 0 if unit.reference == unit.query else tracker.declared.neighbours
    keyframe = traversal.reference(unit.camera, unit.keys[0][0], neighbours)
    with step(PREPARE, unit.keys, MANY_TIMES):
        return tracker.prepare(masked_reference(keyframe, unit.visibility.times))


def query_of(unit: Unit, key: PairKey) -> Query:
    """The query of a pair as the tracker sees it. Raises DatasetError."""
    query = traversal_of(unit.dataset, unit.query).query(unit.camera, key[1])
    return masked_query(query, unit.visibility.times)


def journal_entries(journal: Path) -> Iterator[dict[str, Any]]:
    """What workers have written so far, with each entry's pair as a tuple under ``key``."""
    if not journal.is_dir():
        return
    for path in sorted(journal.glob("*.jsonl")):
        for entry in read_journal(path):
            if "key" in entry:
                yield {**entry, "key": tuple(entry["key"])}


def answered_keys(journal: Path) -> set[PairKey]:
    """The pairs that have an entry in a journal."""
    return {entry["key"] for entry in journal_entries(journal)}


def remove_journal(journal: Path) -> None:
    """Remove the journal of a complete pair set, and the folder of journals if it was the last."""
    shutil.rmtree(journal, ignore_errors=True)
    if journal.parent.is_dir() and not any(journal.parent.iterdir()):
        journal.parent.rmdir()


def append_entry(journal: Path, entry: Mapping[str, Any]) -> None:
    """Write a single entry to a journal."""
    with open_journal(journal) as stream:
        write_entry(stream, entry)


def write_entry(stream: IO[str], entry: Mapping[str, Any]) -> None:
    """Write an entry at once, so that it outlives the process."""
    stream.write(json.dumps(entry) + "\n")
    stream.flush()


@contextmanager
def open_journal(journal: Path) -> Iterator[IO[str]]:
    """Open a journal file that only this process writes: writers never interleave, and only a last line can be torn."""
    # The clock only orders the files: it may stand still or be set back, and two machines may use one process number.
    name = f"{time.time_ns()}-{os.getpid()}-{secrets.token_hex(4)}.jsonl"
    try:
        with (journal / name).open("x", encoding="utf-8") as stream:
            yield stream
    except OSError as bad:
        bad.filename = bad.filename or str(journal / name)  # the error of a full disk does not name the file
        raise


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


_trackers: dict[tuple[str, bool], TrackerHandle] = {}


def tracker_of(unit: Unit) -> TrackerHandle:
    """The tracker of a unit, made once for each process; making it may load weights.

    A method that is a program, and nothing else, is isolated by being one.
    """
    program = unit.spec.target.startswith(SUBPROCESS) and unit.spec.start is None
    apart = unit.visibility.isolated and not program
    known = repr(unit.spec), apart
    if known not in _trackers:
        with step(CONSTRUCTOR, times=MANY_TIMES):
            _trackers[known] = IsolatedTracker(unit.spec) if apart else LocalTracker(unit.spec.create())
    return _trackers[known]
