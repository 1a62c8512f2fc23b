"""The names, headings and cells that the pages of a leaderboard have in common, in Markdown."""

from __future__ import annotations

from relocbench.leaderboard.common import headings, ranks
from relocbench.leaderboard.common.text import number, with_bounds
from relocbench.leaderboard.tracking.marks import signs
from relocbench.leaderboard.tracking.model import SAME_DRIVE_TOTAL, Board, DatasetBoard, Row, Table
from relocbench.metrics import Metric
from relocbench.pages.markdown import code, escaped

DAGGER = "†"


def plain_heading(metric: Metric) -> str:
    """The heading of a metric's column, with its unit."""
    return headings.heading(metric.name, metric.unit)


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


def why_no_ranks(board: Board, table: Table) -> str:
    """The sentence of :func:`ranks.why_no_ranks` for a table of trackers."""
    return ranks.why_no_ranks(table.rows, board.metric.name, f"{table.pairs} pairs")
