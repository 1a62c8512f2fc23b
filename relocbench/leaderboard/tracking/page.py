"""``leaderboard.md``: what a sceptical reader wants to know about trackers, on one page."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from urllib.parse import quote

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.evaluation.common.matching_table import ALL
from relocbench.leaderboard.common.copies import answers_on_copies
from relocbench.leaderboard.common.text import json_text, number, with_bounds
from relocbench.leaderboard.tracking.load import Method, evaluate_command
from relocbench.leaderboard.tracking.marks import MARKS, made_elsewhere, signs
from relocbench.leaderboard.tracking.matching import matching_file, matching_lines, matching_numbers
from relocbench.leaderboard.tracking.model import SAME_DRIVE_TOTAL, Board, DatasetBoard, Row, SeedRow, Table
from relocbench.metrics import CONFIDENT, LEVEL, MIN_EFFECTIVE, Metric, Spread, metric_named
from relocbench.pages import render
from relocbench.pages.markdown import code, escaped, table_text

SHOWN = (
    "coverage",
    "median_translation_error_m",
    "median_rotation_error_deg",
    "t_auc@0.5m",
    "r_auc@0.5deg",
    "recall@(0.1m,1deg)",
    "recall@(0.25m,2deg)",
    "recall@(0.5m,5deg)",
    "recall@(1m,5deg)",
    "recall@(5m,10deg)",
)
_SUMMARISED = ("coverage", *(name for name in SHOWN if "auc" in name or "recall" in name))
"""the metrics of the summary, besides the ranking metric"""
_OF_CONFIDENCE = (
    "coverage",
    "wrong_of_answered@(0.25m,2deg)",
    "aurc@(0.25m,2deg)",
    "coverage_at_precision_95@(0.25m,2deg)",
    "coverage_at_precision_99@(0.25m,2deg)",
    "precision_at_confidence_50@(0.25m,2deg)",
    "coverage_at_confidence_50",
)
_HEADINGS = {
    "median_translation_error_m": "median, m",
    "median_rotation_error_deg": "median, °",
    "coverage": "coverage, %",
}
DAGGER = "†"


def markdown(board: Board, *, plots: bool) -> str:
    """The whole page; with ``plots``, it links the pictures of the curves."""
    split = f" --split {shlex.quote(board.split)}" if board.split else ""
    at_hand = [d for d in board.datasets if any(m.rescored for m in d.entry.methods)]
    datasets = {0: "", 1: " --dataset DATASET"}.get(len(at_hand), " --dataset DATASETS")
    return render(
        __name__,
        "page.md.j2",
        metric=board.metric,
        level=f"{LEVEL:.0%}",
        min_effective=f"{MIN_EFFECTIVE:g}",
        dagger=DAGGER,
        number=number,
        plots=plots,
        marks=MARKS,
        summary=_summary(board),
        confidence=_totals(board, [metric_named(name) for name in _OF_CONFIDENCE], elsewhere=_asks_elsewhere(board)),
        elsewhere=_asks_elsewhere(board),
        confident=f"{CONFIDENT:g}",
        risks=[
            (f"{dataset.entry.title}, {_total_name(table)}", quote(risk_file(dataset, table)))
            for dataset in board.datasets
            for table in dataset.totals
            if plots and has_risks(table)
        ],
        several=len(at_hand) > 1,
        datasets=[_dataset(board, dataset, plots) for dataset in board.datasets],
        commands=[
            (d.entry.title, [evaluate_command(m.run, matching=bool(m.matching)) for m in d.entry.methods])
            for d in board.datasets
        ],
        page_command=f"relocbench leaderboard RESULTS --out DIR{datasets} --metric '{board.metric.name}' "
        f"--seed {board.seed}{split}",
    )


def curve_file(dataset: DatasetBoard, table: Table) -> str:
    """The path of the picture of a pair set's curves, relative to the page."""
    return f"curves/{dataset.entry.title}__{table.pair_set}.png"


