"""A retriever in a process of its own, which is handed images and nothing else."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from typing import Any

from relocbench.arrays import Image
from relocbench.errors import MethodError, one_line
from relocbench.evaluation.isolation.info_text import info_text
from relocbench.evaluation.isolation.method_process import FORGED, MethodProcess, crash_of
from relocbench.evaluation.retrieval.local import CallResult
from relocbench.evaluation.retrieval.output_checks import MOST_RERANKED, checked_descriptors, checked_scores
from relocbench.execution import MANY_TIMES, Sandbox, step
from relocbench.methods import MethodSpec
from relocbench.retrieval import Descriptors, ImageView

_MODULE = "relocbench.evaluation.retrieval.isolated_process"


class IsolatedRetriever:
    """A :class:`~relocbench.evaluation.retrieval.handles.RetrieverHandle` whose retriever runs in a child process.

    Raises:
        MethodError: the retriever cannot be made.
    """

    def __init__(self, spec: MethodSpec, sandbox: Sandbox) -> None:
        self._process = MethodProcess(spec, _MODULE, sandbox)
        declared = self._process.declared
        self._warm = False
        self.fits = declared.get("fits") is True
        top = declared.get("rerank_top", 0)
        self.rerank_top = top if type(top) is int and 0 <= top <= MOST_RERANKED else 0
        self.rerank_fault = one_line(declared.get("rerank_fault") or "")

    @property
    def info(self) -> dict[str, Any]:
        answer, _ = self._process.ask(("info", ()))
        info = answer.get("info") if isinstance(answer, dict) else None
        return dict(json.loads(info_text(info))) if isinstance(info, dict) else {}

    @property
    def peak_memory_bytes(self) -> int | None:
        return self._process.peak_memory_bytes

    def fit(self, gallery: Sequence[ImageView], seed: int) -> CallResult:
        def image_of(index: Any) -> Image:
            if type(index) is not int or not 0 <= index < len(gallery):
                raise MethodError(f"{FORGED}: it needs image {one_line(index, 40)} of {len(gallery)}")
            return gallery[index].image

        named = [(view.key, view.view) for view in gallery]
        _, seconds, crash = self._timed(("fit", (named, seed)), MANY_TIMES, needed=image_of)
        return None, seconds, crash

    def describe(self, images: Sequence[ImageView]) -> CallResult:
        shown = [(view.key, view.view, view.image) for view in images]
        if not self._warm:  # compilation and first allocations should not count as the method's speed
            self._warm = True
            self._timed(("warm_up", (shown[:1],)), MANY_TIMES)
        values, seconds, crash = self._timed(("describe", (shown,)), min(float(len(images)), MANY_TIMES))
        descriptors, fault = checked_descriptors(values, crash or None, len(images))
        return descriptors, seconds, fault or ""

    def rerank(self, query: Descriptors, candidates: Descriptors) -> CallResult:
        values, seconds, crash = self._timed(("rerank", (query, candidates)), 1.0)
        scores, fault = checked_scores(values, crash or None, len(candidates))
        return scores, seconds, fault or ""

    def close(self) -> None:
        """End the process."""
        self._process.close()

    def _timed(self, request: Any, times: float, needed: Callable[[Any], Any] | None = None) -> tuple[Any, float, str]:
        start = time.perf_counter()
        with step("", times=times):
            answer, arrays = self._process.ask(request, needed)
        seconds = time.perf_counter() - start
        if isinstance(answer, dict) and "raised" in answer:
            raise MethodError(one_line(answer["raised"], 2000))
        return arrays[0] if arrays else None, seconds, crash_of(answer) or ""
