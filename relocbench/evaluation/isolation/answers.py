"""Calls of a tracker, and the one place where its answers are checked and truncated.

Whatever a tracker returns or raises becomes a record of plain values that can be written to a file and read back.
Every caller uses this module: evaluation, the validation of a training, and ``relocbench check-method``.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

from relocbench.arrays import Array
from relocbench.errors import one_line
from relocbench.evaluation.isolation.guard import guarded, implements
from relocbench.evaluation.isolation.info_text import info_text
from relocbench.evaluation.isolation.views import read_only
from relocbench.geometry import transform_to_tq
from relocbench.tracking import ContractFault, Query, SupportsBatch, plain_pixels, plain_result


@dataclass(frozen=True, eq=False)
class CheckedAnswer:
    """A tracker's answer as plain values that nothing can change any more."""

    status: str
    """``ok``; ``failed``: the method reported a failure; ``error``: it raised, or broke the contract"""
    T_query_ref: Array | None = None
    """(4, 4), rigid; None unless ``ok``"""
    confidence: float | None = None
    """finite, or None"""
    message: str = ""
    """one line of at most 500 printable characters"""
    info: str = "{}"
    """a JSON object of at most 8192 characters"""

    @property
    def pose(self) -> list[float] | None:
        """``tx ty tz qx qy qz qw`` of ``T_query_ref``; None unless ``ok``."""
        if self.T_query_ref is None:
            return None
        translation, quaternion = transform_to_tq(self.T_query_ref)
        return [*translation.tolist(), *quaternion.tolist()]


def error_answer(message: object) -> CheckedAnswer:
    """The answer recorded for a method that raised or broke the contract."""
    return CheckedAnswer("error", message=one_line(message), info=json.dumps({"status": "error"}))


def checked_answer(result: object) -> CheckedAnswer:
    """Check, copy and truncate whatever a tracker returned for one query. No exception of the method's gets out.

    An answer that breaks the contract becomes an ``error`` whose message says what was expected. A message or info
    that cannot be read is replaced, and the rest of the answer stands.
    """
    answer, crash = guarded(lambda: _checked(result))
    return error_answer(f"the answer cannot be read: {crash}") if answer is None else answer


def _checked(result: object) -> CheckedAnswer:
    try:
        plain = plain_result(result)
    except ContractFault as fault:
        return error_answer(fault)
    status = "ok" if plain.answered else _status_without_pose(plain.info)
    message = "" if plain.message is None else one_line(plain.message)
    return CheckedAnswer(status, plain.T_query_ref, plain.confidence, message, info_text(plain.info))


def _status_without_pose(info: Any) -> str:
    """The status of an answer without a pose: ``error`` if ``info["status"]`` is that, else ``failed``."""
    status, _ = guarded(lambda: info.get("status") if isinstance(info, Mapping) else None)
    return "error" if type(status) is str and status == "error" else "failed"


def ask(
    tracker: Any, reference: Any, views: Sequence[Query], priors: Sequence[Array | None] | None = None
) -> tuple[list[CheckedAnswer], float]:
    """Ask a tracker about some queries of one reference.

    Where a call of ``track_batch`` raises, its queries are tried again one by one, so that only the query that caused
    it is lost.

    Args:
        reference: what the tracker's ``prepare`` returned, or the reference itself where it has none.
        priors: a (4, 4) pose or None for each query; None for no priors at all.

    Returns:
        the checked answers, and the seconds that the calls took together.
    """
    each = [None] * len(views) if priors is None else priors
    start = time.perf_counter()
    if implements(tracker, SupportsBatch):
        taken, raised = _ask_batch(tracker, reference, views, each)
        if raised and len(views) > 1:
            taken = [_ask_batch(tracker, reference, [v], [p])[0][0] for v, p in zip(views, each, strict=True)]
    else:
        taken = [_ask_single(tracker, reference, view, prior) for view, prior in zip(views, each, strict=True)]
    seconds = time.perf_counter() - start
    return [checked_answer(result) if crash is None else error_answer(crash) for result, crash in taken], seconds


_Taken = tuple[Any, str | None]
"""what a method returned for one query, and an error message or None"""


def _ask_single(tracker: Any, reference: Any, view: Query, prior: Array | None) -> _Taken:
    return guarded(lambda: tracker.track(reference, view, _shown(prior)))


def _ask_batch(
    tracker: Any, reference: Any, views: Sequence[Query], priors: Sequence[Array | None]
) -> tuple[list[_Taken], bool]:
    """The result of one ``track_batch`` call for each query, and whether the call raised.

    The results may come from a generator: at most one more is taken than was asked for.
    """
    count = len(views)
    copies = [_shown(prior) for prior in priors]
    given, crash = guarded(lambda: list(islice(tracker.track_batch(reference, list(views), copies), count + 1)))
    if crash is not None:
        return [(None, crash)] * count, True
    if len(given) != count:
        returned = str(len(given)) if len(given) < count else f"more than {count}"
        return [(None, f"track_batch returned {returned} results for {count} queries")] * count, False
    return [(result, None) for result in given], False


def _shown(prior: Array | None) -> Array | None:
    """A read-only copy of a prior, to be passed to the method."""
    return None if prior is None else read_only(prior.copy())


def checked_pixels(ends: object, crash: str | None, count: int) -> tuple[Array | None, str | None]:
    """What ``match`` returned for ``count`` pixels as a copy (N, 2) in float64, or None and an error message."""
    if crash is not None:
        return None, crash
    pixels, fault = guarded(lambda: _pixels(ends, count))
    if fault is not None:
        return None, f"the pixels cannot be read: {fault}"
    return (None, pixels) if isinstance(pixels, str) else (pixels, None)


def checked_levels(levels: Iterable[object], crash: str | None, count: int) -> tuple[list[Array], str | None]:
    """What ``match_levels`` returned, as :func:`checked_pixels` for each level; none if one of them is not valid."""
    checked: list[Array] = []
    for ends in levels:
        pixels, crash = checked_pixels(ends, crash, count)
        if pixels is None:
            return [], crash
        checked.append(pixels)
    return checked, crash


def _pixels(ends: object, count: int) -> Array | str:
    try:
        return plain_pixels(ends, count)
    except ContractFault as fault:
        return str(fault)
