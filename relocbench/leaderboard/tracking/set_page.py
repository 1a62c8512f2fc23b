"""The page of one dataset: everything that a sceptical reader wants to know of its pair sets, groups and methods."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.evaluation.tables.schema import ALL
from relocbench.files import json_text
from relocbench.leaderboard.common.cards import answers_on_copies, shown_cards
from relocbench.leaderboard.common.model import is_renamed
from relocbench.leaderboard.common.text import COUNTS, ELSEWHERE, METHOD, RANK, SECONDS_AND_P95, number
from relocbench.leaderboard.tracking.columns import lines_of, tracking_columns
from relocbench.leaderboard.tracking.marks import (
    DAGGER,
    MARKS,
    about_ranks,
    cell,
    group_heading,
    heading,
    level_with_identity,
    made_elsewhere,
    marked,
    name,
    plain_heading,
    same_method,
    total_name,
)
from relocbench.leaderboard.tracking.matching import matching_lines, matching_numbers
from relocbench.leaderboard.tracking.matrix_text import matrix_text
from relocbench.leaderboard.tracking.method import Method, evaluate_command
from relocbench.leaderboard.tracking.model import RANKING, SAME_DRIVE_TOTAL, Board, DatasetBoard, SeedRow, Table
from relocbench.leaderboard.tracking.reservations import reservations
from relocbench.metrics import CONFIDENT, CORRECT, LEVEL, Metric, Spread, metric_named, shown_in
from relocbench.pages import render
from relocbench.pages.markdown import code, escaped, table_text


def set_file(dataset: DatasetBoard) -> str:
    """The path of a dataset's page, relative to the leaderboard's folder."""
    return f"sets/{dataset.entry.title}.md"


def set_page(board: Board, dataset: DatasetBoard) -> str:
    """The page of a dataset."""
    entry = dataset.entry
    methods = entry.methods
    elsewhere = any(method.elsewhere for method in methods)
    return render(
        __name__,
        "set_page.md.j2",
        dagger=DAGGER,
        level=f"{LEVEL:.0%}",
        confident=f"{CONFIDENT:g}",
        number=number,
        entry=entry,
        asked=entry.record.question[:SHORT],
        copies_answered=answers_on_copies(methods, entry.copies),
        facts=[
            (pair_set, facts, " ".join(split for split, names in entry.splits.items() if split and pair_set in names))
            for pair_set, facts in entry.pair_sets.items()
        ],
        unused=[pair_set for pair_set in entry.pair_sets if pair_set not in entry.used],
        matrix=matrix_text([dataset]),
        correct=CORRECT,
        reservations=reservations(dataset),
        missing=list(_missing(dataset)),
        marked=[(mark, labels) for mark in MARKS if (labels := [m.label for m in methods if mark.applies(m)])],
        renamed=[(m.label, m.ran_as) for m in methods if is_renamed(m.label, m.ran_as)],
        sections=[
            *(_section(board, dataset, t) | {"total": True} for t in dataset.totals if len(t.pair_sets) > 1),
            *(_section(board, dataset, t) | {"matching": _matching(dataset, t)} for t in dataset.pair_sets),
        ],
        confidence=_confidences(board, dataset, elsewhere=elsewhere),
        elsewhere=elsewhere,
        imported=any(made_elsewhere(m.run) for m in methods),
        cards=shown_cards(entry.title, methods),
        machines_differ=len({m.machine for m in methods if m.machine}) > 1,
        settings=[(m.label, json_text(m.settings)) for m in methods if m.settings],
        differences=list(_differences(methods)),
        commands=[evaluate_command(m.run, matching=bool(m.matching)) for m in methods],
    )


def _confidences(board: Board, dataset: DatasetBoard, *, elsewhere: bool) -> str:
    """What confidences are worth: a row for each total and method, with pairs of different places if wanted."""
    metrics = shown_in("confidence")
    of_elsewhere = [tracking_columns(board)[key] for key in (ELSEWHERE if elsewhere else ())]
    rows = []
    for table in dataset.totals:
        for line in lines_of(dataset, table):
            assert line.row is not None
            known = line.row.elsewhere is not None and line.row.elsewhere.answered_share is not None
            cells = [cell(metric, line.row, table, interval=False) for metric in metrics]
            cells += [column.text(line) if known else "" for column in of_elsewhere]
            rows.append([total_name(table), name(line.row), *cells])
    columns = ["total", METHOD, *map(plain_heading, metrics), *(column.heading for column in of_elsewhere)]
    return table_text(columns, rows, left=2) if rows else ""


def _missing(dataset: DatasetBoard) -> Iterator[tuple[str, list[tuple[str, str]], str]]:
    """The methods without some results: label, each pair set that is missing with the reason, and what runs it."""
    for method in dataset.entry.methods:
        missing = [(pair_set, why) for pair_set, why in method.missing.items() if pair_set in dataset.entry.used]
        if missing:
            yield method.label, missing, evaluate_command(method.run)


def _section(board: Board, dataset: DatasetBoard, table: Table) -> dict[str, object]:
    """What a pair set and a total have in common."""
    groups = dataset.groups_of(table)
    return {
        "table": table,
        "total": False,
        "same_drive": table.pair_set == SAME_DRIVE_TOTAL,
        "numbers": _method_table(board, dataset, table),
        "about_ranks": about_ranks(board, table),
        "level": level_with_identity(dataset, table),
        "finer": [m.name for m in shown_in("set page", board.metric) if m.name in table.finer],
        "ranked_by_finer": board.metric.name in table.finer,
        "sigmas": [
            f"{number(table.medians[sigma], unit)} {words}"
            for sigma, unit, words in (("sigma_translation_m", "m", "m"), ("sigma_rotation_deg", "deg", "°"))
            if table.medians[sigma] is not None
        ],
        "pivots": [_pivot(table, groups, metric) for metric in (_pivoted(board) if groups else ())],
        "more": _more(table),
        "groups": [(group, _method_table(board, dataset, group, ranks=False)) for group in groups],
        "matching": None,
    }


def _more(table: Table) -> str:
    """The measures that are folded away, one a line and methods side by side; empty where no method has any."""
    known = [m for m in shown_in("more") if any(row.values[m.name] is not None for row in table.rows)]
    over = {m.name: f" ({table.over[m.name]} pairs)" for m in known if m.over is not None}
    lines = [
        [plain_heading(m) + over.get(m.name, ""), *(cell(m, row, table, interval=False) for row in table.rows)]
        for m in known
    ]
    return table_text(["measure", *(name(row) for row in table.rows)], lines, left=1) if lines else ""


def _matching(dataset: DatasetBoard, table: Table) -> dict[str, object] | None:
    """The matching quality of a pair set."""
    lines = matching_lines(dataset, table.pair_set)
    return {"count": lines[0][1][ALL]["count"], "numbers": matching_numbers(lines)} if lines else None


def _differences(methods: Sequence[Method]) -> Iterator[tuple[str, str]]:
    """The targets that were run several times, with a table of the parameters that differ."""
    for target in dict.fromkeys(m.run.target for m in methods):
        runs = [m for m in methods if m.run.target == target]
        keys = list(dict.fromkeys(key for m in runs for key in m.run.parameters))
        differing = [n for n in keys if len({json_text(m.run.parameters.get(n)) for m in runs}) > 1]
        if differing:
            rows = [[escaped(m.label), *(code(json_text(m.run.parameters.get(n))) for n in differing)] for m in runs]
            yield target, table_text(["method", *map(code, differing)], rows, left=1)


def _method_table(board: Board, dataset: DatasetBoard, table: Table, *, ranks: bool = True) -> str:
    metrics = shown_in("set page", board.metric)
    columns = [
        *([RANK] if ranks else []),
        METHOD,
        *(heading(m, table) for m in metrics),
        SECONDS_AND_P95,
        COUNTS,
    ]
    of_key = tracking_columns(board)
    rows = []
    for line in lines_of(dataset, table):
        assert line.row is not None
        head = [*([of_key[RANK].text(line)] if ranks else []), name(line.row)]
        tail = [of_key[key].text(line) for key in (SECONDS_AND_P95, COUNTS)]
        rows.append([*head, *(cell(m, line.row, table) for m in metrics), *tail])
    for seed_row in table.seeds:
        head = [*([""] if ranks else []), f"*{escaped(seed_row.title)}, mean ± sd*"]
        seconds = _spread_cell(metric_named("median_seconds"), seed_row, table)
        rows.append([*head, *(_spread_cell(m, seed_row, table) for m in metrics), seconds, ""])
    return table_text(columns, rows, left=2 if ranks else 1)


def _spread_cell(metric: Metric, row: SeedRow, table: Table) -> str:
    spread: Spread | None = row.spread[metric.name]
    if spread is None:
        return ""
    text = number(spread.mean, metric.unit)
    if spread.standard_deviation is not None:
        text += f" ± {number(spread.standard_deviation, metric.unit)}"
    return marked(text, metric, table)


def _pivoted(board: Board) -> list[Metric]:
    """The metrics that are tabulated by group: the ranking metric and a recall that readers may know."""
    return list({m.name: m for m in (board.metric, metric_named(RANKING))}.values())


def _pivot(table: Table, groups: Sequence[Table], metric: Metric) -> str:
    """A table of one metric: methods in the order of the whole set, and a column for each group."""
    columns = [
        plain_heading(metric),
        f"all<br>{table.pairs} pairs",
        *map(group_heading, groups),
    ]
    rows = [
        [name(row), cell(metric, row, table), *(cell(metric, same_method(row, group), group) for group in groups)]
        for row in table.rows
    ]
    return table_text(columns, rows, left=1)
