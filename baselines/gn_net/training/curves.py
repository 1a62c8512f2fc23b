"""``curves.png``: how a training went."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from baselines.files import write_whole
from baselines.training.log import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_LINES = 12
"""in a panel whose legend is to be read"""
_PANELS = {
    "contrastive loss, by level": ("positive", "negative"),
    "Gauss-Newton and descent loss, by level": ("e1", "e2", "descent"),
    "share of points, by level": ("near_singular", "nearer"),
}


def draw_curves(path: Path, log: Sequence[Row], validation: Sequence[Row]) -> None:
    """Loss, its parts on each level, shares of points, and what the weights scored in validation, against the step.

    Args:
        log: rows of ``log.csv``.
        validation: rows of ``validation.csv``.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    if not log:
        return
    figure = Figure(figsize=(17, 9), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 3)
    _lines(above[0], log, ["loss"], "weighted sum of the losses")
    rate = above[0].twinx()
    rate.plot(*_column(log, "learning_rate"), color="0.7", linewidth=1)
    rate.set_ylabel("learning rate (grey)")
    for axes, (title, parts) in zip((above[1], above[2], below[0]), _PANELS.items(), strict=True):
        _lines(axes, log, [column for column in log[-1] if column.partition("/")[2] in parts], title)
    together = [row for row in validation if row["conditions"] == "all"]
    metrics = [column for column in (together[-1] if together else {}) if "@" in column]
    _lines(below[1], together, metrics, "validation by tracking, all conditions")
    by = "reference -> query"
    if metrics:
        combinations = {row["conditions"] for row in validation} - {"all"}
        if len(combinations) > _MOST_LINES:
            by = "condition of the query"
        for line, rows in sorted(_lines_of(validation, whole=len(combinations) <= _MOST_LINES).items()):
            below[2].plot(*_mean_column(rows, metrics[0]), marker=".", label=line)
    _finish(below[2], f"{metrics[0] if metrics else 'validation'} by {by}", legend_columns=1)
    for axes in below:
        axes.set_ylim(-0.02, 1.02)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    write_whole(path, buffer.getvalue())


def _lines_of(validation: Sequence[Row], whole: bool) -> dict[str, list[Row]]:
    """Rows of each combination of conditions, or of each condition of the query."""
    lines: dict[str, list[Row]] = {}
    for row in validation:
        if row["conditions"] != "all":
            lines.setdefault(row["conditions"] if whole else row["conditions"].partition(" -> ")[2], []).append(row)
    return lines


def _mean_column(rows: Sequence[Row], name: str) -> tuple[list[int], list[float]]:
    """Steps, and at each the mean over its rows, each with the weight of its pairs."""
    steps = sorted({int(row["step"]) for row in rows})
    means = []
    for step in steps:
        of_step = [row for row in rows if int(row["step"]) == step]
        pairs = [int(row["pairs"]) for row in of_step]
        means.append(sum(n * float(row[name]) for n, row in zip(pairs, of_step, strict=True)) / sum(pairs))
    return steps, means


def _lines(axes: Axes, rows: Sequence[Row], columns: Sequence[str], title: str) -> None:
    """One line a column: colour tells the part, dashes the level."""
    parts = list(dict.fromkeys(column.rpartition("/")[2] for column in columns))
    for column in columns:
        level, _, part = column.rpartition("/")
        style = ("-", "--", "-.", ":")[int(level or 0) % 4]
        marker = "." if len(rows) < 30 else ""
        axes.plot(*_column(rows, column), linestyle=style, marker=marker, color=f"C{parts.index(part)}", label=column)
    _finish(axes, title)


def _finish(axes: Axes, title: str, legend_columns: int = 2) -> None:
    axes.set_title(title)
    axes.set_xlabel("step")
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize="x-small", ncols=legend_columns)
    else:
        axes.text(0.5, 0.5, "no part of this training", ha="center", va="center", transform=axes.transAxes, color="0.5")


def _column(rows: Sequence[Row], name: str) -> tuple[list[int], list[float]]:
    known = [row for row in rows if row.get(name)]
    return [int(row["step"]) for row in known], [float(row[name]) for row in known]
