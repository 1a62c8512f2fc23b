"""What workers of all evaluations share: units of work, cached trackers, views of images, and journals."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.datasets.core.traversal import Traversal
from relocbench.evaluation.common.guard import guarded, implements, neighbours_of
from relocbench.execution import MANY_TIMES, chunks, step
from relocbench.files import read_journal
from relocbench.methods import MethodSpec
from relocbench.tracking import KeyframePoints, Query, Reference, SupportsPrepare

CONSTRUCTOR = "constructor"
PREPARE = "prepare"
_PAIRS_A_UNIT = 16

Scalar = TypeVar("Scalar", bound=np.generic)


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

    def __str__(self) -> str:
        return f"{self.spec.label} on {self.reference}__{self.query}__{self.camera}, pair {self.keys[0]}"


def units_of(
    dataset: Dataset, pair_set: PairSet, spec: MethodSpec, journal: Path, keys: Sequence[PairKey]
) -> list[Unit]:
    """Units of work for the pairs of ``keys``, each with pairs of a single reference."""
    ordered = sorted(keys)
    common = (spec, dataset.root.resolve(), pair_set.reference, pair_set.query, pair_set.camera)
    return [
        Unit(*common, tuple(chunk), journal.resolve())
        for _, group in groupby(ordered, key=lambda key: key[0])
        for chunk in chunks(group, _PAIRS_A_UNIT)
    ]


def prepared(unit: Unit, tracker: Any) -> tuple[Any, str | None]:
    """The unit's keyframe as the tracker's ``prepare`` returns it, or None and how the tracker broke on it."""
    neighbours, broke = neighbours_of(tracker)
    if broke is not None:
        return None, broke
    traversal = traversal_of(unit.dataset, unit.reference)
    keyframe = shown_reference(traversal.reference(unit.camera, unit.keys[0][0], neighbours))
    if not implements(tracker, SupportsPrepare):
        return keyframe, None
    with step(PREPARE, unit.keys, MANY_TIMES):
        return prepare(tracker, keyframe)


def prepare(tracker: Any, keyframe: Reference) -> tuple[Any, str | None]:
    """What a tracker's ``prepare`` returns, or the keyframe itself where it has none; or None and how it broke."""
    return guarded(lambda: tracker.prepare(keyframe)) if implements(tracker, SupportsPrepare) else (keyframe, None)


def query_of(unit: Unit, key: PairKey) -> Query:
    """The query of a pair, read-only. Raises DatasetError."""
    query = traversal_of(unit.dataset, unit.query).query(unit.camera, key[1])
    return replace(query, image=read_only(query.image))


def shown_reference(reference: Reference) -> Reference:
    """A keyframe whose arrays are read-only."""
    points, depth = reference.sparse_points, reference.depth
    return replace(
        reference,
        image=read_only(reference.image),
        depth=None if depth is None else read_only(depth),
        sparse_points=None
        if points is None
        else KeyframePoints(read_only(points.uv), read_only(points.inverse_depth), read_only(points.sigma)),
        neighbours=tuple(
            replace(each, image=read_only(each.image), T_neighbour_ref=read_only(each.T_neighbour_ref))
            for each in reference.neighbours
        ),
    )


def read_only(array: NDArray[Scalar]) -> NDArray[Scalar]:
    """A read-only view: a method that writes to it gets a ValueError instead of changing the next method's input."""
    shown = array.view()
    shown.flags.writeable = False
    return shown


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


def time_factor(function: str, spec: MethodSpec, pairs: int = 1) -> float:
    """The factor on the time limit of a call: the first one in a process may compile, or start a program."""
    return MANY_TIMES if is_first_call(function, spec) else min(float(pairs), MANY_TIMES)


_trackers: dict[str, Any] = {}


def tracker_of(spec: MethodSpec) -> Any:
    """The tracker of a specification, constructed once for each process; constructing it may load weights."""
    if repr(spec) not in _trackers:
        with step(CONSTRUCTOR, times=MANY_TIMES):
            _trackers[repr(spec)] = spec.create()
    return _trackers[repr(spec)]
