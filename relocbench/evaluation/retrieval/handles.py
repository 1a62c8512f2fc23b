"""Calling a retriever, in this process or in a worker process: its result, the seconds it took, and how it crashed."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from relocbench.evaluation.isolation.losses import HOPELESS, TRIES, given_up_message, is_final, loss_message
from relocbench.evaluation.isolation.worker import CONSTRUCTOR
from relocbench.evaluation.retrieval.isolation import IsolatedRetriever
from relocbench.evaluation.retrieval.local import CallResult, LocalRetriever, create_retriever
from relocbench.execution import MANY_TIMES, Limits, Loss, Run, Sandbox, run_limited, step
from relocbench.methods import MethodSpec
from relocbench.retrieval import Descriptors, ImageView


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

    @property
    def peak_memory_bytes(self) -> int | None:
        """The most resident memory of its process so far; None where it has none of its own, or none is told."""
        ...

    def fit(self, gallery: Sequence[ImageView], seed: int) -> CallResult: ...
    def describe(self, images: Sequence[ImageView]) -> CallResult: ...
    def rerank(self, query: Descriptors, candidates: Descriptors) -> CallResult: ...


@dataclass(frozen=True)
class _About:
    fits: bool
    rerank_top: int
    rerank_fault: str


@dataclass(frozen=True)
class _Request:
    token: str
    spec: MethodSpec
    sandbox: Sandbox
    what: str
    given: tuple[Any, ...] = ()
    fitted: bool = False
    """whether the request makes sense only to a retriever that was fitted"""


class WorkerRetriever:
    """A retriever in a worker process. A worker that dies costs the call in progress; a fresh one is fitted again.

    Raises:
        MethodError: the retriever's constructor raises.
    """

    def __init__(self, spec: MethodSpec, limits: Limits, sandbox: Sandbox = Sandbox()) -> None:
        self._run = Run(1, limits=limits)  # a single process, since the fitted state lives in it
        self._request = partial(_Request, uuid.uuid4().hex, spec, sandbox)
        self._fitted_by: tuple[Any, ...] = ()
        self._answered = False
        self._losses = 0
        self._gone = ""
        about, _, crash = self._call("about", (), tries=TRIES)
        if crash:
            self._gone = f"{CONSTRUCTOR}: {crash}"
        self.fits = not crash and about.fits
        self.rerank_top = 0 if crash else about.rerank_top
        self.rerank_fault = "" if crash else about.rerank_fault

    @property
    def info(self) -> dict[str, Any]:
        info, _, crash = self._call("info", (), tries=1)
        return {} if crash else dict(info)

    @property
    def peak_memory_bytes(self) -> int | None:
        peak, _, _ = self._call("memory", (), tries=1)
        return None if peak is None else int(peak)

    def fit(self, gallery: Sequence[ImageView], seed: int) -> CallResult:
        self._fitted_by = ()
        result = self._call("fit", (gallery, seed), tries=TRIES)
        self._fitted_by = (gallery, seed)
        return result

    def describe(self, images: Sequence[ImageView]) -> CallResult:
        return self._call("describe", (images,), tries=TRIES if len(images) == 1 else 1)

    def rerank(self, query: Descriptors, candidates: Descriptors) -> CallResult:
        return self._call("rerank", (query, candidates), tries=TRIES)

    def _call(self, what: str, given: tuple[Any, ...], tries: int) -> CallResult:
        if self._gone:
            return None, 0.0, self._gone
        result: CallResult | Loss | None = None
        for attempt in range(1, tries + 1):
            result = self._send(self._request(what, given, bool(self._fitted_by)))
            if result is None:  # a fresh process
                fitted = self._send(self._request("fit", self._fitted_by))
                again = self._request(what, given, True)
                result = fitted if isinstance(fitted, Loss) else self._send(again)
            if not isinstance(result, Loss) or is_final(result, attempt):
                break
        if isinstance(result, Loss):
            message = loss_message(result, "")
            self._losses += 1
            if self._losses >= HOPELESS and not self._answered:
                self._gone = given_up_message(message, "calls, it was not run again")
            return None, 0.0, message
        assert result is not None, "a process that was fitted a moment ago"
        self._answered |= what == "describe" and not result[2]
        return result

    def _send(self, request: _Request) -> CallResult | Loss | None:
        done = run_limited(_serve, [[request]], self._run, on_loss=lambda request, loss: loss)
        out: CallResult | Loss | None = next(result for _, result in done)
        return out


def retriever_handle(spec: MethodSpec, run: Run) -> RetrieverHandle:
    """The retriever in a worker process, or in this process if ``run`` has no workers.

    Raises:
        MethodError: the retriever cannot be made.
        ConfigError: there must be a sandbox, and this system has none.
    """
    sandbox = run.sandbox_of_methods()
    return LocalRetriever(create_retriever(spec)) if run.workers == 0 else WorkerRetriever(spec, run.limits, sandbox)


_retrievers: dict[str, IsolatedRetriever] = {}
"""in a worker process: the retriever that was called last"""


def _serve(request: _Request) -> Any:
    """Answer one request; None if the retriever is new and should have been fitted before."""
    if request.token not in _retrievers:
        if request.fitted:
            return None
        for other in _retrievers.values():
            other.close()
        _retrievers.clear()
        with step(CONSTRUCTOR, times=MANY_TIMES):
            _retrievers[request.token] = IsolatedRetriever(request.spec, request.sandbox)
    handler = _retrievers[request.token]
    if request.what == "about":
        return _About(handler.fits, handler.rerank_top, handler.rerank_fault), 0.0, ""
    if request.what == "info":
        with step(""):
            return handler.info, 0.0, ""
    if request.what == "memory":
        return handler.peak_memory_bytes, 0.0, ""
    return getattr(handler, request.what)(*request.given)
