"""``relocalization.tex``: a table for each task and mean of retrievers with trackers."""

from __future__ import annotations

from relocbench.evaluation.relocalization.records import KEYFRAME
from relocbench.evaluation.relocalization.score import HIT, basin_recall
from relocbench.leaderboard.common.headings import RANK, RETRIEVER, SECONDS, TOP, TRACKER
from relocbench.leaderboard.common.latex import LatexTable, document
from relocbench.leaderboard.relocalization.board import PipelineBoard
from relocbench.leaderboard.relocalization.columns import GIVEN_HIT, MEDIANS, PipelineLine, lines_of, pipeline_columns


def latex_page(board: PipelineBoard) -> str:
    """All tables."""
    columns = pipeline_columns(board)
    shown = dict.fromkeys((board.metric, "recall@(1m,5deg)", basin_recall(1), HIT, GIVEN_HIT, *MEDIANS, SECONDS))
    return document(
        LatexTable(
            of=asked.title,
            place=table.name,
            names=[columns[key] for key in (RETRIEVER, TRACKER, TOP)],
            rank=columns[RANK],
            columns=[columns[key] for key in shown],
            lines=lines_of(asked, table),
            competes=_competes,
            metric=board.metric,
            note=f"{table.queries} queries; {TOP} is the number of keyframes that are tried.",
        )
        for asked in board.sets
        for table in asked.tables
    )


def _competes(line: PipelineLine) -> bool:
    return line.row is not None and line.row.method.is_ranked and line.row.method.run.tracker != KEYFRAME
