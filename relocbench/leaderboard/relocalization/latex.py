"""``relocalization.tex``: a table for each task and mean of retrievers with trackers."""

from __future__ import annotations

from relocbench.evaluation.relocalization.records import KEYFRAME
from relocbench.evaluation.relocalization.score import HIT, basin_recall
from relocbench.leaderboard.common.headings import RETRIEVER, SECONDS, TOP, TRACKER, heading
from relocbench.leaderboard.common.latex import Column, LatexTable, Line, document, intervals_of
from relocbench.leaderboard.relocalization.board import PipelineBoard, PipelineRow, PipelineSetBoard, PipelineTable
from relocbench.leaderboard.relocalization.columns import MEDIANS
from relocbench.metrics import metric_named

_SHARES = {
    basin_recall(1): "share of queries whose first keyframe is in the tracker's basin",
    HIT: "share of queries with one of the keyframes that were tried in the basin",
    "right_given_hit": "share of right answers among these",
}


def latex_page(board: PipelineBoard) -> str:
    """All tables."""
    return document([_table(board, asked, table) for asked in board.sets for table in asked.tables])


def _table(board: PipelineBoard, asked: PipelineSetBoard, table: PipelineTable) -> LatexTable:
    poses = dict.fromkeys((board.metric, "recall@(1m,5deg)"))
    definitions = {name: metric_named(name).description.replace("pairs", "queries") for name in poses} | _SHARES
    columns = [Column(heading(name), "share", True, definition) for name, definition in definitions.items()]
    columns += [Column(name, unit, higher_is_better=False) for name, unit in zip(MEDIANS, ("m", "deg"), strict=True)]
    columns.append(Column(SECONDS, "s", higher_is_better=False, definition="median of the seconds a query"))
    names = [*definitions, *MEDIANS, SECONDS]
    return LatexTable(
        title=f"{asked.title}, {table.name}",
        label=f"tab:{asked.title}:{table.name}",
        heads=(RETRIEVER, TRACKER, TOP),
        columns=tuple(columns),
        lines=tuple(_line(board, row, names) for row in table.rows),
        note=f"{table.queries} queries; {TOP} is the number of keyframes that are tried.",
    )


def _line(board: PipelineBoard, row: PipelineRow, names: list[str]) -> Line:
    run = row.method.run
    return Line(
        (run.retriever, run.tracker, str(run.top)),
        row.rank,
        tuple(row.values.get(name) for name in names),
        intervals_of(names, {board.metric: row.intervals.get(board.metric)}),
        competes=row.method.is_ranked and run.tracker != KEYFRAME,
    )
