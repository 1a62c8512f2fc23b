"""Cumulative error curves: the share of all pairs against the error, translation beside rotation."""

from __future__ import annotations

import io
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from relocbench.evaluation.matching_table import OFFSETS_PX
from relocbench.evaluation.score import errors_of
from relocbench.leaderboard.load import Method
from relocbench.leaderboard.matching import matching_lines
from relocbench.leaderboard.model import Board, DatasetBoard, Row, Table
from relocbench.metrics import PoseErrors, cumulative_curve
from relocbench.metrics.registry import SIGMA_FACTOR

Array = NDArray[np.float64]
LIMIT_M = 1.0
LIMIT_DEG = 1.0
# Okabe and Ito, "Color Universal Design" (2008), without the yellow, which is faint on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
Style = str | tuple[float, tuple[float, ...]]
STYLES: tuple[Style, ...] = ("-", (0, (1, 0.8)), (0, (4, 1, 1, 1)))
FLOOR_COLOUR = "#767676"


@dataclass(frozen=True)
class _Line:
    label: str
    errors: PoseErrors
    colour: str
    style: Style
    width: float


def curve_picture(board: Board, dataset: DatasetBoard, table: Table) -> bytes:
    """PNG of a pair set's curves; a method keeps its colour on all pair sets of a dataset."""
    lines = [_line(board, dataset, table, row) for row in table.rows if not row.missing]
    with mpl.rc_context():
        mpl.rcdefaults()  # the reader's own settings must not change the picture
        mpl.rcParams.update({"font.size": 10, "axes.spines.top": False, "axes.spines.right": False})
        figure = Figure(figsize=(11, 4.2), dpi=130, layout="constrained")
        FigureCanvasAgg(figure)
        left, right = figure.subplots(1, 2, sharey=True)
        sigma_m, sigma_deg = table.medians["sigma_translation_m"], table.medians["sigma_rotation_deg"]
        _panel(left, [(line, line.errors.translation_error_m) for line in lines], LIMIT_M, sigma_m)
        _panel(right, [(line, line.errors.rotation_error_deg) for line in lines], LIMIT_DEG, sigma_deg)
        left.set_xlabel("translation error (m)")
        right.set_xlabel("rotation error (°)")
        left.set_ylabel(f"share of all {table.pairs} pairs")
        record = dataset.entry.pair_sets[table.pair_set]
        conditions = f"{record.reference_condition} → {record.query_condition}"
        figure.suptitle(f"{dataset.entry.record.name}: {table.pair_set}\n{conditions}", fontsize=11)
        handles, labels = left.get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside right upper", title=board.metric.name, frameon=False, handlelength=3.2
        )
        picture = io.BytesIO()
        figure.savefig(picture, format="png", metadata={"Software": None})
    return picture.getvalue()


def _line(board: Board, dataset: DatasetBoard, table: Table, row: Row) -> _Line:
    method = row.method
    errors = errors_of(method.errors[table.pair_set])
    value = row.values[board.metric.name]
    label = f"{method.label}  {100 * value:.1f} %" if value is not None else method.label
    colour, style = _look(dataset, method)
    return _Line(
        f"{label} (floor)" if method.is_floor else label, errors, colour, style, 1.6 if method.is_floor else 1.8
    )


def _look(dataset: DatasetBoard, method: Method) -> tuple[str, Style]:
    """Colour and line style of a method, the same in all pictures of a dataset."""
    if method.is_floor:
        return FLOOR_COLOUR, (0, (4, 2))
    place = [m.label for m in dataset.entry.methods if not m.is_floor].index(method.label)
    return COLOURS[place % len(COLOURS)], STYLES[place // len(COLOURS) % len(STYLES)]


def matching_picture(dataset: DatasetBoard, pair_set: str) -> bytes:
    """PNG of the share of pixels found to 3 px against how far off the start was; colours as in the error curves."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update({"font.size": 10, "axes.spines.top": False, "axes.spines.right": False})
        figure = Figure(figsize=(6.5, 3.6), dpi=130, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots()
        for method, summary in matching_lines(dataset, pair_set):
            shares = [summary[f"{offset}px"]["match@3px"] for offset in OFFSETS_PX]
            y = [np.nan if share is None else 100 * share for share in shares]
            colour, style = _look(dataset, method)
            axes.plot(OFFSETS_PX, y, color=colour, linestyle=style, linewidth=1.8, marker="o", label=method.label)
        axes.set_xscale("log", base=2)
        axes.set_xticks(OFFSETS_PX, [str(offset) for offset in OFFSETS_PX])
        axes.set_xlabel("start off the true pixel by (px)")
        axes.set_ylabel("found to 3 px")
        axes.set_ylim(0, 101.5)
        axes.yaxis.set_major_formatter("{x:.0f} %")
        axes.grid(True, color="#dddddd", linewidth=0.6)
        axes.set_title(f"{dataset.entry.record.name}: {pair_set}", fontsize=11)
        axes.legend(frameon=False, handlelength=3.2)
        picture = io.BytesIO()
        figure.savefig(picture, format="png", metadata={"Software": None})
    return picture.getvalue()


def _panel(axes: Axes, curves: list[tuple[_Line, Array]], limit: float, sigma: float | None) -> None:
    for order, (line, error) in enumerate(curves):
        curve = cumulative_curve(error)
        inside = curve.error <= limit
        x = np.concatenate([[0.0], curve.error[inside], [limit]])
        y = 100 * np.concatenate([[0.0], curve.share[inside], [curve.at(limit)]])
        # The best is drawn last, so that it is not hidden where curves meet.
        axes.step(
            x,
            y,
            where="post",
            color=line.colour,
            linestyle=line.style,
            linewidth=line.width,
            label=line.label,
            zorder=3 + len(curves) - order,
        )
    if sigma:
        finest = min(SIGMA_FACTOR * sigma, limit)
        axes.axvspan(0, finest, color="#000000", alpha=0.07, linewidth=0)
        axes.text(0, 103, "shaded: finer than 2σ of the ground truth", fontsize=7, va="bottom", color="#555555")
    axes.set_xlim(0, limit)
    axes.set_ylim(0, 101.5)  # a curve at 100 % is seen in its full width
    axes.yaxis.set_major_formatter("{x:.0f} %")
    axes.grid(True, color="#dddddd", linewidth=0.6)
    axes.tick_params(labelleft=True)
