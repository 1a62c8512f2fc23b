"""Asking a tracker, and the one place where its answers are checked and cut to size.

Whatever a tracker returns or raises becomes a record of plain values that can be written and read again: by every way
of asking, into a results folder, in the validation of a training, or in ``relocbench check-method``.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.errors import one_line
from relocbench.evaluation.common.guard import guarded, offers
from relocbench.evaluation.common.info_text import info_text
from relocbench.geometry import transform_to_tq
from relocbench.tracking import ContractFault, Query, SupportsBatch, plain_pixels, plain_result

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CheckedAnswer:
    """What a tracker answered, in plain values that nothing can change any more."""

    status: str
    """``ok``; ``failed``: the method said so; ``error``: it raised, or broke the contract"""
    T_query_ref: Array | None = None
    """(4, 4), rigid; None unless ``ok``"""
    confidence: float | None = None
    """finite"""
    message: str = ""
    """one line of at most 500 printable characters"""
    info: str = "{}"
    """a JSON object of at most 8192 characters"""

    @property
    def pose(self) -> list[float] | None:
        """``tx ty tz qx qy qz qw`` of ``T_query_ref``."""
        if self.T_query_ref is None:
            return None
        translation, quaternion = transform_to_tq(self.T_query_ref)
        return [*translation.tolist(), *quaternion.tolist()]


def broken(message: object) -> CheckedAnswer:
    """The method broke."""
    return CheckedAnswer("error", message=one_line(message), info=json.dumps({"status": "error"}))


def checked(result: object) -> CheckedAnswer:
    """Whatever a tracker returned for one query, checked, copied and cut to size. Raises nothing of the method's.

    An answer that breaks the contract is an ``error`` whose message says what was expected. A message or info that
    cannot be had costs itself alone.
    """
    answer, broke = guarded(lambda: _checked(result))
    return broken(f"the answer cannot be read: {broke}") if answer is None else answer


def _checked(result: object) -> CheckedAnswer:
    try:
        plain = plain_result(result)
    except ContractFault as fault:
        return broken(fault)
    status = "ok" if plain.answered else _stated(plain.info)
    message = "" if plain.message is None else one_line(plain.message)
    return CheckedAnswer(status, plain.T_query_ref, plain.confidence, message, info_text(plain.info))


def _stated(info: Any) -> str:
    """What it is that there is no pose: a failure, or an error where the method says so by ``info["status"]``."""
    told, _ = guarded(lambda: info.get("status") if isinstance(info, Mapping) else None)
    return "error" if type(told) is str and told == "error" else "failed"


def ask(
    tracker: Any, reference: Any, views: Sequence[Query], priors: Sequence[Array | None] | None = None
) -> tuple[list[CheckedAnswer], float]:
    """Answers to some queries of one reference, and the seconds they took together.

    A call of ``track_batch`` that raises is asked again query by query, so that the one that breaks it is the one that
    it costs.

    Args:
        reference: as the tracker's ``prepare`` gave it where it has one.
        priors: one (4, 4) or None for each query; None gives none to any.
    """
    each = [None] * len(views) if priors is None else priors
    start = time.perf_counter()
    if offers(tracker, SupportsBatch):
        taken, raised = _together(tracker, reference, views, each)
        if raised and len(views) > 1:
            taken = [_together(tracker, reference, [v], [p])[0][0] for v, p in zip(views, each, strict=True)]
    else:
        taken = [_one(tracker, reference, view, prior) for view, prior in zip(views, each, strict=True)]
    seconds = time.perf_counter() - start
    return [checked(result) if broke is None else broken(broke) for result, broke in taken], seconds


_Taken = tuple[Any, str | None]
"""what a method returned for one query, and how it broke"""


def _one(tracker: Any, reference: Any, view: Query, prior: Array | None) -> _Taken:
    return guarded(lambda: tracker.track(reference, view, _copy(prior)))


def _together(
    tracker: Any, reference: Any, views: Sequence[Query], priors: Sequence[Array | None]
) -> tuple[list[_Taken], bool]:
    """One result a query, and whether the call raised.

    The results may come from a generator: no more are taken than were asked for.
    """
    count = len(views)
    copies = [_copy(prior) for prior in priors]
    given, broke = guarded(lambda: list(islice(tracker.track_batch(reference, list(views), copies), count + 1)))
    if broke is not None:
        return [(None, broke)] * count, True
    if len(given) != count:
        found = str(len(given)) if len(given) < count else f"more than {count}"
        return [(None, f"track_batch returned {found} results for {count} queries")] * count, False
    return [(result, None) for result in given], False


def _copy(prior: Array | None) -> Array | None:
    """A prior as the method is shown it: it cannot be written to."""
    if prior is None:
        return None
    shown = prior.copy()
    shown.flags.writeable = False
    return shown


def checked_pixels(ends: object, broke: str | None, count: int) -> tuple[Array | None, str | None]:
    """Whatever ``match`` returned for ``count`` pixels, copied to (N, 2) float64; or None and how the method broke."""
    if broke is not None:
        return None, broke
    pixels, fault = guarded(lambda: _pixels(ends, count))
    if fault is not None:
        return None, f"the pixels cannot be read: {fault}"
    return (None, pixels) if isinstance(pixels, str) else (pixels, None)


def _pixels(ends: object, count: int) -> Array | str:
    try:
        return plain_pixels(ends, count)
    except ContractFault as fault:
        return str(fault)
