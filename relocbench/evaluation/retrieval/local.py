"""A retriever in this process: its results, the seconds they took, and how it crashed."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from relocbench.errors import MethodError, RelocbenchError
from relocbench.evaluation.isolation.guard import guarded, implements
from relocbench.evaluation.isolation.info_text import info_text
from relocbench.evaluation.retrieval.output_checks import checked_descriptors, checked_scores, rerank_top_of
from relocbench.execution import MANY_TIMES, messages_to_stderr, step
from relocbench.methods import MethodSpec
from relocbench.retrieval import Descriptors, FittingRetriever, ImageView, Retriever

CallResult = tuple[Any, float, str]
"""what a call returned, its seconds, and how it crashed (empty if it did not)"""


class LocalRetriever:
    """A retriever in this process. A bad image, or a MethodError that the method raises, ends the run."""

    peak_memory_bytes: int | None = None

    def __init__(self, retriever: Retriever) -> None:
        self._retriever: Any = retriever
        self._warm = False
        self.fits = implements(retriever, FittingRetriever)
        self.rerank_top, fault = rerank_top_of(retriever)
        self.rerank_fault = fault or ""

    @property
    def info(self) -> dict[str, Any]:
        info, _ = guarded(lambda: getattr(self._retriever, "info", None))
        return dict(json.loads(info_text(info))) if guarded(lambda: isinstance(info, Mapping))[0] is True else {}

    def fit(self, gallery: Sequence[ImageView], seed: int) -> CallResult:
        return _timed(lambda: self._retriever.fit(gallery, seed), MANY_TIMES)

    def describe(self, images: Sequence[ImageView]) -> CallResult:
        for view in images:
            view.image  # noqa: B018  read it before the clock starts
        if not self._warm:
            self.warm_up(images)
        values, seconds, crash = _timed(lambda: self._retriever.describe(images), min(float(len(images)), MANY_TIMES))
        values, fault = checked_descriptors(values, crash or None, len(images))
        return values, seconds, fault or ""

    def warm_up(self, images: Sequence[ImageView]) -> CallResult:
        """Describe one image without checks: compilation and first allocations are not the method's speed."""
        self._warm = True
        _timed(lambda: self._retriever.describe(images[:1]), MANY_TIMES)
        return None, 0.0, ""

    def rerank(self, query: Descriptors, candidates: Descriptors) -> CallResult:
        values, seconds, crash = _timed(lambda: self._retriever.rerank(query, candidates), 1.0)
        scores, fault = checked_scores(values, crash or None, len(candidates))
        return scores, seconds, fault or ""


def create_retriever(spec: MethodSpec) -> Retriever:
    """Construct the retriever. Raises MethodError."""
    made: Retriever = spec.create()
    if not implements(made, Retriever):
        made_of = f"made a thing of type {type(made).__name__}"
        raise MethodError(f"retriever '{spec.label}': {spec.target} {made_of}, which has no describe()")
    return made


def _timed(call: Callable[[], Any], times: float) -> CallResult:
    """Call as :func:`~relocbench.evaluation.isolation.guard.guarded` does, but let any RelocbenchError through."""
    raised: list[RelocbenchError] = []

    def kept() -> Any:
        try:
            return call()
        except RelocbenchError as bad:
            raised.append(bad)
            raise

    start = time.perf_counter()
    with messages_to_stderr(), step("", times=times):
        value, crash = guarded(kept)
    seconds = time.perf_counter() - start
    if raised:
        raise raised[0]
    return value, seconds, crash or ""
