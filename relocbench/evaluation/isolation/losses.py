"""What the loss of a worker costs: which of its calls are tried again, alone or not at all.

When a method ends its worker or exceeds a limit, only the pair in progress is lost.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Generic, TypeVar

from relocbench.datasets.core.pairfile import PairKey
from relocbench.evaluation.isolation.journal import answered_keys
from relocbench.evaluation.isolation.worker import CONSTRUCTOR, PREPARE, Unit
from relocbench.execution import IN_A_ROW, Loss, Run, run_limited

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
        open_units: returns units of the pairs that have no entry yet, those of a pair set after each other. A worker
            stays with a set where it can, since a process of a method serves one set only.
        lost: decides what is tried again.
        advance: called with the number of pairs just done.
    """
    while units := open_units():
        sets = [lost.runnable_units(list(of_one), advance) for _, of_one in groupby(units, lambda unit: unit.pair_set)]
        asked = run_limited(function, sets, run, on_loss=lost.handle_loss)
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