def has_curves(table: Table) -> bool:
    """Whether any method has a curve on the pair set."""
    return any(not row.missing for row in table.rows)


def risk_file(dataset: DatasetBoard, table: Table) -> str:
    """The path of the picture of a total's risk-coverage curves, relative to the page."""
    split = f"__{table.split}" if table.split else ""
    return f"curves/{dataset.entry.title}__{table.pair_set}{split}.confidence.png"


def has_risks(table: Table) -> bool:
    """Whether any method but the floors has answered a pair of the total."""
    return any(
        not row.missing and row.answered and not (row.method.is_floor or row.method.is_clock) for row in table.rows
    )


def shown_metrics(board: Board) -> list[Metric]:
    """The metrics shown as columns, with the ranking metric among them, in the order of :data:`SHOWN`."""
    names = [*SHOWN] if board.metric.name in SHOWN else [SHOWN[0], board.metric.name, *SHOWN[1:]]
    return [metric_named(name) for name in names]


def _dataset(board: Board, dataset: DatasetBoard, plots: bool) -> dict[str, object]:
    entry = dataset.entry
    methods = entry.methods
    return {
        "entry": entry,
        "question": entry.record.question[:SHORT],
        "copies": answers_on_copies(methods, entry.copies),
        "facts": [
            (name, facts, " ".join(split for split, names in entry.splits.items() if split and name in names))
            for name, facts in entry.pair_sets.items()
        ],
        "unused": [name for name in entry.pair_sets if name not in entry.used],
        "level_with_floor": list(_level_with_floor(dataset)),
        "missing": list(_missing(dataset)),
        "marked": [(mark, labels) for mark in MARKS if (labels := [m.label for m in methods if mark.applies(m)])],
        "renamed": [(m.label, m.ran_as) for m in methods if _renamed(m)],
        "sections": [
            *(_section(board, dataset, t) | {"total": True} for t in dataset.totals if len(t.pair_sets) > 1),
            *(_section(board, dataset, t) | _pictures(dataset, t, plots) for t in dataset.pair_sets),
        ],
        "imported": any(made_elsewhere(m.run) for m in methods),
        "machines_differ": len({m.machine for m in methods if m.machine}) > 1,
        "settings": [(m.label, json_text(m.settings)) for m in methods if m.settings],
        "differences": list(_differences(methods)),
    }


def _renamed(method: Method) -> bool:
    """Whether the folder has another name than the run, other than that of a copy of the dataset."""
    return method.ran_as not in ("", method.label, method.label.rpartition("@")[0])


def _summary(board: Board) -> str:
    """The page's first table: a row for each total and method; empty where nothing was run."""
    return _totals(board, [m for m in shown_metrics(board) if m.name in (*_SUMMARISED, board.metric.name)])


def _asks_elsewhere(board: Board) -> bool:
    """Whether any method was asked about pairs of different places."""
    return any(m.elsewhere for dataset in board.datasets for m in dataset.entry.methods)


def _totals(board: Board, metrics: Sequence[Metric], *, elsewhere: bool = False) -> str:
    """A table with a row for each total and method, with pairs of different places if wanted; empty without rows."""
    rows = []
    for dataset in board.datasets:
        for table in dataset.totals:
            place = [escaped(dataset.entry.title), _total_name(table), str(len(table.pair_sets)), str(table.pairs)]
            for row in table.rows:
                rank = "" if row.rank is None else str(row.rank)
                cells = [_cell(m, row, table, interval=False) for m in metrics]
                rows.append([*place, rank, _name(row), *cells, *(_elsewhere_cells(row) if elsewhere else ())])
    columns = ["dataset", "total", "pair sets", "pairs", "rank", "method", *(_plain_heading(m) for m in metrics)]
    columns += ["different places", "answered of these, %", "confidently wrong, %"] if elsewhere else []
    return table_text(columns, rows, left=6) if rows else ""


