"""``curves.png``: how a training went."""

from __future__ import annotations

import io
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from baselines.files import write_whole
from baselines.training.log import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_curves(path: Path, log: Sequence[Row], validation: Sequence[Row]) -> None:
    """Losses, share of training images whose place is told right, and what the weights retrieve, against the step.

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
    (loss, right), (recall, precision) = figure.subplots(2, 2)
    columns = list(dict.fromkeys(column for row in log for column in row))
    of_loss = [c for c in columns if c.startswith("instance") or c in ("loss", "decorrelation", "partition")]
    _lines(loss, log, of_loss, "losses, before their weights")
    _lines(right, log, [c for c in columns if c.startswith("right/")], "training images told right")
    for axes, metric in ((recall, "R@1"), (precision, "AP")):
        for views in dict.fromkeys(row["views"] for row in validation):
            rows = [row for row in validation if row["views"] == views]
            axes.plot(*_column(rows, metric), marker=".", label=views)
        _finish(axes, f"{metric} in validation, query-gallery")
    for axes in (right, recall, precision):
        axes.set_ylim(-0.02, 1.02)
    for axes in (loss, right):
        for before, row in pairwise(log):
            if before["stage"] != row["stage"]:
                axes.axvline(int(before["step"]), color="0.7", linewidth=1)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    write_whole(path, buffer.getvalue())


def _lines(axes: Axes, rows: Sequence[Row], columns: Sequence[str], title: str) -> None:
    for column in columns:
        axes.plot(*_column(rows, column), marker="." if len(rows) < 30 else "", label=column)
    _finish(axes, title)


def _finish(axes: Axes, title: str) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.set_title(title)
    axes.set_xlabel("step")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize="x-small")


def _column(rows: Sequence[Row], name: str) -> tuple[list[int], list[float]]:
    known = [row for row in rows if row.get(name)]
    return [int(row["step"]) for row in known], [float(row[name]) for row in known]
