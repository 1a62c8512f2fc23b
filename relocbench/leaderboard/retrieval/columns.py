"""The columns of retrievers' tables."""

from __future__ import annotations

from relocbench.evaluation.retrieval.records import METRICS
from relocbench.leaderboard.common.columns import (
    Column,
    Line,
    bounds_columns,
    by_key,
    counts_column,
    family_column,
    number_column,
    rank_column,
)
from relocbench.leaderboard.common.text import COUNTS, METHOD, RANK, RESCORED, SECONDS, Value
from relocbench.leaderboard.retrieval.board import (
    RETRIEVAL,
    RetrievalBoard,
    RetrievalRow,
    RetrievalSetBoard,
    RetrievalTable,
    chance_of,
    confirmed_of,
    rescored_text,
)

CHANCE = "(chance)"
RetrievalLine = Line[RetrievalSetBoard, RetrievalTable, RetrievalRow]
RetrievalColumn = Column[RetrievalLine]
PAGE = (RANK, METHOD, *METRICS, SECONDS, COUNTS, RESCORED)
TERMINAL = ("R@1", "R@5", "R@10", "AP")
"""the metrics on the terminal"""
_DEFINED = {
    "AP": "mean over queries of the average precision",
    "MRR": "mean over queries of one over the place of the first right image",
    "R@top1%": "share of queries with a right image among the first percent of the gallery",
}


def terminal_columns(board: RetrievalBoard) -> tuple[str, ...]:
    """The columns of a table on the terminal."""
    return (METHOD, RANK, *dict.fromkeys((board.metric, *TERMINAL)))


def paper_columns(board: RetrievalBoard) -> tuple[str, ...]:
    """The numbers of a table in LaTeX."""
    return (*METRICS, SECONDS)


def lines_of(asked: RetrievalSetBoard, table: RetrievalTable) -> list[RetrievalLine]:
    """A line for each method, and the last for chance."""
    return [*(Line(asked, table, row) for row in table.rows), Line(asked, table, None)]


def retrieval_columns(board: RetrievalBoard) -> dict[str, RetrievalColumn]:
    """All columns by their keys; those of CSV first, in its order."""
    with_interval = dict.fromkeys((*RETRIEVAL.with_interval, board.metric))
    return by_key(
        [
            Column("dataset", lambda line: line.set.record.name),
            Column("fingerprint", lambda line: line.set.record.fingerprint),
            Column("question", lambda line: line.set.record.question),
            Column("table", lambda line: line.table.name),
            Column("tasks", lambda line: " ".join(line.table.tasks)),
            Column("view_query", lambda line: "+".join(sorted({r.view_query for r in line.table.records}))),
            Column("view_gallery", lambda line: "+".join(sorted({r.view_gallery for r in line.table.records}))),
            Column("condition_query", lambda line: _of_single(line, "condition_query")),
            Column("condition_gallery", lambda line: _of_single(line, "condition_gallery")),
            Column("queries", lambda line: line.table.queries),
            Column("without_positives", lambda line: sum(r.without_positives for r in line.table.records)),
            Column("gallery", lambda line: _of_single(line, "gallery")),
            Column(METHOD, lambda line: CHANCE if line.row is None else line.row.method.label),
            Column("target", lambda line: line.of_row(lambda row: row.method.run.target)),
            rank_column(),
            family_column(),
            Column("missing", lambda line: "" if line.row is None else " ".join(line.row.missing)),
            Column(RESCORED, lambda line: line.of_row(lambda row: rescored_text(row, line.table)), shown=_rescored),
            Column("failed", lambda line: line.of_row(lambda row: row.failed)),
            Column("broke", lambda line: line.of_row(lambda row: row.broke)),
            counts_column(),
            Column(
                SECONDS,
                lambda line: line.value(SECONDS),
                "s",
                _seconds,
                definition="median of the seconds a query",
                higher_is_better=False,
            ),
            *(_most_of_tasks(name) for name in ("descriptor_bytes", "peak_memory_bytes")),
            *(_metric(metric) for metric in METRICS),
            *bounds_columns(with_interval),
            *(_believed(metric) for metric in METRICS),
        ]
    )


def defined(metric: str) -> str:
    """What a metric of rankings is, in words."""
    count = metric.partition("@")[2]
    return _DEFINED.get(metric, f"share of queries with a right image among the first {count}")


def _metric(metric: str) -> RetrievalColumn:
    def value(line: RetrievalLine) -> Value:
        return chance_of(line.table)[metric] if line.row is None else line.value(metric)

    return number_column(metric, definition=defined(metric), higher_is_better=True, value=value)


def _most_of_tasks(name: str) -> RetrievalColumn:
    """Bytes that a run knows of each task: the most over the tasks of a table; None where they are not known."""

    def most(row: RetrievalRow, table: RetrievalTable) -> Value:
        known = [getattr(of, name) for task, of in row.method.run.tasks.items() if task in table.tasks]
        return max((size for size in known if size is not None), default=None)

    return Column(name, lambda line: line.of_row(lambda row: most(row, line.table)))


def _seconds(line: RetrievalLine) -> str:
    seconds = line.value(SECONDS)
    return "" if seconds is None else f"{seconds:.3g}"


def _rescored(line: RetrievalLine) -> str:
    return "" if line.row is None or line.row.missing else rescored_text(line.row, line.table)


def _believed(metric: str) -> RetrievalColumn:
    """By how much a mean could be another one, given the images that were kept of each query."""

    def value(line: RetrievalLine) -> Value:
        confirmed = None if line.row is None else confirmed_of(line.row, line.table)
        return None if confirmed is None else confirmed.believed[metric]

    return Column(f"{metric}_believed", value, "share")


def _of_single(line: RetrievalLine, name: str) -> Value:
    """A fact of the task that a table is of; None of a mean over several."""
    value: Value = getattr(line.table.records[0], name) if len(line.table.records) == 1 else None
    return value
