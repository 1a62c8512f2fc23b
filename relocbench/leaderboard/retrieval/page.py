"""``retrieval.md``: what a sceptical reader wants to know about retrievers, on one page."""

from __future__ import annotations

import shlex

from relocbench.evaluation.common.results import PREDICTIONS
from relocbench.evaluation.retrieval.records import RetrievalRun, SetRecord
from relocbench.leaderboard.common.commands import RESUMES, again_section, method_words
from relocbench.leaderboard.common.copies import copies_words, question_words
from relocbench.leaderboard.common.text import bullet, code, escaped, json_text, number, table_text, with_bounds
from relocbench.leaderboard.retrieval.board import RetrievalBoard, RetrievalRow, RetrievalTable, SetBoard
from relocbench.leaderboard.tracking.load import machine_words
from relocbench.metrics import LEVEL, MIN_EFFECTIVE

CHANCE = "(chance)"


def retrieval_page(board: RetrievalBoard) -> str:
    """The whole page."""
    parts = ["# Retrieval leaderboard", *_how_to_read(board)]
    for asked in board.sets:
        parts += _set(board, asked)
    parts += _again(board)
    return "\n\n".join(part for part in parts if part) + "\n"


def evaluate_command(asked: SetRecord, run: RetrievalRun) -> str:
    """The command that runs a retriever as it was run, or resumes a run that was stopped."""
    words = ["relocbench", "evaluate-retrieval", "--dataset", "DATASET", "--out", "RESULTS"]
    for key, value in asked.options.items():
        words += [f"--{key}", f"{value:g}" if isinstance(value, float) else value]
    words += ["--by-condition"] if any(name.rpartition("__")[0] in asked.tasks for name in asked.tasks) else []
    words += method_words(run)
    return shlex.join(
        [*words, "--keep", str(run.keep)] if run.keep and not run.target.startswith(PREDICTIONS) else words
    )


def _how_to_read(board: RetrievalBoard) -> list[str]:
    return [
        "R@K: a right image is among the first K. R@top1%: among the first 1 % of the gallery. AP: average precision "
        "by trapezoids under precision against recall, as University-1652 is scored. MRR: one over the rank of the "
        f"first right image. All are means over the queries, in percent; `[low, high]` is a {LEVEL:.0%} interval for "
        "independent places, or for the number of independent queries that those along a drive are worth. All "
        "numbers, in full, are in `retrieval.csv`.",
        f"**Ranks** go by `{board.metric}`. A method's rank is one more than the number of methods that are "
        "significantly better, by a test with one error rate for the whole table: the order within a rank says "
        "nothing. In a mean over tasks each task counts the same.",
        "**Failures.** The denominator is every query of a task. A query without a right image in the gallery, one "
        "that the method did not describe, and one on which it broke count as not found; *failed* and *broke* say how "
        "many. An image of the gallery without a descriptor is not retrieved. Of equal scores, wrong images stand "
        "first. A method that misses a task has blank means and no rank.",
        "**Chance** is what a random order of the gallery scores on average. The intervals say what other queries "
        "would have given, not what another training would.",
    ]


def _set(board: RetrievalBoard, asked: SetBoard) -> list[str]:
    record = asked.record
    told = f"Fingerprint {code(record.fingerprint)}{question_words(record.question)}."
    parts = [f"## {escaped(record.name)}", told + copies_words(asked.methods, asked.copies)]
    if record.positives:
        parts.append(f"Right are {escaped(record.positives)}.")
    parts.append(_tasks(asked))
    if asked.unused:
        parts.append(f"No method has been run on {', '.join(map(code, asked.unused))}.")
    means = [table for table in asked.tables if len(table.tasks) > 1]
    for table in [*means, *(t for t in asked.tables if len(t.tasks) == 1)]:
        parts += [f"### {escaped(table.name)}", *_table(board, table)]
    first = (means or asked.tables)[:1]  # there is none where no method has finished a task
    missing = [
        f"{code(row.method.label)} on {', '.join(map(code, row.missing))}"
        for table in first
        for row in table.rows
        if row.missing
    ]
    parts.append(bullet("**Missing results**, hence blank means and no rank:", missing))
    return [*parts, *_methods(asked)]


