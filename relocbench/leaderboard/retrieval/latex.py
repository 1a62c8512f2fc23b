"""``retrieval.tex``: a table for each mean and each task of retrievers."""

from __future__ import annotations

from relocbench.evaluation.retrieval.records import METRICS
from relocbench.leaderboard.common.headings import METHOD, SECONDS, heading
from relocbench.leaderboard.common.latex import Column, LatexTable, Line, document, intervals_of
from relocbench.leaderboard.retrieval.board import RetrievalBoard, RetrievalSetBoard, RetrievalTable, chance_of
from relocbench.leaderboard.retrieval.columns import CHANCE, defined


def latex_page(board: RetrievalBoard) -> str:
    """All tables, means over several tasks first."""
    return document(
        [
            _table(board, asked, table)
            for asked in board.sets
            for table in sorted(asked.tables, key=lambda table: len(table.tasks) == 1)
        ]
    )


def _table(board: RetrievalBoard, asked: RetrievalSetBoard, table: RetrievalTable) -> LatexTable:
    columns = [Column(heading(name), "share", higher_is_better=True, definition=defined(name)) for name in METRICS]
    seconds = Column(SECONDS, "s", higher_is_better=False, definition="median of the seconds a query")
    lines = [
        Line(
            (row.method.label,),
            row.rank,
            (*(row.values[name] for name in METRICS), row.values.get(SECONDS)),
            (*intervals_of(METRICS, {board.metric: row.intervals.get(board.metric)}), None),
        )
        for row in table.rows
    ]
    chance = tuple(chance_of(table)[name] for name in METRICS)
    lines.append(Line((CHANCE,), None, (*chance, None), (None,) * (len(chance) + 1), competes=False))
    return LatexTable(
        title=f"{asked.title}, {table.name}",
        label=f"tab:{asked.title}:{table.name}",
        heads=(METHOD,),
        columns=(*columns, seconds),
        lines=tuple(lines),
        note=f"{table.queries} queries.",
    )
