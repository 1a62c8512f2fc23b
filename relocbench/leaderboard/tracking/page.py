"""``leaderboard.md``: what a sceptical reader wants to know about trackers, on one page."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import quote

from relocbench.leaderboard.common.copies import copies_words, question_words
from relocbench.leaderboard.common.text import bullet, code, escaped, number, table_text, with_bounds
from relocbench.leaderboard.tracking.load import evaluate_command
from relocbench.leaderboard.tracking.matching import matching_section
from relocbench.leaderboard.tracking.model import Board, DatasetBoard, Row, SeedRow, Table
from relocbench.leaderboard.tracking.page_methods import methods_section, reproduce_section
from relocbench.metrics import LEVEL, MIN_EFFECTIVE, Metric, Spread, metric_named

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
_HEADINGS = {
    "median_translation_error_m": "median, m",
    "median_rotation_error_deg": "median, °",
    "coverage": "coverage, %",
}
GREY = "†"


def markdown(board: Board, *, plots: bool) -> str:
    """The whole page; with ``plots``, it links the pictures of the curves."""
    parts = ["# Leaderboard", *_how_to_read(board)]
    for dataset in board.datasets:
        parts += _dataset(board, dataset, plots)
    parts += reproduce_section(board)
    return "\n\n".join(part for part in parts if part) + "\n"


def curve_file(dataset: DatasetBoard, table: Table) -> str:
    """The path of the picture of a pair set's curves, relative to the page."""
    return f"curves/{dataset.entry.title}__{table.pair_set}.png"


def has_curves(table: Table) -> bool:
    """Whether any method has a curve on the pair set."""
    return any(not row.missing for row in table.rows)


def shown_metrics(board: Board) -> list[Metric]:
    """The metrics shown as columns, with the ranking metric among them, in the order of :data:`SHOWN`."""
    names = [*SHOWN] if board.metric.name in SHOWN else [SHOWN[0], board.metric.name, *SHOWN[1:]]
    return [metric_named(name) for name in names]


def _how_to_read(board: Board) -> list[str]:
    metric = board.metric
    return [
        "Errors are those of `T_query_ref`: translation is the distance between the predicted and the true camera "
        "centre, rotation the angle between the two orientations. Shares are in percent; "
        f"`[low, high]` is a {LEVEL:.0%} interval for the number of independent pairs that the pairs are "
        "worth; there is none where they are worth fewer than ten. "
        "All numbers, in full, are in `leaderboard.csv`; the errors of every single pair are in `errors.csv`.",
        f"**Ranks** go by `{metric.name}` ({metric.description}). A method's rank is one more than the number of "
        "methods that are significantly better, by a test with one error rate for the whole table: the order within a "
        "rank says nothing. Floors have no rank. "
        "A total is the mean over the pair sets, each counting the same.",
        "**Failures.** A pair without an answer, with a failure or with an answer that is not finite has infinite "
        "error, and stays in the denominator, which is every pair of the set. A failure is never replaced by the prior "
        "or the identity. No pair set is dropped from a mean: a method that misses one has blank totals and no rank. "
        "*failed* counts pairs where the method said that it failed, *broke* those where it raised, crashed or "
        "answered nonsense; both are failures. A median is inf when half of the pairs or more have no answer. Pairs "
        "whose ground truth was rejected are not in a set; their number is printed.",
        "**The floor.** The identity pose claims that the query camera stands where the keyframe does. Where pairs "
        "are close it earns a real score, and every other number must be read against it.",
        f"**Grey.** <sub>Small</sub>{GREY} numbers have a threshold finer than twice the standard deviation (σ) of "
        "the pair set's ground truth: they measure the ground truth rather than the method.",
    ]


def _dataset(board: Board, dataset: DatasetBoard, plots: bool) -> list[str]:
    entry = dataset.entry
    parts = [f"## {escaped(entry.record.name)}", _facts(dataset), _pair_set_table(dataset)]
    if entry.withheld:
        names = ", ".join(map(code, entry.withheld))
        parts.append(f"Not scored, because the ground truth is withheld or no pair was accepted: {names}.")
    unused = [name for name in entry.pair_sets if name not in entry.used]
    if unused:
        parts.append(f"No method has been run on {', '.join(map(code, unused))}.")
    if not dataset.pair_sets:
        return parts
    parts += [_floor_note(dataset), _missing_note(dataset)]
    for table in dataset.totals:
        if len(table.pair_sets) > 1:
            title = f"### Total of split {code(table.split)}" if table.split else "### Total"
            over = f"Mean over {len(table.pair_sets)} pair sets: {', '.join(map(code, table.pair_sets))}."
            parts += [title, over, *_tables(board, table, dataset.groups_of(table))]
    for table in dataset.pair_sets:
        parts += [f"### {escaped(table.pair_set)}", *_tables(board, table, dataset.groups_of(table))]
        if plots and has_curves(table):
            address = quote(curve_file(dataset, table))
            parts.append(f"![Cumulative error curves of {escaped(table.pair_set)}]({address})")
        parts += matching_section(dataset, table.pair_set, plots=plots)
    return [*parts, *methods_section(dataset)]


def _facts(dataset: DatasetBoard) -> str:
    record = dataset.entry.record
    pairs = sum(s.pairs for s in dataset.entry.pair_sets.values())
    rejected = sum(s.rejected for s in dataset.entry.pair_sets.values())
    return (
        f"Fingerprint {code(record.fingerprint)}{question_words(record.question)}. Licence: {escaped(record.licence)}. "
        f"{pairs} pairs in {len(dataset.entry.pair_sets)} pair sets; {rejected} more were rejected "
        "because their ground truth could not be verified." + copies_words(dataset.entry.methods, dataset.entry.copies)
    )