def _tasks(asked: SetBoard) -> str:
    columns = ["task", "views", "conditions", "queries", "without a right image", "gallery", "junk"]
    rows = [
        [
            code(name),
            escaped(r.direction),
            escaped(r.conditions),
            str(r.queries),
            str(r.without_positives),
            str(r.gallery),
            str(r.junk),
        ]
        for name, r in asked.record.tasks.items()
        if any(name in table.tasks for table in asked.tables)
    ]
    return table_text(columns, rows, left=3)


def _table(board: RetrievalBoard, table: RetrievalTable) -> list[str]:
    parts = []
    if len(table.tasks) > 1:
        parts.append(f"Mean over {len(table.tasks)} tasks: {', '.join(map(code, table.tasks))}.")
    columns = ["rank", "method", *(f"{m}, %" for m in board.shown), "s a query", "failed / broke"]
    rows = [_row(board, row) for row in table.rows]
    chance = [number(table.chance[m], "share") for m in board.shown]
    rows.append(["", f"*{CHANCE}*", *chance, "", ""])
    parts.append(table_text(columns, rows, left=2))
    level = [row.method.label for row in table.rows if _at_chance(board, table, row)]
    if level:
        parts.append(f"**Not shown to be better than chance:** {', '.join(map(code, level))}.")
    if all(not row.intervals.get(board.metric) for row in table.rows if not row.missing):
        parts.append(
            f"Too few queries for intervals: they are worth fewer than {MIN_EFFECTIVE:g} independent ones."
            + (" All methods share a rank." if all(row.rank in (1, None) for row in table.rows) else "")
        )
    if table.single_positive:
        parts.append(
            "Each query has one right image, so that R@1 ≤ AP ≤ R@1 + (100 − R@1)/4; every row was checked for it."
        )
    return parts


def _row(board: RetrievalBoard, row: RetrievalRow) -> list[str]:
    name = escaped(row.method.label) + (" (missing)" if row.missing else "")
    cells = [with_bounds(row.values[m], row.intervals.get(m), "share") for m in board.shown]
    counts = "" if row.missing else f"{row.failed} / {row.broke}"
    seconds = "" if row.seconds is None else f"{row.seconds:.3g}"
    return ["" if row.rank is None else str(row.rank), name, *cells, seconds, counts]


def _at_chance(board: RetrievalBoard, table: RetrievalTable, row: RetrievalRow) -> bool:
    value, interval = row.values[board.metric], row.intervals.get(board.metric)
    chance = table.chance[board.metric]
    return value is not None and (value <= chance or (interval is not None and interval.low <= chance))


def _methods(asked: SetBoard) -> list[str]:
    columns = ["method", "what it is", "version", "relocbench", "numbers a descriptor", "machine of the seconds"]
    rows = []
    for m in asked.methods:
        sizes = sorted({t.dimensions for t in m.run.tasks.values() if t.dimensions})
        machine = machine_words(m.run) or "not recorded"
        versions = (m.run.versions.get("method", ""), m.run.versions.get("relocbench", ""))
        rows.append(
            [
                escaped(m.label),
                code(m.run.target),
                *map(escaped, versions),
                " ".join(map(str, sizes)),
                escaped(machine),
            ]
        )
    lines = [f"{code(m.label)}: {code(json_text(m.run.parameters))}" for m in asked.methods if m.run.parameters]
    told = [f"{code(m.label)}: {code(json_text(m.run.info))}" for m in asked.methods if m.run.info]
    table = table_text(columns, rows, left=4)
    return ["### Methods", table, bullet("Parameters:", lines), bullet("What they tell of themselves:", told)]


def _again(board: RetrievalBoard) -> list[str]:
    commands = [(asked.title, [evaluate_command(asked.record, m.run) for m in asked.methods]) for asked in board.sets]
    split = f" --split {shlex.quote(board.split)}" if board.split else ""
    page = f"relocbench leaderboard RESULTS --out DIR --retrieval-metric '{board.metric}' --seed {board.seed}{split}"
    return again_section(RESUMES, commands, page)
