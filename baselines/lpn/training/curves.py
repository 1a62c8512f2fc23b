"""``curves.png`` of an LPN training."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from baselines.training.curves import column, finish_panel, marker_for, new_figure, save_figure
from baselines.training.log import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_curves(path: Path, log: Sequence[Row], validation: Sequence[Row]) -> None:
    """Draw losses, the share of training images classified correctly, and validation scores, against the step.

    Vertical lines separate the stages. Nothing is written where the log is empty.
    """
    if not log:
        return
    figure = new_figure(12, 8)
    (loss, right), (recall, precision) = figure.subplots(2, 2)
    names = list(dict.fromkeys(name for row in log for name in row))
    of_loss = [name for name in names if name.startswith("instance") or name in ("loss", "decorrelation", "partition")]
    _lines(loss, log, of_loss, "losses, before their weights")
    _lines(right, log, [name for name in names if name.startswith("right/")], "training images told right")
    for axes, metric in ((recall, "R@1"), (precision, "AP")):
        for views in dict.fromkeys(row["views"] for row in validation):
            rows = [row for row in validation if row["views"] == views]
            axes.plot(*column(rows, metric), marker=".", label=views)
        finish_panel(axes, f"{metric} in validation, query-gallery")
    for axes in (right, recall, precision):
        axes.set_ylim(-0.02, 1.02)
    for axes in (loss, right):
        for before, row in pairwise(log):
            if before["stage"] != row["stage"]:
                axes.axvline(int(before["step"]), color="0.7", linewidth=1)
    save_figure(figure, path)


def _lines(axes: Axes, rows: Sequence[Row], names: Sequence[str], title: str) -> None:
    for name in names:
        axes.plot(*column(rows, name), marker=marker_for(rows), label=name)
    finish_panel(axes, title)
