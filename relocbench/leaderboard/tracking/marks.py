"""Names, headings and cells of the pages in Markdown, and what readers must know of a row: its marks, and its rank."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from relocbench.evaluation.common.results import PREDICTIONS, RunRecord
from relocbench.evaluation.tracking.trivial import TARGET as CLOCK_TARGET
from relocbench.leaderboard.common import model, text
from relocbench.leaderboard.common.text import number, with_bounds
from relocbench.leaderboard.tracking.method import Method
from relocbench.leaderboard.tracking.model import SAME_DRIVE_TOTAL, Board, DatasetBoard, Row, Table
from relocbench.metrics import Metric
from relocbench.pages.markdown import code, escaped

DAGGER = "†"


def plain_heading(metric: Metric) -> str:
    """The heading of a metric's column, with its unit."""
    return text.heading(metric.name, metric.unit)


def heading(metric: Metric, table: Table) -> str:
    """The same, with a dagger where thresholds are finer than the table's ground truth."""
    text = plain_heading(metric)
    return f"{text} {DAGGER}" if metric.name in table.finer else text


def name(row: Row) -> str:
    """The label of a row's method, with what its readers must know."""
    label = escaped(row.method.label)
    words = [f"*{label}*" if row.method.is_baseline else label]
    if row.method.is_identity:
        words.append("(trivial baseline)")
    elif row.method.is_clock:
        words.append("(timestamp-only baseline)")
    elif row.method.run.uses_times:
        words.append("(uses times)")
    if row.method.run.assumes:
        words.append(f"({escaped(row.method.run.assumes)})")
    return " ".join([*words, *(["(missing)"] if row.missing else []), *signs(row.method)])


def cell(metric: Metric, row: Row, table: Table, *, interval: bool = True) -> str:
    """A value with its interval, small and with a dagger where it measures the ground truth; empty without a value."""
    value = row.values[metric.name]
    if value is None:
        return ""
    bounds = row.intervals.get(metric.name) if interval else None
    return marked(with_bounds(value, bounds, metric.unit), metric, table)


def marked(text: str, metric: Metric, table: Table) -> str:
    """The text of a metric's value, small and with a dagger where its thresholds are finer than the ground truth."""
    return f"<sub>{text}</sub>{DAGGER}" if metric.name in table.finer else text


def total_name(table: Table) -> str:
    """What a total is over: pair sets across conditions or of the same drive, and of which split, in Markdown."""
    return f"{_drives(table)}, split {code(table.split)}" if table.split else _drives(table)


def total_words(table: Table) -> str:
    """The same as plain text."""
    return f"{_drives(table)}, split {table.split}" if table.split else _drives(table)


def _drives(table: Table) -> str:
    return "same drive" if table.pair_set == SAME_DRIVE_TOTAL else "cross-condition"


def group_heading(group: Table) -> str:
    """The name of a group, the number of its pairs, and how far apart the cameras of the median pair are."""
    distance, angle = group.medians["distance_m"], group.medians["angle_deg"]
    far = [f"{number(distance, 'm')} m"] if distance is not None else []
    far += [f"{number(angle, 'deg')}°"] if angle is not None else []
    return "<br>".join([escaped(group.group), f"{group.pairs} pairs", *([", ".join(far)] if far else [])])


def same_method(row: Row, table: Table) -> Row:
    """The row of a row's method in another table."""
    return next(other for other in table.rows if other.method is row.method)


def level_with_identity(dataset: DatasetBoard, table: Table) -> list[str]:
    """The methods without a significant gain over the identity baseline.

    None where that was not run; a method whose gain has too few independent pairs for a test is left out.
    """
    if not any(row.method is dataset.entry.identity and not row.missing for row in table.rows):
        return []
    gains = [(row.method, row.above_identity) for row in table.rows if row.above_identity and not row.method.is_clock]
    return [method.label for method, gain in gains if gain.interval and not (gain.significant and gain.mean > 0)]


def about_ranks(board: Board, table: Table) -> str:
    """The sentence of :func:`relocbench.leaderboard.common.model.about_ranks` for a table of trackers."""
    return model.about_ranks(table.rows, board.metric.name, f"{table.pairs} pairs")


def is_ranked(method: Method) -> bool:
    """Whether a method takes part in ranks: neither trivial baselines do nor methods that are shown times."""
    return not (method.is_baseline or method.run.uses_times)


def made_elsewhere(run: RunRecord) -> bool:
    """Whether the predictions were made elsewhere and imported."""
    return run.made_elsewhere or run.target.startswith(PREDICTIONS)


def not_isolated(run: RunRecord) -> bool:
    """Whether a tracker may have seen the truth: it ran beside it, or nothing says that it did not."""
    return run.isolated is not True and not made_elsewhere(run) and run.target != CLOCK_TARGET


def not_rescored(method: Method) -> bool:
    """Whether the errors are those that the results folder claims."""
    return bool(method.errors) and not method.rescored


@dataclass(frozen=True)
class Mark:
    """A sign behind the names of methods, and what it says of them."""

    sign: str
    name: str
    words: str
    """Markdown of our own"""
    applies: Callable[[Method], bool]


MARKS = (
    Mark(
        "¹",
        "not isolated",
        "the method ran in the evaluator's own process (`--workers 0`), where the truth lies, or its "
        "record does not say where it ran",
        lambda method: not_isolated(method.run),
    ),
    Mark(
        "²",
        "made elsewhere",
        "the predictions were imported, and nobody here saw what made them or how long it took",
        lambda method: made_elsewhere(method.run),
    ),
    Mark(
        "³",
        "not rescored",
        "the dataset, or the answers that the numbers follow from, were unavailable: the errors are those that the "
        "results folder claims",
        not_rescored,
    ),
)


def signs(*methods: Method) -> list[str]:
    """The signs of the marks that apply to a method, or to any of several of one name, in their order."""
    return [mark.sign for mark in MARKS if any(map(mark.applies, methods))]
