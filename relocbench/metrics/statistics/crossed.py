"""Differences of trained methods, whose uncertainty comes from the evaluated places and from the trainings.

With P places and S seeds of both methods, the difference at place p with seed s is taken as

    ``d_sp = mu + a_p + b_s + e_sp``:

the places a and the seeds b are two crossed random factors, and e is what a training does at a place by chance. This is
the design of several readers and several cases in radiology, with trainings as the readers (Dorfman, Berbaum and Metz,
"Receiver operating characteristic rating analysis: generalization to the population of readers and patients with the
jackknife method", Investigative Radiology 1992). The variance of the mean difference is

    ``V = var(a) / P + var(b) / S + var(e) / (P S) = v_a + v_b - v_e``,

with ``v_a = var(a) / P + var(e) / (P S)``, estimated by the variance of the places' means over P, ``v_b`` in the same
way by that of the seeds' means over S, and ``v_e`` by that of the residuals over P S. No component counts as negative:

    ``V = v_e + max(v_a - v_e, 0) + max(v_b - v_e, 0)``.

The degrees of freedom are Satterthwaite's ("An approximate distribution of estimates of variance components",
Biometrics Bulletin 1946):

    ``V^2 / (v_a^2 / (P - 1) + v_b^2 / (S - 1) + v_e^2 / ((P - 1) (S - 1)))``,

and lie between those of the seeds and those of the places, ``S - 1`` to ``P - 1``. Three seeds have two: where most of
the variance is that of trainings, Student's t at 95 % approaches 4.3.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array
from relocbench.metrics.statistics.effective_size import MIN_EFFECTIVE
from relocbench.metrics.statistics.intervals import (
    LEVEL,
    Difference,
    Interval,
    paired_difference,
    two_sided_p,
    with_two_pairs,
)


def crossed_difference(a: ArrayLike, b: ArrayLike) -> Difference:
    """The mean of A minus the mean of B, with an interval for other places and other trainings.

    Two places with the largest difference either way are added to the variance by places, as in
    :func:`relocbench.metrics.statistics.intervals.paired_difference`, whose interval for the means over the seeds lies
    within this one.

    Args:
        a, b: (S, P) values in 0..1 with each seed at each place, the same seeds and places in the same order. Single
            values of :func:`relocbench.metrics.per_group` may exceed 1.

    Returns:
        No interval for a single seed, or for fewer than :data:`MIN_EFFECTIVE` places.

    Raises:
        ValueError: the seeds or places differ, there are none, or values are not finite.
    """
    values_a, values_b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if values_a.ndim != 2 or values_a.size == 0 or values_a.shape != values_b.shape:
        raise ValueError(
            "a difference over seeds and places needs two non-empty (S, P) arrays of one shape, got "
            f"{values_a.shape} and {values_b.shape}"
        )
    if not (np.isfinite(values_a).all() and np.isfinite(values_b).all()):
        raise ValueError("values by seed and place must be finite numbers")
    difference = values_a - values_b
    seeds, places = difference.shape
    mean = float(difference.mean())
    if seeds < 2 or places < MIN_EFFECTIVE:
        return Difference(mean, None)
    from scipy.special import stdtrit

    by_place, by_seed = difference.mean(axis=0), difference.mean(axis=1)
    largest = float(np.abs(by_place).max()) or 1.0
    adjusted, of_places = with_two_pairs(mean, float(by_place.var()), largest, places)
    of_seeds = float(by_seed.var(ddof=1)) / seeds
    of_residuals = _variance_of_residuals(difference) / (places * seeds)
    variance = of_residuals + max(of_places - of_residuals, 0.0) + max(of_seeds - of_residuals, 0.0)
    spread = of_places**2 / (places - 1) + of_seeds**2 / (seeds - 1)
    spread += of_residuals**2 / ((places - 1) * (seeds - 1))
    freedom = min(max(variance**2 / spread, seeds - 1), places - 1)
    half = float(stdtrit(freedom, (1 + LEVEL) / 2)) * math.sqrt(variance)
    by_places = paired_difference([by_place], [np.zeros(places)], independent=True)
    assert by_places.interval is not None
    assert by_places.p is not None
    low, high = min(adjusted - half, by_places.interval.low), max(adjusted + half, by_places.interval.high)
    p = max(two_sided_p(adjusted, math.sqrt(variance), freedom), by_places.p)
    return Difference(mean, Interval(max(low, -1.0), min(high, 1.0), LEVEL), p)


def _variance_of_residuals(difference: Array) -> float:
    """The variance of what neither the seed nor the place explains. (S, P) -> one number."""
    seeds, places = difference.shape
    explained = difference.mean(axis=0) + difference.mean(axis=1, keepdims=True) - difference.mean()
    return float(np.sum((difference - explained) ** 2) / ((seeds - 1) * (places - 1)))