def _elsewhere_cells(row: Row) -> list[str]:
    """The number of pairs of different places, and the shares answered and confidently answered, with the bound."""
    found = row.elsewhere
    if found is None or found.answered_share is None:
        return ["", "", ""]
    high = number(found.confident_high, "share")
    return [
        str(found.pairs),
        number(found.answered_share, "share"),
        f"{number(found.confident_share, 'share')} (at most {high})",
    ]


def _total_name(table: Table) -> str:
    kind = "same drive" if table.pair_set == SAME_DRIVE_TOTAL else "two drives"
    return f"{kind}, split {code(table.split)}" if table.split else kind


def _level_with_floor(dataset: DatasetBoard) -> Iterator[tuple[str, list[str]]]:
    """The pair sets with methods that are not shown to be better than the floor, and these methods."""
    for table in dataset.pair_sets:
        if any(r.method is dataset.entry.floor and not r.missing for r in table.rows):
            compared = [r for r in table.rows if r.above_floor is not None and not r.method.is_clock]
            level = [r.method.label for r in compared if not _beats(r)]
            if level:
                yield table.pair_set, level


def _beats(row: Row) -> bool:
    return row.above_floor is not None and row.above_floor.significant and row.above_floor.mean > 0


def _missing(dataset: DatasetBoard) -> Iterator[tuple[str, list[tuple[str, str]], str]]:
    """The methods without some results: label, each pair set that is missing with the reason, and what runs it."""
    for method in dataset.entry.methods:
        missing = [(name, why) for name, why in method.missing.items() if name in dataset.entry.used]
        if missing:
            yield method.label, missing, evaluate_command(method.run)


def _section(board: Board, dataset: DatasetBoard, table: Table) -> dict[str, object]:
    """What a pair set and a total have in common."""
    groups = dataset.groups_of(table)
    return {
        "table": table,
        "total": False,
        "same_drive": table.pair_set == SAME_DRIVE_TOTAL,
        "numbers": _method_table(board, table),
        "ranks_shared": all(row.rank in (1, None) for row in table.rows),
        "without_intervals": any(row.rank is not None for row in table.rows)
        and all(not row.intervals.get(board.metric.name) for row in table.rows if not row.missing),
        "finer": [m.name for m in shown_metrics(board) if m.name in table.finer],
        "ranked_by_finer": board.metric.name in table.finer,
        "sigmas": [
            f"{number(table.medians[name], unit)} {words}"
            for name, unit, words in (("sigma_translation_m", "m", "m"), ("sigma_rotation_deg", "deg", "°"))
            if table.medians[name] is not None
        ],
        "pivots": [_pivot(table, groups, metric) for metric in (_pivoted(board) if groups else ())],
        "groups": [(group, _method_table(board, group, ranks=False)) for group in groups],
        "curves": "",
        "matching": None,
    }


def _pictures(dataset: DatasetBoard, table: Table, plots: bool) -> dict[str, object]:
    """What a section has if it is a pair set's: curves and matching quality."""
    lines = matching_lines(dataset, table.pair_set)
    return {
        "curves": quote(curve_file(dataset, table)) if plots and has_curves(table) else "",
        "matching": {
            "count": lines[0][1][ALL]["count"],
            "numbers": matching_numbers(lines),
            "picture": quote(matching_file(dataset, table.pair_set)),
        }
        if lines
        else None,
    }


def _differences(methods: Sequence[Method]) -> Iterator[tuple[str, str]]:
    """The targets that were run several times, with a table of the parameters that differ."""
    for target in dict.fromkeys(m.run.target for m in methods):
        runs = [m for m in methods if m.run.target == target]
        names = list(dict.fromkeys(name for m in runs for name in m.run.parameters))
        differing = [n for n in names if len({json_text(m.run.parameters.get(n)) for m in runs}) > 1]
        if differing:
            rows = [[escaped(m.label), *(code(json_text(m.run.parameters.get(n))) for n in differing)] for m in runs]
            yield target, table_text(["method", *map(code, differing)], rows, left=1)


