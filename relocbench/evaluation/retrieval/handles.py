"""Calling a retriever, in this process or in a worker process: its result, the seconds it took, and how it broke."""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from relocbench.errors import MethodError, RelocbenchError
from relocbench.evaluation.common.guard import guarded, implements
from relocbench.evaluation.common.info_text import info_text
from relocbench.evaluation.common.worker import CONSTRUCTOR
from relocbench.evaluation.common.worker_losses import HOPELESS, TRIES, given_up_message, is_final, loss_message
from relocbench.evaluation.retrieval.output_checks import checked_descriptors, checked_scores, rerank_top_of
from relocbench.execution import MANY_TIMES, Limits, Loss, Run, messages_to_stderr, run_limited, step
from relocbench.methods import MethodSpec
from relocbench.retrieval import (
    Descriptors,
    FittingRetriever,
    ImageView,
    Retriever,
)

CallResult = tuple[Any, float, str]
"""what a call returned, its seconds, and how it broke (empty if it did not)"""


class RetrieverHandle(Protocol):
    """A retriever that can be called."""

    fits: bool
    rerank_top: int
    """K, the number of candidates that it reranks; 0 if it does not rerank"""
    rerank_fault: str
    """what is wrong with its ``rerank_top``; empty if nothing is"""

    @property
    def info(self) -> dict[str, Any]:
        """The retriever's own ``info``, as plain values."""
        ...

    def fit(self, gallery: Sequence[ImageView], seed: int) -> CallResult: ...
    def describe(self, images: Sequence[ImageView]) -> CallResult: ...
    def rerank(self, query: Descriptors, candidates: Descriptors) -> CallResult: ...


class LocalRetriever:
    """A retriever in this process. A bad image, or a MethodError that the method raises, ends the run."""

    def __init__(self, retriever: Retriever) -> None:
        self._retriever: Any = retriever
        self._warm = False
        self.fits = implements(retriever, FittingRetriever)
        self.rerank_top, fault = rerank_top_of(retriever)
        self.rerank_fault = fault or ""

    @property
    def info(self) -> dict[str, Any]:
        told, _ = guarded(lambda: getattr(self._retriever, "info", None))
        return dict(json.loads(info_text(told))) if guarded(lambda: isinstance(told, Mapping))[0] is True else {}

    def fit(self, gallery: Sequence[ImageView], seed: int) -> CallResult:
        return _timed(lambda: self._retriever.fit(gallery, seed), MANY_TIMES)

    def describe(self, images: Sequence[ImageView]) -> CallResult:
        for view in images:
            view.image  # noqa: B018  read it before the clock starts
        if not self._warm:  # compilation and first allocations should not count as the method's speed
            self._warm = True
            _timed(lambda: self._retriever.describe(images[:1]), MANY_TIMES)
        values, seconds, broke = _timed(lambda: self._retriever.describe(images), min(float(len(images)), MANY_TIMES))
        values, fault = checked_descriptors(values, broke or None, len(images))
        return values, seconds, fault or ""

    def rerank(self, query: Descriptors, candidates: Descriptors) -> CallResult:
        values, seconds, broke = _timed(lambda: self._retriever.rerank(query, candidates), 1.0)
        scores, fault = checked_scores(values, broke or None, len(candidates))
        return scores, seconds, fault or ""


@dataclass(frozen=True)
class _About:
    fits: bool
    rerank_top: int
    rerank_fault: str


@dataclass(frozen=True)
class _Request:
    token: str
    spec: MethodSpec
    what: str
    given: tuple[Any, ...] = ()
    fitted: bool = False
    """whether the request makes sense only to a retriever that was fitted"""


