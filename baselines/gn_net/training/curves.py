"""``curves.png`` of a GN-Net training."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from baselines.training.curves import column, finish_panel, marker_for, new_figure, save_figure
from baselines.training.log import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_LINES = 12
"""in a panel whose legend can still be read"""
_PANELS = {
    "contrastive loss, by level": ("positive", "negative"),
    "Gauss-Newton and descent loss, by level": ("e1", "e2", "descent"),
    "share of points, by level": ("near_singular", "nearer"),
}
_EMPTY = "no part of this training"


def draw_curves(path: Path, log: Sequence[Row], validation: Sequence[Row]) -> None:
    """Draw the loss, its parts on each level, shares of points, and the validation scores, against the step.

    Nothing is written where the log is empty.
    """
    if not log:
        return
    figure = new_figure(17, 9)
    above, below = figure.subplots(2, 3)
    _lines(above[0], log, ["loss"], "weighted sum of the losses")
    rate = above[0].twinx()
    rate.plot(*column(log, "learning_rate"), color="0.7", linewidth=1)
    rate.set_ylabel("learning rate (grey)")
    for axes, (title, parts) in zip((above[1], above[2], below[0]), _PANELS.items(), strict=True):
        _lines(axes, log, [name for name in log[-1] if name.partition("/")[2] in parts], title)
    together = [row for row in validation if row["conditions"] == "all"]
    metrics = [name for name in (together[-1] if together else {}) if "@" in name]
    _lines(below[1], together, metrics, "validation by tracking, all conditions")
    by = "reference -> query"
    if metrics:
        combinations = {row["conditions"] for row in validation} - {"all"}
        if len(combinations) > _MOST_LINES:
            by = "condition of the query"
        for line, rows in sorted(_rows_by_line(validation, whole=len(combinations) <= _MOST_LINES).items()):
            below[2].plot(*_mean_column(rows, metrics[0]), marker=".", label=line)
    finish_panel(below[2], f"{metrics[0] if metrics else 'validation'} by {by}", if_empty=_EMPTY)
    for axes in below:
        axes.set_ylim(-0.02, 1.02)
    save_figure(figure, path)


def _rows_by_line(validation: Sequence[Row], whole: bool) -> dict[str, list[Row]]:
    """The rows of each combination of conditions if ``whole``, otherwise of each condition of the query."""
    lines: dict[str, list[Row]] = {}
    for row in validation:
        if row["conditions"] != "all":
            lines.setdefault(row["conditions"] if whole else row["conditions"].partition(" -> ")[2], []).append(row)
    return lines


def _mean_column(rows: Sequence[Row], name: str) -> tuple[list[int], list[float]]:
    """Steps, and the mean over the rows of each step, weighted by their numbers of pairs."""
    steps = sorted({int(row["step"]) for row in rows})
    means = []
    for step in steps:
        of_step = [row for row in rows if int(row["step"]) == step]
        pairs = [int(row["pairs"]) for row in of_step]
        means.append(sum(n * float(row[name]) for n, row in zip(pairs, of_step, strict=True)) / sum(pairs))
    return steps, means


def _lines(axes: Axes, rows: Sequence[Row], names: Sequence[str], title: str) -> None:
    """One line for each column: its colour tells the part of the loss, its dashes the level."""
    parts = list(dict.fromkeys(name.rpartition("/")[2] for name in names))
    for name in names:
        level, _, part = name.rpartition("/")
        style = ("-", "--", "-.", ":")[int(level or 0) % 4]
        colour = f"C{parts.index(part)}"
        axes.plot(*column(rows, name), linestyle=style, marker=marker_for(rows), color=colour, label=name)
    finish_panel(axes, title, legend_columns=2, if_empty=_EMPTY)
