"""One table over several datasets: which methods are better on all of them together, each dataset counting once.

A dataset is one road: what its pair sets or tasks have in common does not average out. From
:data:`relocbench.metrics.statistics.intervals.MANY_ROADS` datasets on, a difference counts if it is also larger than
the spread of the datasets explains, and speaks of other streets; with fewer, ranks speak of these streets alone.
Datasets of one name, such as two versions of one, are one road, and so are the tiers of an edition's district.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from relocbench.datasets.core.edition_folder import road_of
from relocbench.evaluation.common.folders import AnswerFolder, SetLike
from relocbench.leaderboard.common.columns import (
    Column,
    Line,
    bounds_columns,
    by_key,
    family_column,
    number_column,
    rank_column,
    records,
    texts,
)
from relocbench.leaderboard.common.latex import LatexTable
from relocbench.leaderboard.common.loading import BoardTask, Plan, Standing, best_first, standings
from relocbench.leaderboard.common.model import Method, Row, about_ranks
from relocbench.leaderboard.common.text import METHOD, RANK, Value
from relocbench.metrics import generator
from relocbench.metrics.statistics.intervals import MANY_ROADS
from relocbench.pages.markdown import escaped, table_text

F = TypeVar("F", bound=AnswerFolder)
S = TypeVar("S", bound=SetLike)
U = TypeVar("U")
M = TypeVar("M", bound=Method)
M_co = TypeVar("M_co", bound=Method, covariant=True)
T = TypeVar("T")
R = TypeVar("R", bound=Row[Any])
LEAST, GREATEST = "least", "greatest"


@dataclass(frozen=True, eq=False)
class Everywhere(Generic[M_co]):
    """One method with its results on several datasets."""

    label: str
    answers: Mapping[str, M_co]
    """by title of the dataset"""


@dataclass(frozen=True, eq=False)
class Part(Generic[M]):
    """What one dataset contributes."""

    name: str
    title: str
    methods: Sequence[M]
    plan: Plan
    count: int
    """of its pairs or queries"""

    @property
    def road(self) -> str:
        return road_of(self.name)


@dataclass(frozen=True, eq=False)
class OverDatasets(Generic[M]):
    """A row for each method with results on any of the datasets; it has values if it has them on all."""

    name: str
    parts: tuple[Part[M], ...]
    metric: str
    """the metric that ranks, and the only one"""
    what: str
    """pairs or queries"""
    rows: tuple[Row[Everywhere[M]], ...]

    @property
    def roads(self) -> int:
        """How many datasets count, those of one road together."""
        return len({part.road for part in self.parts})

    @property
    def count(self) -> int:
        return sum(part.count for part in self.parts)

    @property
    def title(self) -> str:
        return f"{self.roads} datasets, {self.name}"

    @property
    def notes(self) -> list[str]:
        """Sentences without their full stops."""
        if self.roads < MANY_ROADS:
            speaks = f"Ranks and intervals speak of these {self.roads} datasets alone: others may rank otherwise"
        else:
            speaks = "Ranks and intervals speak of other streets as well: they allow for the spread of the datasets"
        fewer = f"{len(self.parts)} datasets of {self.roads} roads: those of one road count as one together"
        of_roads = fewer if self.roads < len(self.parts) else ""
        missing = "; ".join(f"{row.method.label} on {', '.join(row.missing)}" for row in self.rows if row.missing)
        missing = f"No results, hence no rank: {missing}" if missing else ""
        about = about_ranks(self.rows, self.metric, f"{self.count} {self.what}")
        return [note for note in (of_roads, speaks, about, missing) if note]


def over_datasets(
    task: BoardTask[F, S, U, M, T, R], name: str, parts: Sequence[Part[M]], metric: str, what: str, *, seed: int
) -> OverDatasets[M] | None:
    """Compare methods over all datasets together; None for fewer than two, and where no method has results on all.

    Args:
        name: of the table: with the metric and the seed it decides the draws.
        parts: any choice of datasets, such as all of one tier.
        metric: the metric that ranks.
        what: what is counted, pairs or queries.
    """
    on: dict[str, dict[str, M]] = {}
    for part in parts:
        for method in part.methods:
            on.setdefault(method.label, {})[part.title] = method
    missing = {label: tuple(part.title for part in parts if not _is_whole(part, own)) for label, own in on.items()}
    whole = {label: [(own[p.title], p.plan) for p in parts] for label, own in on.items() if not missing[label]}
    if len({part.road for part in parts}) < 2 or not whole:
        return None
    rng = generator(seed, f"over datasets {name}", metric)
    known = standings(task, whole, metric, rng, [part.road for part in parts])
    rows = []
    for label, own in on.items():
        standing = known.get(label) or Standing(None, {}, missing[label])
        values: dict[str, float | None] = dict.fromkeys((metric, LEAST, GREATEST))
        if label in whole:
            of_roads = _means(task, parts, whole[label], metric)
            values = {metric: math.fsum(of_roads) / len(of_roads), LEAST: min(of_roads), GREATEST: max(of_roads)}
        everywhere = Everywhere(label, own)
        rows.append(
            Row(everywhere, values, standing.intervals, standing.rank, missing=missing[label], family=standing.family)
        )
    in_order = best_first(task, rows, metric, lambda row: max(map(task.stands_last, row.method.answers.values())))
    return OverDatasets(name, tuple(parts), metric, what, tuple(in_order))


def _is_whole(part: Part[M], own: Mapping[str, M]) -> bool:
    return part.title in own and set(part.plan.units) <= own[part.title].answers.keys()


def _means(
    task: BoardTask[F, S, U, M, T, R], parts: Sequence[Part[M]], own: Sequence[tuple[M, Plan]], metric: str
) -> list[float]:
    """The mean of each road over the arrays of its parts."""
    of_roads: dict[str, list[float]] = {}
    for part, (method, plan) in zip(parts, own, strict=True):
        of_roads.setdefault(part.road, []).extend(float(x.mean()) for x in task.values(method, plan, metric))
    return [float(np.mean(of)) for of in of_roads.values()]


OverLine = Line[None, OverDatasets[Any], Row[Everywhere[Any]]]
OverColumn = Column[OverLine]


def over_columns(over: OverDatasets[Any]) -> dict[str, OverColumn]:
    """All columns by their keys, in the order of CSV."""
    metric = over.metric

    return by_key(
        [
            Column("table", lambda line: line.table.name),
            Column("datasets", lambda line: " ".join(part.title for part in line.table.parts)),
            Column(over.what, lambda line: line.table.count),
            Column(METHOD, lambda line: line.of_row(lambda row: row.method.label)),
            rank_column(),
            family_column(),
            Column("missing", lambda line: line.of_row(lambda row: " ".join(row.missing))),
            number_column(metric, higher_is_better=True),
            *bounds_columns([metric]),
            number_column(LEAST, higher_is_better=True),
            number_column(GREATEST, higher_is_better=True),
        ]
    )


def shown_columns(over: OverDatasets[Any], names: Sequence[str] = (RANK, METHOD)) -> list[OverColumn]:
    """The columns that people see, those of ``names`` first."""
    columns = over_columns(over)
    return [columns[key] for key in (*names, over.metric, LEAST, GREATEST)]


def over_text(over: OverDatasets[Any]) -> str:
    """The table in Markdown; what is not ranked though nothing is missing is in italics."""
    heads, rows = texts(shown_columns(over), over_lines(over))
    for cells, row in zip(rows, over.rows, strict=True):
        label = escaped(cells[1])
        cells[1] = f"{label} (missing)" if row.missing else label if row.rank is not None else f"*{label}*"
    return table_text(heads, rows, left=2)


def over_sections(tables: Sequence[OverDatasets[Any]]) -> list[dict[str, object]]:
    """What the macro of ``over.md.j2`` shows."""
    return [
        {
            "title": over.title,
            "what": over.what,
            "titles": [part.title for part in over.parts],
            "text": over_text(over),
            "notes": over.notes,
        }
        for over in tables
    ]


def over_records(tables: Sequence[OverDatasets[Any]]) -> list[dict[str, Value]]:
    """The rows of CSV and JSON."""
    return [record for over in tables for record in records(over_columns(over).values(), over_lines(over))]


def over_latex(over: OverDatasets[Any]) -> LatexTable[OverLine]:
    """The table for papers."""
    columns = over_columns(over)
    return LatexTable(
        of="all datasets",
        place=over.title,
        names=[columns[METHOD]],
        rank=columns[RANK],
        columns=[columns[key] for key in (over.metric, LEAST, GREATEST)],
        lines=over_lines(over),
        competes=lambda line: line.row is not None and line.row.rank is not None,
        metric=over.metric,
        note=f"{over.count} {over.what}. Least and greatest: the worst and the best of the datasets.",
    )


def over_lines(over: OverDatasets[Any]) -> list[OverLine]:
    """A line for each method."""
    return [Line(None, over, row) for row in over.rows]
