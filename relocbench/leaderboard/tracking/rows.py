"""Computing the row of a tracker in a table from the errors of its pairs, without I/O."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from relocbench.arrays import Array
from relocbench.evaluation.tables.errors import ErrorTable
from relocbench.evaluation.tables.schema import ALL
from relocbench.leaderboard.common.loading import Plan, Standing
from relocbench.leaderboard.tracking.method import Method
from relocbench.leaderboard.tracking.model import MEDIANS, Row
from relocbench.metrics import (
    METRICS,
    DifferentPlaces,
    Interval,
    Metric,
    PairScores,
    median_interval,
    paired_difference,
    totals,
)


def tables_of(method: Method, plan: Plan) -> list[ErrorTable | None]:
    """The errors on the pairs of a table, by pair set; None where a pair set has no result."""
    return [None if (of := method.errors.get(name)) is None else of.of_group(plan.group) for name in plan.units]


def present(method: Method, plan: Plan) -> list[ErrorTable]:
    """The same without what is missing."""
    return [rows for rows in tables_of(method, plan) if rows is not None]


def row_of(method: Method, plan: Plan, standing: Standing, metric: Metric, identity: Method | None) -> Row:
    """The row of a method.

    Args:
        metric: the metric that ranks, in which the method is compared with the identity pose.
    """
    sets, known = tables_of(method, plan), present(method, plan)
    values = totals([None if rows is None else rows.summary for rows in sets])
    pairs = sum(map(len, known))
    if standing.missing:
        return Row(method, values, {}, None, missing=standing.missing, pairs=pairs)
    if len(sets) > 1:
        values |= _pooled(known)
    intervals = {**standing.intervals, **_of_medians(known)}
    above = None
    if identity is not None and identity is not method and all(name in identity.errors for name in plan.units):
        sign = 1.0 if metric.higher_is_better else -1.0
        above = paired_difference(
            [sign * per_pair(metric, rows) for rows in known],
            [sign * per_pair(metric, rows) for rows in present(identity, plan)],
        )
    return Row(
        method,
        values,
        intervals,
        standing.rank,
        sum(rows.with_status("failed") for rows in known),
        sum(rows.with_status("error") for rows in known),
        family=standing.family,
        pairs=pairs,
        answered=sum(rows.with_status("ok") for rows in known),
        above_identity=above,
        elsewhere=_elsewhere(method, plan) if plan.group == ALL else None,
    )


def per_pair(metric: Metric, rows: ErrorTable) -> Array:
    """(N,) the values of a metric that is a mean over pairs. Raises ValueError for another."""
    if metric.per_pair is None:
        raise ValueError(f"{metric.name} is not a mean over pairs")
    return metric.per_pair(rows.errors)


def errors_of(rows: ErrorTable) -> Array:
    """(2, N) the translation and rotation errors: by them, statistics know how alike neighbouring pairs are."""
    return np.stack([rows.errors.translation_error_m, rows.errors.rotation_error_deg])


def _elsewhere(method: Method, plan: Plan) -> DifferentPlaces | None:
    """The pairs of different places of the pair sets together; None where there are none."""
    tables = [method.elsewhere[name] for name in plan.units if name in method.elsewhere]
    return DifferentPlaces.total(table.different_places for table in tables) if tables else None


def _of_medians(sets: Sequence[ErrorTable]) -> Mapping[str, Interval | None]:
    """The intervals of the medians of one pair set; None over several."""
    if len(sets) > 1:
        return dict.fromkeys(MEDIANS)
    return {name: median_interval(of) for name, of in zip(MEDIANS, errors_of(sets[0]), strict=True)}


def _pooled(sets: Sequence[ErrorTable]) -> dict[str, float | None]:
    """Medians, percentiles and what confidences are worth, over the pairs of all sets together.

    A mean of medians would be infinite as soon as a method fails on half of the pairs of one set. In a mean over sets,
    the only answer to one of them would weigh as much as all the answers to another.
    """
    scores = PairScores.joined([rows.scores for rows in sets])
    return {m.name: m.compute(scores) for m in METRICS if m.per_pair is None}
