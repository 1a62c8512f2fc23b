"""Plots of cumulative error curves (the share of all pairs against the error), of what confidences are worth, and of
matching quality."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from relocbench.evaluation.common.matching_table import OFFSETS_PX
from relocbench.leaderboard.tracking.load import Method
from relocbench.leaderboard.tracking.matching import matching_lines
from relocbench.leaderboard.tracking.model import SAME_DRIVE_TOTAL, Board, DatasetBoard, Row, Table
from relocbench.metrics import CORRECT, cumulative_curve, precision_recall, within
from relocbench.metrics.pose.registry import SIGMA_FACTOR

Array = NDArray[np.float64]
LIMIT_M = 1.0
LIMIT_DEG = 1.0
# Okabe and Ito, "Color Universal Design" (2008), without the yellow, which is faint on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
Style = str | tuple[float, tuple[float, ...]]
STYLES: tuple[Style, ...] = ("-", (0, (1, 0.8)), (0, (4, 1, 1, 1)))
BASELINE_COLOUR = "#767676"


_INCHES = (11.0, 4.2)
"""size of a picture of curves; long names make it wider, many names make it taller"""
_LEFT, _GAP, _RIGHT, _BELOW, _ABOVE, _EDGE = 0.78, 0.75, 0.25, 0.5, 0.66, 0.1
"""inches around and between the panels of a picture of curves"""
_NARROWEST = 2.6
LONGEST_LABEL = 60
"""characters of a name in a picture; a longer one would leave no room for the curves"""


@dataclass(frozen=True, eq=False)
class Curve:
    """The curves of one method in the picture of a pair set."""

    label: str
    translation_error_m: Array
    """(M,) ascending, up to the limit of the picture"""
    rotation_error_deg: Array
    translation_share: Array
    """(M,) percent of all pairs"""
    rotation_share: Array
    colour: str
    style: Style
    width: float


@dataclass(frozen=True, eq=False)
class CurvePicture:
    """The content of the picture of a pair set's cumulative error curves."""

    title: str
    pairs: int
    ranked_by: str
    curves: tuple[Curve, ...]
    sigma_m: float | None
    sigma_deg: float | None


@dataclass(frozen=True, eq=False)
class MatchingPicture:
    """The content of the picture of matching quality: for each line a label, percents by offset, colour and style."""

    title: str
    lines: tuple[tuple[str, tuple[float, ...], str, Style], ...]


@dataclass(frozen=True, eq=False)
class RiskPicture:
    """The content of the picture of a total's risk-coverage curves."""

    title: str
    pairs: int
    lines: tuple[tuple[str, Array, Array, str, Style], ...]
    """label, coverage (K,) and risk (K,) in percent, colour and style"""


Picture = CurvePicture | MatchingPicture | RiskPicture


def curve_picture(board: Board, dataset: DatasetBoard, table: Table) -> CurvePicture:
    """The picture of a pair set's curves; a method has the same colour on all pair sets of a dataset."""
    record = dataset.entry.pair_sets[table.pair_set]
    conditions = f"{record.reference_condition} → {record.query_condition}"
    return CurvePicture(
        f"{_shown(f'{dataset.entry.record.name}: {table.pair_set}', 2)}\n{_shown(conditions, 2)}",
        table.pairs,
        board.metric.name,
        tuple(_curve(board, dataset, table, row) for row in table.rows if not row.missing),
        table.medians["sigma_translation_m"],
        table.medians["sigma_rotation_deg"],
    )


def matching_picture(dataset: DatasetBoard, pair_set: str) -> MatchingPicture:
    """The share of pixels found within 3 px against the offset of the start, in the colours of the error curves."""
    lines = []
    for method, summary in matching_lines(dataset, pair_set):
        shares = [summary[f"{offset}px"]["match@3px"] for offset in OFFSETS_PX]
        percent = tuple(np.nan if share is None else 100 * share for share in shares)
        lines.append((_shown(method.label), percent, *_look(dataset, method)))
    return MatchingPicture(_shown(f"{dataset.entry.record.name}: {pair_set}", 2), tuple(lines))


