"""``curves.png``: how a training went."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from baselines.gn_net.training.files import write_whole
from baselines.gn_net.training.log import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PARTS = ("positive", "negative", "e1", "e2", "descent")
_SHARES = ("near_singular", "nearer")


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
    figure = Figure(figsize=(12, 8), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 2)
    _lines(above[0], log, [c for c in log[-1] if c == "loss"], "loss")
    rate = above[0].twinx()
    rate.plot(*_column(log, "learning_rate"), color="0.7", linewidth=1)
    rate.set_ylabel("learning rate (grey)")
    _lines(above[1], log, _named(log, _PARTS), "parts of the loss before weights, by level")
    _lines(below[0], log, _named(log, _SHARES), "share of points, by level")
    below[0].set_ylim(-0.02, 1.02)
    together = [row for row in validation if row["conditions"] == "all"]
    metrics = [c for c in (together[-1] if together else {}) if "@" in c]
    _lines(below[1], together, metrics, "validation by tracking, all conditions")
    below[1].set_ylim(-0.02, 1.02)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    write_whole(path, buffer.getvalue())


def _named(rows: Sequence[Row], parts: Sequence[str]) -> list[str]:
    return [column for column in rows[-1] if column.partition("/")[2] in parts]


def _lines(axes: Axes, rows: Sequence[Row], columns: Sequence[str], title: str) -> None:
    """One line a column: colour tells the part, dashes the level."""
    parts = list(dict.fromkeys(column.rpartition("/")[2] for column in columns))
    for column in columns:
        level, _, part = column.rpartition("/")
        style = ("-", "--", "-.", ":")[int(level or 0) % 4]
        marker = "." if len(rows) < 30 else ""
        axes.plot(*_column(rows, column), linestyle=style, marker=marker, color=f"C{parts.index(part)}", label=column)
    axes.set_title(title)
    axes.set_xlabel("step")
    axes.grid(alpha=0.3)
    if columns:
        axes.legend(fontsize="x-small", ncols=2)


def _column(rows: Sequence[Row], name: str) -> tuple[list[int], list[float]]:
    known = [row for row in rows if row.get(name)]
    return [int(row["step"]) for row in known], [float(row[name]) for row in known]
