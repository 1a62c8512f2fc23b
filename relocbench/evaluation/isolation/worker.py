"""What workers of all evaluations share: units of work, trackers that are kept, journals, and the cost of a loss.

When a method ends its worker or exceeds a limit, only the pair in progress is lost.
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import shutil
import time
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import IO, Any, Generic, TypeVar

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.layout import DatasetLayout, pair_set_name
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.datasets.core.traversal import Traversal
from relocbench.evaluation.isolation.handles import LocalTracker, TrackerHandle
from relocbench.evaluation.isolation.tracker import IsolatedTracker
from relocbench.evaluation.isolation.views import masked_query, masked_reference
from relocbench.execution import IN_A_ROW, MANY_TIMES, Loss, Run, Sandbox, chunks, on_one_core, run_limited, step
from relocbench.files import read_journal
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


def visibility_of(spec: MethodSpec, run: Run) -> Visibility:
    """What a method sees in a run. Raises MethodError and ConfigError."""
    return Visibility(run.in_subprocess, spec.uses_times(), run.sandbox_of_methods(), run.one_core)


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
    common = (spec, dataset.root.resolve(), pair_set.reference, pair_set.query, *pair_set.cameras)
    # Where a set asks the keyframe's drive for its queries, the frames around a keyframe are the answers there.
    asked = any(one.query == pair_set.reference for one in dataset.pair_sets())
    return [
        Unit(*common, tuple(chunk), journal.resolve(), visibility, patient=True, shows_neighbours=not asked)
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
    neighbours = tracker.declared.neighbours if unit.shows_neighbours else 0
    keyframe = traversal.reference(unit.reference_camera, unit.keys[0][0], neighbours)
    with step(PREPARE, unit.keys, MANY_TIMES):
        return tracker.prepare(masked_reference(keyframe, unit.visibility.times))


def query_of(unit: Unit, key: PairKey) -> Query:
    """The query of a pair as the tracker sees it. Raises DatasetError."""
    query = traversal_of(unit.dataset, unit.query).query(unit.query_camera, key[1])
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


U = TypeVar("U", bound=Unit)

TRIES = 2
"""a death may be accidental (another program took the memory), and a method that leaks gets a fresh process"""
HOPELESS = 3
"""calls that may be lost before any has succeeded; then a method is given up"""


def run_until_answered(
    function: Callable[[U], int],
    open_units: Callable[[], Sequence[U]],
    lost: LossHandler[U],
    run: Run,
    advance: Callable[[int], None],
) -> None:
    """Call ``function`` on units in workers until every pair has an entry in its journal.

    Args:
        function: answers the pairs of a unit and returns their number.
        open_units: returns units of the pairs that have no entry yet.
        lost: decides what is tried again.
        advance: called with the number of pairs just done.
    """
    while units := open_units():
        asked = run_limited(function, lost.runnable_units(units, advance), run, on_loss=lost.handle_loss)
        for _, done in asked:
            lost.unit_ended(done)
            advance(done)


class LossHandler(Generic[U]):
    """Remembers what has ended workers, and decides what is tried again, alone or not at all.

    Args:
        write: writes an entry to a unit's journal that the method crashed on a pair, and how.
    """

    def __init__(self, write: Callable[[U, PairKey, str], None]) -> None:
        self._write = write
        self._deaths: Counter[Hashable] = Counter()
        self._suspect_pairs: set[Hashable] = set()
        """pairs to be tried alone, since they were lost together with others"""
        self._lost_keyframes: dict[Hashable, str] = {}
        """keyframes that are given up because ``prepare`` was lost on them, with the message"""
        self._suspect_keyframes: set[Hashable] = set()
        """keyframes on which ``prepare`` was lost at least once"""
        self._prepared = False
        self._was_lost = False
        """whether the unit that ends next was lost"""
        self._given_up = ""
        self._in_a_row = 0
        """pairs and batches lost since the last answer"""
        self._answers = 0

    def runnable_units(self, units: Iterable[U], advance: Callable[[int], None]) -> Iterator[U]:
        """Yield the units to run, with suspect pairs in units of their own; pairs that are given up get their entry.

        Where ``prepare`` was lost on each of the first keyframes, the other keyframes wait until those are decided.
        """
        for unit in units:
            message = self._given_up or self._lost_keyframes.get(_keyframe(unit))
            if message:
                self._write_all(unit, unit.keys, message)
                advance(len(unit.keys))
                continue
            if self._hopeless and _keyframe(unit) not in self._suspect_keyframes:
                continue
            together = tuple(key for key in unit.keys if _pair(unit, key) not in self._suspect_pairs)
            alone = (replace(unit, keys=(key,)) for key in unit.keys if key not in together)
            for part in (*alone, *([replace(unit, keys=together)] if together else [])):
                # A first call takes as long as a limit allows: a method that hangs must not take many times the limit
                # for each pair. A process that is started again after one or two losses may still compile.
                yield replace(part, patient=self._in_a_row < TRIES)

    @property
    def _hopeless(self) -> bool:
        return len(self._suspect_keyframes) >= HOPELESS and not self._prepared

    def unit_ended(self, done: int) -> None:
        """Record the end of a unit; the method, or :meth:`handle_loss` just before, has done ``done`` pairs."""
        self._prepared |= done > 0 and not self._was_lost
        if not self._was_lost:
            self._answered(done)
        self._was_lost = False

    def handle_loss(self, unit: U, loss: Loss) -> int:
        """Record the final losses of a unit in its journal; returns how many of its pairs have an entry now."""
        self._was_lost = True
        done = answered_keys(unit.journal)
        left = [key for key in unit.keys if key not in done]
        self._answered(len(unit.keys) - len(left))
        name = loss.step.name if loss.step is not None else ""
        if name not in (CONSTRUCTOR, PREPARE):
            self._prepared = True
            return len(unit.keys) - len(left) + self._take_pairs(unit, loss, left)
        self._prepared |= len(left) < len(unit.keys)
        what: Hashable = name if name == CONSTRUCTOR else _keyframe(unit)
        if name == PREPARE:
            self._suspect_keyframes.add(what)
        if not self._is_final(what, loss):
            return len(unit.keys) - len(left)
        message = f"{name}: {loss_message(loss, '')}"
        if name == CONSTRUCTOR:
            self._given_up = message
        else:
            self._lost_keyframes[what] = message
            if len(self._lost_keyframes) >= HOPELESS and not self._prepared:
                self._given_up = given_up_message(message, "keyframes, the others were not tried")
        self._write_all(unit, left, message)
        return len(unit.keys)

    def _take_pairs(self, unit: U, loss: Loss, left: Sequence[PairKey]) -> int:
        named = () if loss.step is None else loss.step.keys
        # Between calls, a thread that was left running may end the process: then the next pair is the best guess.
        suspects = [key for key in named if key in left] or list(left[:1])
        if len(suspects) > 1:
            self._suspect_pairs.update(_pair(unit, key) for key in suspects)
            self._lost_again(1, loss)
            return 0
        final = [key for key in suspects if self._is_final(_pair(unit, key), loss)]
        self._write_all(unit, final, loss_message(loss, " on this pair"))
        self._lost_again(len(final), loss)
        return len(final)

    def _lost_again(self, calls: int, loss: Loss) -> None:
        self._in_a_row += calls
        if self._in_a_row >= IN_A_ROW and not self._given_up:
            self._given_up = self._hopeless_message(loss)

    def _answered(self, pairs: int) -> None:
        self._answers += pairs
        if pairs:
            self._in_a_row = 0

    def _hopeless_message(self, loss: Loss) -> str:
        before = f"after {self._answers} answered pairs" if self._answers else "without any answer before"
        way_out = {"time": "mend the method or raise --time-limit", "memory": "mend the method or raise --memory-limit"}
        return (
            f"not run: the method was given up when {self._in_a_row} calls in a row were lost, {before} "
            f"({loss.words}); {way_out.get(loss.kind, 'mend the method')}, and run again with --overwrite failed"
        )

    def _is_final(self, what: Hashable, loss: Loss) -> bool:
        self._deaths[what] += loss.workers
        return is_final(loss, self._deaths[what])

    def _write_all(self, unit: U, keys: Iterable[PairKey], message: str) -> None:
        for key in keys:
            self._write(unit, key, message)


def is_final(loss: Loss, deaths: int) -> bool:
    """Whether a call is not tried again: a death may be an accident, while waiting for a limit twice tells nothing."""
    return loss.kind == "time" or deaths >= TRIES


def given_up_message(message: str, rest: str) -> str:
    """The message for calls that are not made because the first ones were lost."""
    return f"{message}; so on the first {HOPELESS} {rest}"


def loss_message(loss: Loss, where: str) -> str:
    """The message for a table, once a pair or call is given up."""
    return f"the worker process died twice{where} ({loss.words})" if loss.kind == "death" else loss.words


def _keyframe(unit: Unit) -> Hashable:
    return unit.reference, unit.reference_camera, unit.keys[0][0]


def _pair(unit: Unit, key: PairKey) -> Hashable:
    return unit.pair_set, key
