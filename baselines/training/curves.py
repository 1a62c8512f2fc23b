"""The parts of ``curves.png`` that all trainers share: a figure, its panels, and lines against the step."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from baselines.files import write_whole
from baselines.training.log import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, inches, that no window is opened for."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write the figure as a PNG, whole or not at all."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    write_whole(path, buffer.getvalue())


def column(rows: Sequence[Row], name: str) -> tuple[list[int], list[float]]:
    """Steps and values of a column, without the rows in which it is empty."""
    known = [row for row in rows if row.get(name)]
    return [int(row["step"]) for row in known], [float(row[name]) for row in known]


def marker_for(rows: Sequence[Row]) -> str:
    """A marker at each value where there are few of them."""
    return "." if len(rows) < 30 else ""


def finish_panel(axes: Axes, title: str, legend_columns: int = 1, if_empty: str = "") -> None:
    """Add title, axis, grid and legend; ``if_empty`` is written into a panel without lines."""
    from matplotlib.ticker import MaxNLocator

    axes.set_title(title)
    axes.set_xlabel("step")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize="x-small", ncols=legend_columns)
    elif if_empty:
        axes.text(0.5, 0.5, if_empty, ha="center", va="center", transform=axes.transAxes, color="0.5")
