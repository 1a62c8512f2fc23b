"""``retrieval.tex``: a table for each mean and each task of retrievers."""

from __future__ import annotations

from relocbench.leaderboard.common.headings import METHOD, SECONDS, heading
from relocbench.leaderboard.common.latex import Column, LatexTable, Line, document, intervals_of
from relocbench.leaderboard.retrieval.board import RetrievalBoard, RetrievalTable, SetBoard
from relocbench.leaderboard.retrieval.page import CHANCE


def latex_page(board: RetrievalBoard) -> str:
    """All tables, means over several tasks first."""
    return document(
        [
            _table(board, asked, table)
            for asked in board.sets
            for table in sorted(asked.tables, key=lambda table: len(table.tasks) == 1)
        ]
    )


def _table(board: RetrievalBoard, asked: SetBoard, table: RetrievalTable) -> LatexTable:
    columns = [Column(heading(name), "share", higher_is_better=True, definition=defined(name)) for name in board.shown]
    seconds = Column(SECONDS, "s", higher_is_better=False, definition="median of the seconds a query")
    lines = [
        Line(
            (row.method.label,),
            row.rank,
            (*(row.values[name] for name in board.shown), row.seconds),
            (*intervals_of(board.shown, {board.metric: row.intervals.get(board.metric)}), None),
        )
        for row in table.rows
    ]
    chance = tuple(table.chance[name] for name in board.shown)
    lines.append(Line((CHANCE,), None, (*chance, None), (None,) * (len(chance) + 1), competes=False))
    return LatexTable(
        title=f"{asked.title}, {table.name}",
        label=f"tab:{asked.title}:{table.name}",
        heads=(METHOD,),
        columns=(*columns, seconds),
        lines=tuple(lines),
        note=f"{table.queries} queries.",
    )


def defined(metric: str) -> str:
    """What a metric of rankings is, in words."""
    said = {
        "AP": "mean over queries of the average precision",
        "MRR": "mean over queries of one over the place of the first right image",
        "R@top1%": "share of queries with a right image among the first percent of the gallery",
    }
    if metric in said:
        return said[metric]
    name, _, count = metric.partition("@")
    if name == "R":
        return f"share of queries with a right image among the first {count}"
    return ""