def _method_table(board: Board, table: Table, *, ranks: bool = True) -> str:
    metrics = shown_metrics(board)
    columns = [
        *(["rank"] if ranks else []),
        "method",
        *(_heading(m, table) for m in metrics),
        "s a pair, median / p95",
        "failed / broke",
    ]
    rows = []
    for row in table.rows:
        head = [*(["" if row.rank is None else str(row.rank)] if ranks else []), _name(row)]
        rows.append([*head, *(_cell(m, row, table) for m in metrics), _seconds(row), _counts(row)])
    for seed_row in table.seeds:
        head = [*([""] if ranks else []), f"*{escaped(seed_row.title)}, mean ± sd*"]
        seconds = _spread_cell(metric_named("median_seconds"), seed_row, table)
        rows.append([*head, *(_spread_cell(m, seed_row, table) for m in metrics), seconds, ""])
    return table_text(columns, rows, left=2 if ranks else 1)


def _plain_heading(metric: Metric) -> str:
    return _HEADINGS.get(metric.name, f"{metric.name}, {'%' if metric.unit == 'share' else metric.unit}")


def _heading(metric: Metric, table: Table) -> str:
    text = _plain_heading(metric)
    return f"{text} {DAGGER}" if metric.name in table.finer else text


def _name(row: Row) -> str:
    label = escaped(row.method.label)
    told = [f"*{label}*" if row.method.is_floor or row.method.is_clock else label]
    if row.method.is_floor:
        told.append("(the floor)")
    elif row.method.is_clock:
        told.append("(the floor of times)")
    elif row.method.run.uses_times:
        told.append("(uses times)")
    return " ".join([*told, *(["(missing)"] if row.missing else []), *signs(row.method).split()])


def _cell(metric: Metric, row: Row, table: Table, *, interval: bool = True) -> str:
    value = row.values[metric.name]
    if value is None:
        return ""
    bounds = row.intervals.get(metric.name) if interval else None
    return _marked(with_bounds(value, bounds, metric.unit), metric, table)


def _spread_cell(metric: Metric, row: SeedRow, table: Table) -> str:
    spread: Spread | None = row.spread[metric.name]
    if spread is None:
        return ""
    text = number(spread.mean, metric.unit)
    if spread.standard_deviation is not None:
        text += f" ± {number(spread.standard_deviation, metric.unit)}"
    return _marked(text, metric, table)


def _marked(text: str, metric: Metric, table: Table) -> str:
    return f"<sub>{text}</sub>{DAGGER}" if metric.name in table.finer else text


def _seconds(row: Row) -> str:
    median, p95 = row.values["median_seconds"], row.values["p95_seconds"]
    return "" if median is None else f"{number(median, 's')} / {number(p95, 's')}"


def _counts(row: Row) -> str:
    return "" if row.missing else f"{row.failed} / {row.broke}"


def _pivoted(board: Board) -> list[Metric]:
    """The metrics that are tabulated by group: the ranking metric and a recall that readers may know."""
    return list({m.name: m for m in (board.metric, metric_named("recall@(0.25m,2deg)"))}.values())


def _pivot(table: Table, groups: Sequence[Table], metric: Metric) -> str:
    """A table of one metric: methods in the order of the whole set, and a column for each group."""
    columns = [
        f"`{metric.name}`, %" if metric.unit == "share" else f"`{metric.name}`",
        f"all<br>{table.pairs} pairs",
        *(f"{escaped(g.group)}<br>{g.pairs} pairs{_far(g)}" for g in groups),
    ]
    rows = []
    for row in table.rows:
        of_group = [next(r for r in g.rows if r.method is row.method) for g in groups]
        cells = [_cell(metric, r, t) for r, t in zip([row, *of_group], [table, *groups], strict=True)]
        rows.append([_name(row), *cells])
    return table_text(columns, rows, left=1)


def _far(table: Table) -> str:
    distance, angle = table.medians["distance_m"], table.medians["angle_deg"]
    far = [f"{number(distance, 'm')} m"] if distance is not None else []
    far += [f"{number(angle, 'deg')}°"] if angle is not None else []
    return f"<br>{', '.join(far)}" if far else ""
