"""Checking what a retriever returns, and copying it to plain arrays before it is used."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array
from relocbench.evaluation.isolation.guard import guarded

MOST_RERANKED = 1_000_000
"""candidates of a query that a retriever may ask to rerank"""


def fault_of(values: object, count: int, dimensions: int | None = None) -> str | None:
    """The reason why ``values`` are not valid descriptors of ``count`` images, or None if they are.

    Args:
        dimensions: length of earlier descriptors, if there are any.
    """
    if not isinstance(values, np.ndarray) or not _is_float(values):
        kind = f"an array of {values.dtype}" if isinstance(values, np.ndarray) else type(values).__name__
        return f"describe returned {kind}, expected an array of float32 or float64"
    if values.ndim != 2 or len(values) != count or values.shape[1] == 0:
        return f"describe returned shape {values.shape} for {count} images, expected ({count}, D)"
    if dimensions is not None and values.shape[1] != dimensions:
        return f"describe returned {values.shape[1]} numbers an image, {dimensions} before"
    return None


def _is_float(values: NDArray[Any]) -> bool:
    return np.issubdtype(values.dtype, np.floating) and values.dtype.itemsize <= 8


def checked_descriptors(
    values: object, crash: str | None, count: int
) -> tuple[NDArray[np.floating] | None, str | None]:
    """What ``describe`` returned for ``count`` images as a plain array (N, D), or None and an error message."""
    plain, fault = _plain(values, crash, "describe")
    fault = fault or fault_of(plain, count)
    return (None, fault) if fault else (plain, None)


def _plain(values: object, crash: str | None, call: str) -> tuple[Any, str | None]:
    """What a call returned, a subclass of ndarray, which could behave differently at each look, as a plain array."""
    if crash is not None:
        return None, crash
    plain, crash = guarded(lambda: np.asarray(values) if isinstance(values, np.ndarray) else values)
    return plain, crash and f"what {call} returned cannot be read: {crash}"


def rerank_top_of(retriever: object) -> tuple[int, str | None]:
    """The number of candidates that a retriever reranks, 0 for none; and what is wrong with its ``rerank_top``."""
    if guarded(lambda: callable(getattr(retriever, "rerank", None)))[0] is not True:
        return 0, None
    top, crash = guarded(lambda: operator.index(getattr(retriever, "rerank_top", 0)))
    if crash is not None or not 0 <= top <= MOST_RERANKED:
        shown = crash or str(top)[:30]
        return 0, f"its attribute 'rerank_top' is not a whole number from 0 to {MOST_RERANKED}: {shown}"
    return int(top), None


def checked_scores(values: object, crash: str | None, count: int) -> tuple[Array | None, str | None]:
    """What ``rerank`` returned for ``count`` candidates as (K,) float64, or None and an error message."""
    plain, fault = _plain(values, crash, "rerank")
    if fault:
        return None, fault
    if not isinstance(plain, np.ndarray) or plain.shape != (count,):
        shape = f"shape {plain.shape}" if isinstance(plain, np.ndarray) else type(plain).__name__
        return None, f"rerank returned {shape} for {count} candidates, expected ({count},)"
    if not np.issubdtype(plain.dtype, np.floating):
        return None, f"rerank returned an array of {plain.dtype}, expected scores that are floats"
    with np.errstate(over="ignore"):
        scores = plain.astype(np.float64)
    return (scores, None) if np.isfinite(scores).all() else (None, "rerank returned scores that are not finite floats")
