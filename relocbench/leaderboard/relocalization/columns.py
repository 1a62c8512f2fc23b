"""The columns of the tables of pipelines."""

from __future__ import annotations

from relocbench.evaluation.relocalization.basin import SAID, Basin
from relocbench.evaluation.relocalization.score import FAILURES, HIT, POSE_METRICS, RANKING, basin_recall
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
from relocbench.leaderboard.common.text import BASIN, COUNTS, RANK, RESCORED, RETRIEVER, SECONDS, TOP, TRACKER
from relocbench.leaderboard.relocalization.board import (
    RELOCALIZATION,
    SHARES,
    PipelineBoard,
    PipelineRow,
    PipelineSetBoard,
    PipelineTable,
    is_rescored,
)
from relocbench.metrics import metric_named

PipelineLine = Line[PipelineSetBoard, PipelineTable, PipelineRow]
PipelineColumn = Column[PipelineLine]
POSES = (RANKING, "recall@(0.5m,5deg)", "recall@(1m,5deg)", "recall@(5m,10deg)", "t_auc@0.5m", "r_auc@0.5deg")
MEDIANS = ("median_translation_error_m", "median_rotation_error_deg")
GIVEN_HIT = "right_given_hit"
_DEFINED = {
    basin_recall(1): "share of queries whose first keyframe is in the tracker's basin",
    HIT: "share of queries with one of the keyframes that were tried in the basin",
    GIVEN_HIT: "share of right answers among these",
    SECONDS: "median of the seconds a query",
    **{name: metric_named(name).description.replace("pairs", "queries") for name in POSE_METRICS},
}
"""what some numbers are, in words"""
STAGES = ("basin_recall@1", HIT, GIVEN_HIT, "right_without_hit", "right_among_K", *FAILURES)
"""what became of queries on their way through retrieval and tracking"""


def pose_columns(board: PipelineBoard) -> tuple[str, ...]:
    """The columns of the table of poses on a page."""
    return (RANK, RETRIEVER, TRACKER, TOP, *dict.fromkeys((board.metric, *POSES)), *MEDIANS, SECONDS)


def stage_columns(table: PipelineTable) -> tuple[str, ...]:
    """The columns of the table of what queries are lost to; what loses none is left out."""
    lost = [share for share in STAGES if share not in FAILURES or any(row.values[share] for row in table.rows)]
    return (RETRIEVER, TRACKER, TOP, BASIN, *lost, COUNTS)


def terminal_columns(board: PipelineBoard) -> tuple[str, ...]:
    """The columns of a table on the terminal."""
    return (RETRIEVER, TRACKER, TOP, RANK, *dict.fromkeys((board.metric, HIT, MEDIANS[0])))


def paper_columns(board: PipelineBoard) -> tuple[str, ...]:
    """The numbers of a table in LaTeX."""
    return (board.metric, "recall@(1m,5deg)", basin_recall(1), HIT, GIVEN_HIT, *MEDIANS, SECONDS)


def competes(line: PipelineLine) -> bool:
    """Whether values of a pipeline may be the best of a table: those of trivial baselines and the oracle may not."""
    return line.row is not None and line.row.method.is_ranked


def lines_of(asked: PipelineSetBoard, table: PipelineTable) -> list[PipelineLine]:
    """A line for each pipeline."""
    return [Line(asked, table, row) for row in table.rows]


def pipeline_columns(board: PipelineBoard) -> dict[str, PipelineColumn]:
    """All columns by their keys; those of CSV first, in its order."""
    with_interval = dict.fromkeys((*RELOCALIZATION.with_interval, board.metric))
    return by_key(
        [
            Column("dataset", lambda line: line.set.record.dataset),
            Column("fingerprint", lambda line: line.set.record.dataset_fingerprint),
            Column("table", lambda line: line.table.name),
            Column("tasks", lambda line: " ".join(line.table.tasks)),
            Column("queries", lambda line: line.table.queries),
            Column(RETRIEVER, lambda line: line.of_row(lambda row: row.method.run.retriever)),
            Column(TRACKER, lambda line: line.of_row(lambda row: row.method.run.tracker)),
            Column(TOP, lambda line: line.of_row(lambda row: row.method.run.top)),
            rank_column(),
            family_column(),
            Column("missing", lambda line: line.of_row(lambda row: " ".join(row.missing))),
            Column(RESCORED, lambda line: line.of_row(lambda row: "yes" if is_rescored(row, line.table) else "no")),
            Column("failed", lambda line: line.of_row(lambda row: row.failed)),
            Column("broke", lambda line: line.of_row(lambda row: row.broke)),
            counts_column(),
            Column("basin_m", lambda line: None if (basin := _basin(line)) is None else basin.metres),
            Column("basin_deg", lambda line: None if (basin := _basin(line)) is None else basin.degrees),
            Column("basin_source", lambda line: None if (basin := _basin(line)) is None else basin.source),
            Column(BASIN, lambda line: None, shown=basin_words, for_programs=False),
            *(_number(name, "share") for name in (*POSE_METRICS, *SHARES, GIVEN_HIT)),
            *(_number(name, unit) for name, unit in zip((*MEDIANS, SECONDS), ("m", "deg", "s"), strict=True)),
            *bounds_columns(with_interval),
        ]
    )


def basin_words(line: PipelineLine) -> str:
    """The size of the basin if it is the same on all tasks, else its source in words."""
    known = {} if line.row is None else line.row.method.basins
    basins = [known[task] for task in line.table.tasks if task in known]
    if not basins:
        return ""
    sizes = {(round(b.metres, 3), round(b.degrees, 3)) for b in basins}
    if len(sizes) == 1:
        ((metres, degrees),) = sizes
        return f"{metres:.3g} m, {degrees:.3g}°" + ("" if basins[0].source == "pairs" else f" ({basins[0].source})")
    return ", ".join(sorted({SAID[b.source] for b in basins}))


def _basin(line: PipelineLine) -> Basin | None:
    """The basin of the task that a table is of; None of a mean over several."""
    if line.row is None or len(line.table.tasks) > 1:
        return None
    return line.row.method.basins.get(line.table.tasks[0])


def _number(name: str, unit: str) -> PipelineColumn:
    better = unit == "share" and name not in FAILURES
    return number_column(name, unit, definition=_DEFINED.get(name, ""), higher_is_better=better)
