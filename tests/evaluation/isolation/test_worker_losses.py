"""What the loss of a worker costs, decided by :class:`LossHandler` about a method that is lost in a step of its own.

A worker is played in this process: it raises where a real one would have ended. How workers really end is shown by
``tests/execution/test_limits.py``, and both together by ``tests/evaluation/tracking/test_method_limits.py``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, groupby
from pathlib import Path
from typing import Any, Literal

import pytest

from relocbench.datasets.core.pairfile import PairKey
from relocbench.evaluation.isolation import losses as handling
from relocbench.evaluation.isolation.journal import answered_keys, append_entry, journal_entries
from relocbench.evaluation.isolation.losses import HOPELESS, TRIES, LossHandler, run_until_answered
from relocbench.evaluation.isolation.worker import CONSTRUCTOR, PREPARE, Unit, Visibility
from relocbench.execution import IN_A_ROW, Loss, Run, Step
from relocbench.methods import parse_method

PAIRS = tuple((keyframe, query) for keyframe in range(6) for query in range(10, 14))
"""six keyframes with four queries each"""
Kind = Literal["time", "memory", "death"]
Lost = Callable[[str, tuple[PairKey, ...]], bool]
"""whether a step, by its name and its pairs, ends the worker"""


class WorkerLost(Exception):
    def __init__(self, loss: Loss) -> None:
        self.loss = loss


class Played:
    """A run of a method on :data:`PAIRS`, whose worker is lost in some steps."""

    def __init__(self, journal: Path, lost: Lost, kind: Kind = "death", batch: int = 1) -> None:
        self.journal, self.lost, self.kind, self.batch = journal, lost, kind, batch
        self.steps: list[tuple[str, tuple[PairKey, ...]]] = []
        self.patient: list[bool] = []
        journal.mkdir()
        run_until_answered(self._work, self._open_units, LossHandler(self._write), Run(), lambda pairs: None)

    @property
    def messages(self) -> dict[PairKey, str]:
        """Of the pairs that were lost."""
        entries = {entry["key"]: entry.get("message", "") for entry in journal_entries(self.journal)}
        assert entries.keys() == set(PAIRS)
        return {key: message for key, message in entries.items() if message}

    def _open_units(self) -> list[Unit]:
        done = answered_keys(self.journal)
        groups = groupby([key for key in PAIRS if key not in done], key=lambda key: key[0])
        return [_unit(tuple(keys), self.journal) for _, keys in groups]

    def _write(self, unit: Unit, key: PairKey, message: str) -> None:
        append_entry(unit.journal, {"key": list(key), "message": message})

    def _work(self, unit: Unit) -> int:
        self.patient.append(unit.patient)
        self._step(CONSTRUCTOR, ())
        self._step(PREPARE, unit.keys)
        for start in range(0, len(unit.keys), self.batch):
            keys = unit.keys[start : start + self.batch]
            self._step("", keys)
            for key in keys:
                append_entry(unit.journal, {"key": list(key)})
        return len(unit.keys)

    def _step(self, name: str, keys: tuple[PairKey, ...]) -> None:
        self.steps.append((name, keys))
        if self.lost(name, keys):
            raise WorkerLost(Loss(Step(name, keys), self.kind, "how it ended"))

    def tries(self, name: str) -> Counter[tuple[PairKey, ...]]:
        return Counter(keys for step, keys in self.steps if step == name)


def _unit(keys: tuple[PairKey, ...], journal: Path) -> Unit:
    of = parse_method("identity"), Path("d"), "a", "b", "c", "c"
    return Unit(*of, keys, journal, Visibility(), patient=True, shows_neighbours=True)


@pytest.fixture(autouse=True)
def played_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    def run_here(
        function: Callable[[Any], int],
        series: Sequence[Iterable[Any]],
        run: Run,
        *,
        on_loss: Callable[[Any, Loss], int],
    ) -> Iterator[tuple[int, int]]:
        for index, unit in enumerate(chain.from_iterable(series)):
            try:
                done = function(unit)
            except WorkerLost as lost:
                done = on_loss(unit, lost.loss)
            yield index, done

    monkeypatch.setattr(handling, "run_limited", run_here)


@pytest.mark.parametrize(("kind", "tries"), [("death", TRIES), ("memory", TRIES), ("time", 1)])
def test_a_pair_that_ends_the_worker_is_lost_alone_and_only_a_death_may_be_an_accident(
    tmp_path: Path, kind: Kind, tries: int
) -> None:
    bad = PAIRS[6]
    played = Played(tmp_path / "j", lambda name, keys: keys == (bad,) and name == "", kind)
    assert played.messages.keys() == {bad}
    assert "how it ended" in played.messages[bad]
    assert played.tries("") == {(key,): tries if key == bad else 1 for key in PAIRS}


def test_a_pair_that_ends_the_worker_once_is_answered(tmp_path: Path) -> None:
    ends = iter([True])
    played = Played(tmp_path / "j", lambda name, keys: keys == (PAIRS[6],) and name == "" and next(ends, False))
    assert played.messages == {}
    assert max(played.tries("").values()) == 2


@pytest.mark.parametrize("kind", ["death", "time"])
def test_of_a_batch_only_the_pair_that_ends_the_worker_is_lost(tmp_path: Path, kind: Kind) -> None:
    bad = PAIRS[6]
    played = Played(tmp_path / "j", lambda name, keys: bad in keys and name == "", kind, batch=3)
    assert played.messages.keys() == {bad}
    tried = played.tries("")
    assert {keys for keys in tried if bad in keys} == {PAIRS[4:7], (bad,)}, "with its batch, and then alone"


@pytest.mark.parametrize(("kind", "tries"), [("death", TRIES), ("time", 1)])
def test_a_constructor_that_ends_the_worker_gives_the_method_up(tmp_path: Path, kind: Kind, tries: int) -> None:
    played = Played(tmp_path / "j", lambda name, keys: name == CONSTRUCTOR, kind)
    assert len(played.messages) == len(PAIRS)
    assert all(message.startswith(f"{CONSTRUCTOR}: ") for message in played.messages.values())
    assert len(played.steps) == tries


@pytest.mark.parametrize(("kind", "tries"), [("death", TRIES), ("time", 1)])
def test_preparing_that_ends_the_worker_costs_its_keyframe(tmp_path: Path, kind: Kind, tries: int) -> None:
    played = Played(tmp_path / "j", lambda name, keys: name == PREPARE and keys[0][0] == 0, kind)
    assert played.messages.keys() == set(PAIRS[:4])
    assert all(message.startswith(f"{PREPARE}: ") for message in played.messages.values())
    assert played.tries(PREPARE)[PAIRS[:4]] == tries


def test_preparing_that_always_ends_the_worker_is_not_tried_on_every_keyframe(tmp_path: Path) -> None:
    played = Played(tmp_path / "j", lambda name, keys: name == PREPARE)
    assert len(played.messages) == len(PAIRS)
    assert sorted(played.tries(PREPARE).values()) == [TRIES] * HOPELESS


def test_a_method_that_prepares_one_keyframe_is_tried_on_all(tmp_path: Path) -> None:
    played = Played(tmp_path / "j", lambda name, keys: name == PREPARE and keys[0][0] != 0)
    assert played.messages.keys() == set(PAIRS[4:])
    assert sorted(played.tries(PREPARE).values()) == [1] + [TRIES] * 5


@pytest.mark.parametrize(("kind", "option"), [("time", "--time-limit"), ("memory", "--memory-limit"), ("death", "")])
def test_a_method_that_answers_no_pair_is_given_up_and_the_way_out_is_named(
    tmp_path: Path, kind: Kind, option: str
) -> None:
    played = Played(tmp_path / "j", lambda name, keys: name == "", kind)
    (given_up,) = {message for message in played.messages.values() if message.startswith("not run")}
    assert str(IN_A_ROW) in given_up
    assert "how it ended" in given_up
    assert option in given_up
    assert "--overwrite failed" in given_up
    lost = [message for message in played.messages.values() if not message.startswith("not run")]
    assert len(lost) == IN_A_ROW


def test_a_first_call_may_take_long_as_compiling_does_but_not_again_and_again(tmp_path: Path) -> None:
    played = Played(tmp_path / "j", lambda name, keys: name == "", "time")
    assert played.patient == [True] * TRIES + [False] * (IN_A_ROW - TRIES)
    answered = Played(tmp_path / "answered", lambda name, keys: name == "" and keys[0][1] == 12, "time")
    assert all(answered.patient), "none twice in a row"


def test_losses_with_answers_in_between_do_not_give_a_method_up(tmp_path: Path) -> None:
    bad = {key for key in PAIRS if key[1] in (11, 13)}
    assert len(bad) > IN_A_ROW
    played = Played(tmp_path / "j", lambda name, keys: name == "" and keys[0] in bad, "time")
    assert played.messages.keys() == bad
    assert not any(message.startswith("not run") for message in played.messages.values())


def test_a_worker_that_ends_between_two_calls_costs_the_next_pair(tmp_path: Path) -> None:
    """A thread that a method left running may end it."""
    unit = _unit(PAIRS[:4], tmp_path)
    written: list[PairKey] = []
    losses: LossHandler[Unit] = LossHandler(lambda unit, key, message: written.append(key))
    append_entry(tmp_path, {"key": list(PAIRS[0])})
    assert losses.handle_loss(unit, Loss(None, "death", "how it ended", workers=2)) == 2
    assert written == [PAIRS[1]]
