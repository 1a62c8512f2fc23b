"""``retrieval.tex``: a table for each mean and each task of retrievers."""

from __future__ import annotations

from relocbench.evaluation.retrieval.records import METRICS
from relocbench.leaderboard.common.headings import METHOD, RANK, SECONDS
from relocbench.leaderboard.common.latex import LatexTable, document
from relocbench.leaderboard.retrieval.board import RetrievalBoard
from relocbench.leaderboard.retrieval.columns import lines_of, retrieval_columns


def latex_page(board: RetrievalBoard) -> str:
    """All tables, means over several tasks first."""
    columns = retrieval_columns(board)
    return document(
        LatexTable(
            of=asked.title,
            place=table.name,
            names=[columns[METHOD]],
            rank=columns[RANK],
            columns=[columns[key] for key in (*METRICS, SECONDS)],
            lines=lines_of(asked, table),
            competes=lambda line: line.row is not None,
            metric=board.metric,
            note=f"{table.queries} queries.",
        )
        for asked in board.sets
        for table in sorted(asked.tables, key=lambda table: len(table.tasks) == 1)
    )