def risk_picture(dataset: DatasetBoard, table: Table) -> RiskPicture:
    """The share of wrong answers against the share of all pairs that are answered, as the required confidence falls.

    The pairs of all sets of a total are taken together, so that a confidence must mean the same on each of them.
    Trivial baselines and methods that answer nothing are left out.
    """
    lines = []
    for row in table.rows:
        method = row.method
        if row.missing or not row.answered or method.is_baseline:
            continue
        of_sets = [method.errors[name] for name in table.pair_sets]
        right = np.concatenate([within(of_set.errors, *CORRECT) for of_set in of_sets])
        answered = np.concatenate([of_set.errors.answered for of_set in of_sets])
        curve = precision_recall(right, answered, np.concatenate([of_set.column("confidence") for of_set in of_sets]))
        lines.append((_shown(method.label), 100 * curve.coverage, 100 * curve.risk, *_look(dataset, method)))
    kind = "one drive" if table.pair_set == SAME_DRIVE_TOTAL else "two drives"
    where = f"{dataset.entry.record.name}: {kind}{f', split {table.split}' if table.split else ''}"
    return RiskPicture(_shown(where, 2), table.pairs, tuple(lines))


def draw(picture: Picture) -> bytes:
    """Draw a picture as PNG, with the same bytes in any process."""
    return png_of(lambda: _figure(picture))


def png_of(make: Callable[[], Figure]) -> bytes:
    """The PNG of the figure that ``make`` returns, drawn with settings of relocbench, the same bytes in any process."""
    with mpl.rc_context(), warnings.catch_warnings():
        # Names may contain letters that the font lacks.
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        mpl.rcdefaults()  # the user's own settings must not change the picture
        mpl.rcParams.update({"font.size": 10, "axes.spines.top": False, "axes.spines.right": False})
        mpl.rcParams["text.parse_math"] = False  # a $ in a name is not a formula
        return _png(make())


def _figure(picture: Picture) -> Figure:
    if isinstance(picture, CurvePicture):
        return _curves(picture)
    return _risks(picture) if isinstance(picture, RiskPicture) else _matching(picture)


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    # A twentieth larger than at the default level, and drawn in seven eighths of the time.
    figure.savefig(stream, format="png", metadata={"Software": None}, pil_kwargs={"compress_level": 1})
    return stream.getvalue()


def _curves(picture: CurvePicture) -> Figure:
    figure = Figure(figsize=_INCHES, dpi=130)
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True)
    metres = [(c, c.translation_error_m, c.translation_share) for c in picture.curves]
    degrees = [(c, c.rotation_error_deg, c.rotation_share) for c in picture.curves]
    handles = _panel(left, metres, LIMIT_M, picture.sigma_m)
    _panel(right, degrees, LIMIT_DEG, picture.sigma_deg)
    left.set_xlabel("translation error (m)")
    right.set_xlabel("rotation error (°)")
    left.set_ylabel(f"share of all {picture.pairs} pairs")
    # Labels are passed explicitly: the legend made from the axes leaves out labels that begin with _.
    labels = [curve.label for curve in picture.curves]
    legend = figure.legend(
        handles,
        labels,
        loc="upper right",
        bbox_to_anchor=(1, 1),
        title=picture.ranked_by,
        frameon=False,
        handlelength=3.2,
    )
    # matplotlib's own layout would draw everything twice, which would dominate the time for a page of many sets.
    extent = legend.get_window_extent()
    around = _LEFT + _GAP + _RIGHT + extent.width / figure.dpi
    panel = max((_INCHES[0] - around) / 2, _NARROWEST), _INCHES[1] - _BELOW - _ABOVE
    width, height = around + 2 * panel[0], max(_INCHES[1], extent.height / figure.dpi + 2 * _EDGE)
    figure.set_size_inches(width, height)
    below = height - _ABOVE - panel[1]
    for axes, start in ((left, _LEFT), (right, _LEFT + panel[0] + _GAP)):
        axes.set_position((start / width, below / height, panel[0] / width, panel[1] / height))
    figure.suptitle(picture.title, fontsize=11, x=_LEFT / width, y=1 - _EDGE / height, ha="left")
    return figure


def _curve(board: Board, dataset: DatasetBoard, table: Table, row: Row) -> Curve:
    method = row.method
    errors = method.errors[table.pair_set].errors
    value = row.values[board.metric.name]
    name = _shown(method.label)
    label = f"{name}  {100 * value:.1f} %" if value is not None else name
    baseline = "trivial baseline" if method.is_identity else "timestamp-only baseline" if method.is_clock else ""
    label = f"{label} ({baseline})" if baseline else label
    metres = _steps(errors.translation_error_m, LIMIT_M)
    degrees = _steps(errors.rotation_error_deg, LIMIT_DEG)
    look = _look(dataset, method)
    return Curve(label, metres[0], degrees[0], metres[1], degrees[1], *look, 1.6 if baseline else 1.8)


