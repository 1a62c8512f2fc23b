"""``retrieval.md``: what a sceptical reader wants to know about retrievers, on one page."""

from __future__ import annotations

import shlex

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.evaluation.common.results import PREDICTIONS
from relocbench.evaluation.retrieval.records import METRICS, RetrievalRun, SetRecord
from relocbench.files import json_text
from relocbench.leaderboard.common.cards import add_command, answers_on_copies, shown_cards
from relocbench.leaderboard.common.columns import texts
from relocbench.leaderboard.common.commands import method_words, page_command
from relocbench.leaderboard.common.model import about_ranks, is_renamed
from relocbench.leaderboard.common.over_datasets import over_sections
from relocbench.leaderboard.retrieval.board import (
    RetrievalBoard,
    RetrievalRow,
    RetrievalSetBoard,
    RetrievalTable,
    chance_of,
    confirmed_of,
    has_single_positives,
    is_part,
)
from relocbench.leaderboard.retrieval.columns import PAGE, lines_of, retrieval_columns
from relocbench.leaderboard.tracking.method import machine_words
from relocbench.metrics import LEVEL
from relocbench.pages import render
from relocbench.pages.markdown import escaped, table_text


def retrieval_page(board: RetrievalBoard) -> str:
    """The whole page."""
    rescored = any(method.confirmed for asked in board.sets for method in asked.methods)
    return render(
        __name__,
        "page.md.j2",
        metric=board.metric,
        level=f"{LEVEL:.0%}",
        over=over_sections(board.over),
        sets=[_set(board, asked) for asked in board.sets],
        commands=[
            (asked.title, [evaluate_command(asked.record, m.run) for m in asked.methods]) for asked in board.sets
        ],
        page_command=page_command(
            "--retrieval-metric", board.metric, board.seed, board.split, "DATASET" if rescored else ""
        ),
    )


def evaluate_command(asked: SetRecord, run: RetrievalRun) -> str:
    """The command that runs a retriever as it was run, or resumes a run that was stopped."""
    if run.submitted:
        return add_command(run.method)
    words = ["relocbench", "evaluate-retrieval", "--dataset", "DATASET", "--out", "RESULTS"]
    for key, value in asked.options.items():
        words += [f"--{key}", f"{value:g}" if isinstance(value, float) else value]
    words += ["--by-condition"] if any(is_part(name, asked.tasks) for name in asked.tasks) else []
    words += method_words(run)
    return shlex.join(
        [*words, "--keep", str(run.keep)] if run.keep and not run.target.startswith(PREDICTIONS) else words
    )


def _set(board: RetrievalBoard, asked: RetrievalSetBoard) -> dict[str, object]:
    methods = asked.methods
    return {
        "record": asked.record,
        "question": asked.record.question[:SHORT],
        "copies": answers_on_copies(methods, asked.copies),
        "tasks": [(name, asked.units[name]) for name in asked.used],
        "unused": asked.unused,
        "sections": [_section(board, asked, table) for table in asked.means_first],
        "missing": asked.missing,
        "methods": [
            (m.label, m.run, sorted({t.dimensions for t in m.run.tasks.values() if t.dimensions}), machine_words(m.run))
            for m in methods
        ],
        "cards": shown_cards(asked.title, methods),
        "elsewhere": [m.label for m in methods if m.run.made_elsewhere or m.run.target.startswith(PREDICTIONS)],
        "renamed": [(m.label, m.ran_as) for m in methods if is_renamed(m.label, m.ran_as)],
        "parameters": [(m.label, json_text(m.run.parameters)) for m in methods if m.run.parameters],
        "info": [(m.label, json_text(m.run.info)) for m in methods if m.run.info],
    }


def _section(board: RetrievalBoard, asked: RetrievalSetBoard, table: RetrievalTable) -> dict[str, object]:
    columns = retrieval_columns(board)
    heads, rows = texts([columns[key] for key in PAGE], lines_of(asked, table))
    for cells, row in zip(rows, [*table.rows, None], strict=True):
        label = f"*{cells[1]}*" if row is None else escaped(cells[1])
        cells[1] = f"{label} (missing)" if row is not None and row.missing else label
    return {
        "believed": _believed(table),
        "table": table,
        "numbers": table_text(heads, rows, left=2),
        "single_positive": has_single_positives(table),
        "at_chance": [row.method.label for row in table.rows if not_above_chance(board, table, row)],
        "about_ranks": about_ranks(table.rows, board.metric, f"{table.queries} queries"),
    }


def _believed(table: RetrievalTable) -> list[tuple[str, str]]:
    """Metrics that ranks behind the images that were kept could move, and by how many points at most."""
    confirmed = [each for row in table.rows if (each := confirmed_of(row, table)) is not None]
    most = {m: 100 * max((c.believed[m] for c in confirmed), default=0.0) for m in METRICS}
    return [(metric, f"{points:.2g}") for metric, points in most.items() if points > 0]


def not_above_chance(board: RetrievalBoard, table: RetrievalTable, row: RetrievalRow) -> bool:
    """Whether a row is not shown to be better than a gallery in random order."""
    value, interval = row.values[board.metric], row.intervals.get(board.metric)
    chance = chance_of(table)[board.metric]
    return value is not None and (value <= chance or (interval is not None and interval.low <= chance))