class WorkerRetriever:
    """A retriever in a worker process. A worker that dies costs the call in progress; a fresh one is fitted again.

    Raises:
        MethodError: the retriever's constructor raises.
    """

    def __init__(self, spec: MethodSpec, limits: Limits) -> None:
        self._spec = spec
        self._run = Run(1, limits=limits)  # a single process, since the fitted state lives in it
        self._token = uuid.uuid4().hex
        self._fitted_by: tuple[Any, ...] = ()
        self._answered = False
        self._losses = 0
        self._gone = ""
        about, _, broke = self._call("about", (), tries=TRIES)
        if broke:
            self._gone = f"{CONSTRUCTOR}: {broke}"
        self.fits = not broke and about.fits
        self.rerank_top = 0 if broke else about.rerank_top
        self.rerank_fault = "" if broke else about.rerank_fault

    @property
    def info(self) -> dict[str, Any]:
        told, _, broke = self._call("info", (), tries=1)
        return {} if broke else dict(told)

    def fit(self, gallery: Sequence[ImageView], seed: int) -> CallResult:
        self._fitted_by = ()
        told = self._call("fit", (gallery, seed), tries=TRIES)
        self._fitted_by = (gallery, seed)
        return told

    def describe(self, images: Sequence[ImageView]) -> CallResult:
        return self._call("describe", (images,), tries=TRIES if len(images) == 1 else 1)

    def rerank(self, query: Descriptors, candidates: Descriptors) -> CallResult:
        return self._call("rerank", (query, candidates), tries=TRIES)

    def _call(self, what: str, given: tuple[Any, ...], tries: int) -> CallResult:
        if self._gone:
            return None, 0.0, self._gone
        told: CallResult | Loss | None = None
        for attempt in range(1, tries + 1):
            told = self._send(_Request(self._token, self._spec, what, given, bool(self._fitted_by)))
            if told is None:  # a fresh process
                fitted = self._send(_Request(self._token, self._spec, "fit", self._fitted_by))
                again = _Request(self._token, self._spec, what, given, True)
                told = fitted if isinstance(fitted, Loss) else self._send(again)
            if not isinstance(told, Loss) or is_final(told, attempt):
                break
        if isinstance(told, Loss):
            message = loss_message(told, "")
            self._losses += 1
            if self._losses >= HOPELESS and not self._answered:
                self._gone = given_up_message(message, "calls, it was not asked again")
            return None, 0.0, message
        assert told is not None, "a process that was fitted a moment ago"
        self._answered |= what == "describe" and not told[2]
        return told

    def _send(self, request: _Request) -> CallResult | Loss | None:
        done = run_limited(_serve, [request], self._run, on_loss=lambda request, loss: loss)
        out: CallResult | Loss | None = next(told for _, told in done)
        return out


def retriever_handle(spec: MethodSpec, run: Run) -> RetrieverHandle:
    """The retriever in a worker process, or in this process if ``run`` has no workers. Raises MethodError."""
    return LocalRetriever(create_retriever(spec)) if run.workers == 0 else WorkerRetriever(spec, run.limits)


def create_retriever(spec: MethodSpec) -> Retriever:
    """Construct the retriever. Raises MethodError."""
    made: Retriever = spec.create()
    if not implements(made, Retriever):
        made_of = f"made a thing of type {type(made).__name__}"
        raise MethodError(f"retriever '{spec.label}': {spec.target} {made_of}, which has no describe()")
    return made


_retrievers: dict[str, LocalRetriever] = {}
"""in a worker process: the retriever that was called last"""


def _serve(request: _Request) -> Any:
    """Answer one request; None if the retriever is new and should have been fitted before."""
    if request.token not in _retrievers:
        if request.fitted:
            return None
        _retrievers.clear()
        with step(CONSTRUCTOR, times=MANY_TIMES):
            _retrievers[request.token] = LocalRetriever(create_retriever(request.spec))
    asked = _retrievers[request.token]
    if request.what == "about":
        return _About(asked.fits, asked.rerank_top, asked.rerank_fault), 0.0, ""
    if request.what == "info":
        with step(""):
            return asked.info, 0.0, ""
    return getattr(asked, request.what)(*request.given)


def _timed(call: Callable[[], Any], times: float) -> CallResult:
    """Call as :func:`~relocbench.evaluation.common.guard.guarded` does, but let any RelocbenchError through."""
    raised: list[RelocbenchError] = []

    def kept() -> Any:
        try:
            return call()
        except RelocbenchError as bad:
            raised.append(bad)
            raise

    start = time.perf_counter()
    with messages_to_stderr(), step("", times=times):
        value, broke = guarded(kept)
    seconds = time.perf_counter() - start
    if raised:
        raise raised[0]
    return value, seconds, broke or ""