def _pair_set_table(dataset: DatasetBoard) -> str:
    rows = []
    for name, s in dataset.entry.pair_sets.items():
        splits = [split for split, names in dataset.entry.splits.items() if split and name in names]
        rows.append(
            [
                code(name),
                f"{escaped(s.reference_condition)} → {escaped(s.query_condition)}",
                escaped(" ".join(splits)),
                str(s.pairs),
                str(s.rejected),
                number(s.median_distance_m, "m"),
                number(s.median_angle_deg, "deg"),
                _sigma(s.median_sigma_translation_m, "m"),
                _sigma(s.median_sigma_rotation_deg, "deg"),
            ]
        )
    columns = [
        "pair set",
        "reference → query",
        "split",
        "pairs",
        "rejected",
        "median distance, m",
        "median angle, °",
        "ground-truth σ, m",
        "ground-truth σ, °",
    ]
    return table_text(columns, rows, left=3)


def _sigma(value: float | None, unit: str) -> str:
    return "unknown" if value is None else number(value, unit)


def _floor_note(dataset: DatasetBoard) -> str:
    floor = dataset.entry.floor
    if floor is None:
        return (
            "**The floor is missing:** the identity pose has not been run on this dataset, so nobody can tell how much "
            "of these numbers the pairs give away. Run `relocbench evaluate --method identity`."
        )
    tables = [t for t in dataset.pair_sets if any(r.method is floor and not r.missing for r in t.rows)]
    lines = []
    for table in tables:
        level = [r.method.label for r in table.rows if r.above_floor is not None and not _beats(r)]
        if level:
            lines.append(f"on {code(table.pair_set)}: {', '.join(map(code, level))}")
    if not lines:
        return ""
    return bullet(
        "**Not shown to be better than the floor** (the paired difference does not exclude zero, or is negative):",
        lines,
    )


def _beats(row: Row) -> bool:
    return row.above_floor is not None and row.above_floor.significant and row.above_floor.mean > 0


def _missing_note(dataset: DatasetBoard) -> str:
    lines = []
    for method in dataset.entry.methods:
        missing = {name: why for name, why in method.missing.items() if name in dataset.entry.used}
        for name, why in missing.items():
            lines.append(f"{code(method.label)} on {code(name)}: {why}")
        if missing:
            lines[-1] += f"; to run what is missing: {code(evaluate_command(method.run))}"
    return bullet("**Missing results**, hence blank totals and no rank:", lines)


def _tables(board: Board, table: Table, groups: Sequence[Table]) -> list[str]:
    parts = [_method_table(board, table)]
    if any(row.rank is not None for row in table.rows) and all(
        not row.intervals.get(board.metric.name) for row in table.rows if not row.missing
    ):
        parts.append(
            f"Too few pairs for intervals: they are worth fewer than {MIN_EFFECTIVE:g} independent ones."
            + (" All methods share a rank." if all(row.rank in (1, None) for row in table.rows) else "")
        )
    if table.grey:
        parts.append(_grey_note(board, table))
    if groups:
        parts += ["By group:", *(_pivot(table, groups, metric) for metric in _pivoted(board)), _details(board, groups)]
    return parts


def _grey_note(board: Board, table: Table) -> str:
    sigmas = [
        f"{number(table.medians[name], unit)} {words}"
        for name, unit, words in (("sigma_translation_m", "m", "m"), ("sigma_rotation_deg", "deg", "°"))
        if table.medians[name] is not None
    ]
    shown = [code(m.name) for m in shown_metrics(board) if m.name in table.grey]
    if not shown:
        return ""
    ranked = " This includes the metric that ranks: the ranks here are not to be relied on."
    return f"{GREY} finer than twice the ground truth's σ ({', '.join(sigmas)}): {', '.join(shown)}." + (
        ranked if board.metric.name in table.grey else ""
    )


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


def _heading(metric: Metric, table: Table) -> str:
    text = _HEADINGS.get(metric.name, f"{metric.name}, {'%' if metric.unit == 'share' else metric.unit}")
    return f"{text} {GREY}" if metric.name in table.grey else text


def _name(row: Row) -> str:
    if row.method.is_floor:
        return f"*{escaped(row.method.label)}* (the floor)"
    return escaped(row.method.label) + (" (missing)" if row.missing else "")


def _cell(metric: Metric, row: Row, table: Table) -> str:
    value = row.values[metric.name]
    if value is None:
        return ""
    return _greyed(with_bounds(value, row.intervals.get(metric.name), metric.unit), metric, table)


def _spread_cell(metric: Metric, row: SeedRow, table: Table) -> str:
    spread: Spread | None = row.spread[metric.name]
    if spread is None:
        return ""
    text = number(spread.mean, metric.unit)
    if spread.standard_deviation is not None:
        text += f" ± {number(spread.standard_deviation, metric.unit)}"
    return _greyed(text, metric, table)


def _greyed(text: str, metric: Metric, table: Table) -> str:
    return f"<sub>{text}</sub>{GREY}" if metric.name in table.grey else text


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


def _details(board: Board, groups: Sequence[Table]) -> str:
    inner = "\n\n".join(
        f"{escaped(g.group)}, {g.pairs} pairs\n\n{_method_table(board, g, ranks=False)}" for g in groups
    )
    return f"<details><summary>All numbers of the groups</summary>\n\n{inner}\n\n</details>"
