"""The failure policy: what a missing or failed answer costs.

1. A missing, failed or non-finite answer has infinite error.
2. The denominator of every share is every pair of the set, answered or not.
3. A prediction for an unknown pair, or a second one for the same pair, is an error and never dropped silently.
4. A failure is never replaced by the prior or the identity: nothing here makes up a pose.
5. No pair set is dropped from a mean: a method that misses one has no total, hence no rank.

By rules 1 and 2 every pair has a value in every metric below, so that a share is the plain mean of N values.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Indices, Mask
from relocbench.errors import DatasetError, PredictionError


def pose_array(poses: Iterable[ArrayLike | None]) -> Array:
    """(N, 4, 4) poses, NaN where there is none: so :func:`answered_pairs` knows it."""
    known = [np.full((4, 4), np.nan) if pose is None else pose for pose in poses]
    return np.array(known, dtype=np.float64).reshape(-1, 4, 4)


def answered_pairs(T_pred: ArrayLike, answered: ArrayLike | None = None) -> Mask:
    """Which pairs have an answer: those reported as answered whose pose is finite in every number.

    Args:
        T_pred: (N, 4, 4) poses; any values where there is no answer, by convention NaN.
        answered: (N,) False where the method failed or was never run; None if NaN poses mark those pairs.

    Returns:
        (N,) bool.

    Raises:
        ValueError: the shapes do not fit.
    """
    poses = np.asarray(T_pred, dtype=np.float64)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4):
        raise ValueError(f"predicted poses must be (N, 4, 4), got {poses.shape}")
    finite: Mask = np.all(np.isfinite(poses), axis=(1, 2))
    if answered is None:
        return finite
    claimed = np.asarray(answered, dtype=bool)
    if claimed.shape != (len(poses),):
        raise ValueError(f"answered must be ({len(poses)},), got {claimed.shape}")
    out: Mask = finite & claimed
    return out


def infinite_where_failed(error: ArrayLike, answered: ArrayLike) -> Array:
    """``error`` (N,) where the pair was answered and the error is a finite number, inf elsewhere."""
    e = np.asarray(error, dtype=np.float64)
    return np.where(np.asarray(answered, dtype=bool) & np.isfinite(e), e, np.inf)


def align_predictions(
    expected_keys: Sequence[Hashable],
    predicted_keys: Sequence[Hashable],
    *,
    path: Path | str | None = None,
    lines: Sequence[int] | None = None,
) -> Indices:
    """The position of each pair's answer among the predictions.

    Args:
        expected_keys: N keys of the set's pairs, by convention ``(ref_timestamp_ns, query_timestamp_ns)``.
        predicted_keys: M keys of the predictions, in any order.
        path: the predictions file, for the message.
        lines: M 1-based line numbers in ``path``, for the message.

    Returns:
        (N,) index into the predictions, -1 where the pair is missing.

    Raises:
        PredictionError: a prediction for a pair that the set does not hold, or a second one for the same
            pair.
        DatasetError: the set itself holds a pair twice.
    """
    row_of_pair = {key: row for row, key in enumerate(expected_keys)}
    if len(row_of_pair) != len(expected_keys):
        raise DatasetError(f"the pair set holds pair {_first_repeated(expected_keys)} twice; expected each once")
    index = np.full(len(expected_keys), -1, dtype=np.int64)
    for position, key in enumerate(predicted_keys):
        line = None if lines is None else lines[position]
        row = row_of_pair.get(key)
        if row is None:
            message = f"unknown pair {_printed(key)}; expected one of the {len(index)} pairs of the set"
            raise PredictionError(message, path, line)
        if index[row] >= 0:
            before = "" if lines is None else f" (first in line {lines[index[row]]})"
            raise PredictionError(f"duplicate pair {_printed(key)}{before}; expected each once", path, line)
        index[row] = position
    return index


def mean_over_pair_sets(values: Sequence[float | None]) -> float | None:
    """The mean over all pair sets, each with equal weight; None (a blank total) when any of them has no value."""
    present = [value for value in values if value is not None]
    if not values or len(present) < len(values):
        return None
    return float(np.mean(present))


def _first_repeated(keys: Sequence[Hashable]) -> str:
    seen: set[Hashable] = set()
    for key in keys:
        if key in seen:
            return _printed(key)
        seen.add(key)
    raise ValueError("no key is repeated")


def _printed(key: Hashable) -> str:
    """A pair's key as prediction files write it."""
    return " ".join(map(str, key)) if isinstance(key, tuple) else str(key)
