"""Trackers that break the contract in every way that is known, named by dotted path in tests.

:class:`Misbehaving` does something else at each pair: :data:`CASES` says what, and what must come of it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

import numpy as np
from small_dataset import START_NS, STEP_NS, time_of

from relocbench.tracking import Query, Reference, TrackResult

FRAMES = 26
"""of the dataset: as many pairs across as there are cases, or more"""


class Unspeakable(Exception):
    """Has no words."""

    def __str__(self) -> str:
        raise ValueError("no words")

    __repr__ = __str__


class Raising:
    """Raises ``what`` whichever way it is looked at."""

    def __init__(self, what: type[BaseException] = ZeroDivisionError) -> None:
        self.what = what

    def _raise(self, *_: object, **__: object) -> Any:
        raise self.what("on purpose")

    __array__ = __float__ = __index__ = __bool__ = __str__ = __repr__ = __len__ = __iter__ = __eq__ = _raise
    __hash__ = object.__hash__


class RaisingMapping(Mapping[str, Any]):
    """A mapping that raises on its second item."""

    def __getitem__(self, key: str) -> Any:
        raise GeneratorExit(key)

    def __iter__(self) -> Iterator[str]:
        yield "first"

    def __len__(self) -> int:
        return 2


class EndlessMapping(Mapping[str, Any]):
    """A mapping of which there is always more."""

    def __getitem__(self, key: str) -> Any:
        return key * 50

    def __iter__(self) -> Iterator[str]:
        return (str(n) for n in iter(int, 1))

    def __len__(self) -> int:
        return 1


class LoudText(str):
    """A string that shows itself otherwise to JSON and to ``str``."""

    def __str__(self) -> str:
        return "loud\n\x1b[31m\u2028words\x00\udc80"


@dataclass(frozen=True, eq=False)
class RaisingResult(TrackResult):
    """A result whose confidence is a property that raises."""

    @property  # type: ignore[misc]
    def confidence(self) -> Any:
        raise LookupError("not known yet")

    @confidence.setter
    def confidence(self, value: Any) -> None: ...


class ChangingResult(TrackResult):
    """A result whose pose is a rigid transform the first time that it is looked at only."""

    def __getattribute__(self, name: str) -> Any:
        if name != "T_query_ref":
            return super().__getattribute__(name)
        looks = super().__getattribute__("info")
        looks["looks"] = looks.get("looks", 0) + 1
        return np.eye(4) if looks["looks"] == 1 else "gone"


def _raises(what: BaseException) -> Callable[[], Any]:
    def answer() -> Any:
        raise what

    return answer


def _says(**fields: Any) -> Callable[[], Any]:
    """A right pose with something beside it."""
    return lambda: TrackResult(**{"T_query_ref": np.eye(4), **fields})


def _recurse() -> Any:
    return _recurse()


def _cyclic() -> dict[str, Any]:
    around: dict[str, Any] = {}
    around["again"] = [around]
    return around


def _moved(dtype: Any) -> Any:
    pose = np.eye(4)
    pose[2, 3] = 2
    return pose.astype(dtype)


@dataclass(frozen=True)
class Case:
    """What a method does, and what is kept of it."""

    name: str
    answer: Callable[[], Any] = field(repr=False)
    status: str
    message: str = ""
    """words that the message holds"""
    info: Callable[[Any], bool] | None = field(default=None, repr=False)
    """what must hold of the info, parsed"""
    confidence: float | None = None


NO_NUMBERS = {"a": np.nan, "b": -np.inf}

CASES = (
    Case("a right answer", _says(confidence=0.5), "ok", confidence=0.5),
    Case("an integer pose", _says(T_query_ref=_moved(int)), "ok"),
    Case("a float16 pose", _says(T_query_ref=_moved(np.float16)), "ok"),
    Case("a pose of nested lists", _says(T_query_ref=_moved(float).tolist()), "ok"),
    Case("a ragged pose", _says(T_query_ref=[[1.0, 0.0], [1.0]]), "error", "T_query_ref is not an array: ValueError"),
    Case("a pose of objects", _says(T_query_ref=_moved(object)), "error", "T_query_ref is an array of object"),
    Case("a pose of words", _says(T_query_ref=_moved(str)), "error", "T_query_ref is an array of <U"),
    Case("a complex pose", _says(T_query_ref=_moved(complex)), "error", "T_query_ref is an array of complex128"),
    Case("a pose of booleans", _says(T_query_ref=np.eye(4, dtype=bool)), "error", "T_query_ref is an array of bool"),
    Case("a pose that overflows", _says(T_query_ref=1e200 * (2 * np.eye(4) - 1)), "error", "not a rigid transform"),
    Case("a pose of NaN", _says(T_query_ref=np.full((4, 4), np.nan)), "error", "not finite"),
    Case("a pose of 3 x 3", _says(T_query_ref=np.eye(3)), "error", "(3, 3)"),
    Case("a mirrored pose", _says(T_query_ref=np.diag([-1.0, 1.0, 1.0, 1.0])), "error", "not a rigid transform"),
    Case("a pose whose __array__ raises", _says(T_query_ref=Raising()), "error", "ZeroDivisionError: on purpose"),
    Case("a pose 1e300 m away", _says(T_query_ref=np.eye(4) + 1e300 * np.eye(4, k=3)), "ok"),
    Case("another type", lambda: np.eye(4), "error", "returned ndarray, expected TrackResult"),
    Case("no result", lambda: None, "error", "returned NoneType, expected TrackResult"),
    Case("a result whose property raises", lambda: RaisingResult(np.eye(4)), "error", "LookupError: not known yet"),
    Case("a result that changes", lambda: ChangingResult(np.eye(4)), "ok"),
    Case("a huge confidence", _says(confidence=10**400), "error", "confidence is too large for a float"),
    Case("a confidence of NaN", _says(confidence=float("nan")), "error", "confidence is nan"),
    Case("an array as confidence", _says(confidence=np.ones(3)), "error", "confidence is an array of shape (3,)"),
    Case("a word as confidence", _says(confidence="0.5"), "error", "confidence is '0.5', expected a finite number"),
    Case("a complex confidence", _says(confidence=1j), "error", "confidence is a complex, expected a finite number"),
    Case("a confidence that raises", _says(confidence=Raising(GeneratorExit)), "error", "GeneratorExit: on purpose"),
    Case("a boolean as confidence", _says(confidence=True), "ok", confidence=1.0),
    Case("a Decimal as confidence", _says(confidence=Decimal("0.25")), "ok", confidence=0.25),
    Case("a NumPy scalar as confidence", _says(confidence=np.float32(0.25)), "ok", confidence=0.25),
    Case("a long info", _says(info={"all": "x" * 200_000}), "ok", info=lambda i: i["characters"] == 200_011),
    Case("an info of a large array", _says(info={"all": np.zeros(10**6)}), "ok", info=lambda i: i["cut"]),
    Case("an info without end", _says(info=EndlessMapping()), "ok", info=lambda i: i["cut"]),
    Case("an info that raises", _says(info=RaisingMapping()), "ok", info=lambda i: "GeneratorExit" in i["info"]),
    Case("a cyclic info", _says(info=_cyclic()), "ok", info=lambda i: "nested deeper" in json.dumps(i)),
    Case("a NaN in the info", _says(info=NO_NUMBERS), "ok", info=lambda i: i == {"a": "nan", "b": "-inf"}),
    Case("an integer of 5,000 digits", _says(info={"n": 10**5000}), "ok", info=lambda i: "16610 bits" in i["n"]),
    Case("an info of objects", _says(info={"a": Raising(), (1, 2): {3}}), "ok", info=lambda i: i["(1, 2)"] == "{3}"),
    Case("a list as info", _says(info=[1, 2]), "ok", info=lambda i: i == {"info": "[1, 2]"}),
    Case("no info", _says(info=None), "ok", info=lambda i: i == {}),
    Case("a subclass of str", _says(message=LoudText("x"), info={"a": LoudText("x")}), "ok", "loud ?[31m words??"),
    Case("a long message", _says(message="word " * 100_000), "ok", "word word"),
    Case("a message that raises", _says(message=Raising()), "ok", "whose __str__ raised ZeroDivisionError"),
    Case("a failure that claims to be ok", lambda: TrackResult.failure("dark", status="ok"), "failed", "dark"),
    Case("an exception without words", _raises(Unspeakable()), "error", "whose __str__ raised ValueError"),
    Case("a BaseException", _raises(BaseException("base")), "error", "BaseException: base"),
    Case("a GeneratorExit", _raises(GeneratorExit("closed")), "error", "GeneratorExit: closed"),
    Case("a KeyboardInterrupt of its own", _raises(KeyboardInterrupt("mine")), "error", "KeyboardInterrupt: mine"),
    Case("a SystemExit", _raises(SystemExit(3)), "error", "SystemExit: 3"),
    Case("a RecursionError", _recurse, "error", "RecursionError"),
)  # fmt: skip


def case_of(reference_ns: int, query_ns: int) -> Case:
    """By the pair: query i with keyframe i, then query i with keyframe i - 1."""
    keyframe, query = ((time - START_NS) % 10**15 // STEP_NS for time in (reference_ns, query_ns))
    number = query if query == keyframe else FRAMES + keyframe
    return CASES[number] if number < len(CASES) else CASES[0]


class Misbehaving:
    """Does at each pair what :data:`CASES` says."""

    uses_times = True  # it knows the pairs by them

    def track(self, reference: Reference, query: Query, prior: Any = None) -> Any:
        return case_of(time_of(reference), time_of(query)).answer()


class Batching:
    """Breaks batches as ``answer`` chooses: ``breaks`` raises at every tenth query, from the fourth on."""

    uses_times = True  # it knows the pairs by them

    def __init__(self, answer: str = "good") -> None:
        self.answer = answer

    def track(self, reference: Any, query: Query, prior: Any = None) -> TrackResult:
        return TrackResult(np.eye(4))

    def track_batch(self, reference: Any, queries: list[Query], priors: list[Any]) -> Any:
        right = [TrackResult(np.eye(4)) for _ in queries]
        if self.answer == "endless":
            return (TrackResult(np.eye(4)) for _ in iter(int, 1))
        if self.answer == "few":
            return right[1:]
        if self.answer == "number":
            return 7
        return self._breaking(queries)

    def _breaking(self, queries: list[Query]) -> Iterator[TrackResult]:
        for query in queries:
            if time_of(query) // STEP_NS % 10 == 3:
                raise GeneratorExit("in the middle")
            yield TrackResult(np.eye(4))


class Declaring(Batching):
    """Declares something that is not what it should be."""

    track_batch = None  # type: ignore[assignment]

    def __init__(self, what: str = "word") -> None:
        self.what = what

    @property
    def neighbours(self) -> Any:
        if self.what == "raises":
            raise LookupError("not known yet")
        return {"word": "many", "negative": -1, "huge": 10**30, "number": 2, "array": np.ones(3), "object": Raising()}[
            self.what
        ]

    @property
    def uses_prior(self) -> Any:
        raise LookupError("not known yet")
