"""One series for each road: the pair sets of one road are not independent of each other.

Two pair sets of one road see the same streets, and often share a drive: what is hard at a corner is hard in all of
them. So a road, not a pair set, is what intervals and ranks count. Its pair sets are averaged along the road before
anything is estimated: what they have in common stays in the variance of the series and in the correlation of its
neighbours, and what is independent averages out. A dataset is one road unless the caller knows more.

A mean over pair sets is the mean of a series exactly (the linearization of survey statistics; Särndal, Swensson and
Wretman, "Model Assisted Survey Sampling", 1992, section 5.5). With S sets of ``N_s`` values ``x`` with means ``m_s``,
and ``m`` the mean of the means, the value of the k-th of N stretches is

    ``y_k = m + N / S * sum over the sets and over the pairs of stretch k of (x - m_s) / N_s``,

whose mean over k is ``m``. Where all sets have N pairs, it is the mean over the sets of the k-th value.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array


def by_road(pair_sets: Sequence[Array], roads: Sequence[Hashable] | None = None) -> list[Array]:
    """One series for each road, from its pair sets aligned by the progress along them.

    A set is cut into as many stretches as the road's shortest set has pairs; the stretches of one set differ by at
    most one pair. That sets see the same place at the same progress need not hold exactly: what they share, shifted by
    a few pairs, is found as a correlation of neighbours.

    Args:
        pair_sets: (..., N_s) values of each set, ordered along the road, with the same leading dimensions.
        roads: the road of each set; None where all sets are of one road.

    Returns:
        (..., N) for each road, N that of its shortest set, in the order of the roads' first sets. A road with one set
        has that set's values.

    Raises:
        ValueError: roads of more or fewer sets, or a set without pairs.
    """
    return [x.mean(axis=0) if len(x) > 1 else x[0] for x in aligned(pair_sets, roads)]


def aligned(pair_sets: Sequence[Array], roads: Sequence[Hashable] | None = None) -> list[Array]:
    """The sets of each road stretch by stretch: (S, ..., N) each, whose mean over the S sets is :func:`by_road`."""
    return [_aligned([pair_sets[i] for i in of]) for of in _sets_of_roads(len(pair_sets), roads)]


def by_place(pair_sets: Sequence[ArrayLike], places: Sequence[ArrayLike]) -> Array:
    """One series of the sets of one road, from values whose places are known.

    Args:
        pair_sets: (N_s,) values of each set.
        places: (N_s,) the place of each value, by number or name, which means the same in all sets.

    Returns:
        (P,) one value for each place that occurs in any set, in the order of the sorted places; its mean is the mean
        over the sets of the mean over a set's values.

    Raises:
        ValueError: no sets, a set without values, or places of other values.
    """
    sets = [np.asarray(v, dtype=np.float64) for v in pair_sets]
    named = [np.asarray(p) for p in places]
    if not sets or [v.shape for v in sets] != [p.shape for p in named] or any(v.ndim != 1 or not v.size for v in sets):
        raise ValueError("values by place need one or more sets of (N_s,) values, and one place for each value")
    known, place = np.unique(np.concatenate(named), return_inverse=True)
    deviations = np.concatenate([(v - v.mean()) / len(v) for v in sets])
    mean = math.fsum(float(v.mean()) for v in sets) / len(sets)
    sums = np.bincount(place, weights=deviations, minlength=len(known))
    out: Array = (mean + sums * (len(known) / len(sets))).astype(np.float64)
    return out


MOST_PATTERNS = 2**13
"""patterns of signs, at most: all those of up to 14 roads"""


def sign_patterns(roads: int, rng: np.random.Generator) -> Array:
    """(patterns, roads) of 1 and -1, of which the first has no minus.

    Between equal methods a road's difference is as likely the one way as the other. All patterns are gone through where
    they are not too many, but for those with every sign turned, which change no absolute value; else they are drawn.
    """
    if 2 ** (roads - 1) <= MOST_PATTERNS:
        minus = np.arange(2 ** (roads - 1))[:, None] >> np.arange(roads) & 1
    else:
        minus = rng.integers(2, size=(MOST_PATTERNS, roads))
        minus[0] = 0
    return np.where(minus, -1.0, 1.0)


def _sets_of_roads(count: int, roads: Sequence[Hashable] | None) -> list[list[int]]:
    if roads is not None and len(roads) != count:
        raise ValueError(f"expected one road for each of {count} pair sets, got {len(roads)}")
    found: dict[Hashable, list[int]] = {}
    for index, road in enumerate([None] * count if roads is None else roads):
        found.setdefault(road, []).append(index)
    return list(found.values())


def _aligned(sets: Sequence[Array]) -> Array:
    """The sets of one road by stretches. (..., N_s) each -> (S, ..., N); each set keeps its mean."""
    lengths = [x.shape[-1] for x in sets]
    stretches = min(lengths)
    if stretches == 0:
        raise ValueError("a pair set needs at least one pair")
    out = []
    for x, length in zip(sets, lengths, strict=True):
        if length == stretches:
            out.append(x)
            continue
        mean = x.mean(axis=-1, keepdims=True)
        first = np.arange(stretches) * length // stretches
        out.append(mean + np.add.reduceat(x - mean, first, axis=-1) * (stretches / length))
    return np.stack(out)