def _steps(error: Array, limit: float) -> tuple[Array, Array]:
    """The corners of a curve from 0 to the limit: errors, and shares of all pairs in percent."""
    curve = cumulative_curve(error)
    inside = curve.error <= limit
    x = np.concatenate([[0.0], curve.error[inside], [limit]])
    return x, 100 * np.concatenate([[0.0], curve.share[inside], [curve.at(limit)]])


def _shown(name: str, times: int = 1) -> str:
    """A name shortened to fit a picture."""
    plain = "".join(c if c.isprintable() else "\ufffd" for c in name)
    return plain if len(plain) <= times * LONGEST_LABEL else f"{plain[: times * LONGEST_LABEL - 1]}…"


def _look(dataset: DatasetBoard, method: Method) -> tuple[str, Style]:
    """The colour and line style of a method, the same in all pictures of a dataset."""
    if method.is_baseline:
        return BASELINE_COLOUR, (0, (4, 2)) if method.is_identity else (0, (1, 1.5))
    methods = [m.label for m in dataset.entry.methods if not m.is_baseline]
    place = methods.index(method.label)
    return COLOURS[place % len(COLOURS)], STYLES[place // len(COLOURS) % len(STYLES)]


def _matching(picture: MatchingPicture) -> Figure:
    figure = Figure(figsize=(6.5, 3.6), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    handles = []
    for _, y, colour, style in picture.lines:
        handles += axes.plot(OFFSETS_PX, y, color=colour, linestyle=style, linewidth=1.8, marker="o")
    axes.set_xscale("log", base=2)
    axes.set_xticks(OFFSETS_PX, [str(offset) for offset in OFFSETS_PX])
    axes.set_xlabel("start off the true pixel by (px)")
    axes.set_ylabel("found to 3 px")
    axes.set_ylim(0, 101.5)
    axes.yaxis.set_major_formatter("{x:.0f} %")
    axes.grid(True, color="#dddddd", linewidth=0.6)
    axes.set_title(picture.title, fontsize=11)
    axes.legend(handles, [label for label, *_ in picture.lines], frameon=False, handlelength=3.2)
    return figure


def _risks(picture: RiskPicture) -> Figure:
    figure = Figure(figsize=(7.5, 4.2), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    handles = []
    for order, (_, coverage, risk, colour, style) in enumerate(picture.lines):
        # A single answer is a point; the best method is drawn last, so that it stays visible where curves meet.
        handles += axes.plot(
            coverage,
            risk,
            color=colour,
            linestyle=style,
            linewidth=1.8,
            marker="o" if len(coverage) == 1 else None,
            markersize=4,
            zorder=3 + len(picture.lines) - order,
        )
    axes.set_xlabel(f"answers with the highest confidence, share of all {picture.pairs} pairs")
    axes.set_ylabel(f"wrong by more than {CORRECT[0]:g} m or {CORRECT[1]:g}°")
    axes.set_xlim(0, 101.5)
    axes.set_ylim(-1.5, 101.5)
    axes.xaxis.set_major_formatter("{x:.0f} %")
    axes.yaxis.set_major_formatter("{x:.0f} %")
    axes.grid(True, color="#dddddd", linewidth=0.6)
    axes.set_title(picture.title, fontsize=11, loc="left")
    labels = [label for label, *_ in picture.lines]
    figure.legend(handles, labels, loc="outside right upper", frameon=False, handlelength=3.2)
    return figure


def _panel(axes: Axes, curves: Sequence[tuple[Curve, Array, Array]], limit: float, sigma: float | None) -> list[Line2D]:
    lines: list[Line2D] = []
    for order, (curve, x, y) in enumerate(curves):
        # The best is drawn last, so that it stays visible where curves meet.
        lines += axes.step(
            x,
            y,
            where="post",
            color=curve.colour,
            linestyle=curve.style,
            linewidth=curve.width,
            zorder=3 + len(curves) - order,
        )
    if sigma:
        finest = min(SIGMA_FACTOR * sigma, limit)
        axes.axvspan(0, finest, color="#000000", alpha=0.07, linewidth=0)
        axes.text(0, 103, "shaded: finer than 2σ of the ground truth", fontsize=7, va="bottom", color="#555555")
    axes.set_xlim(0, limit)
    axes.set_ylim(0, 101.5)  # a curve at 100 % is visible in its full width
    axes.yaxis.set_major_formatter("{x:.0f} %")
    axes.grid(True, color="#dddddd", linewidth=0.6)
    axes.tick_params(labelleft=True)
    return lines
