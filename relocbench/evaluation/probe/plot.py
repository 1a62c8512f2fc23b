"""Plots of the share of successes against the offset of the start."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from relocbench.evaluation.probe.table import ACROSS, SAME, Line
from relocbench.evaluation.probe.tally import What
from relocbench.pages.figures import png_of

# Okabe and Ito, "Color Universal Design" (2008), without the yellow, which is faint on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
FLOOR_COLOUR = "#767676"
_LABELS: dict[What, str] = {
    "pixels": "start off the true pixel by (px)",
    "translation": "camera moved by (m)",
    "rotation": "camera turned by (°)",
}
_FOUND: dict[What, str] = {"pixels": "ends within 1 px", "translation": "0.25 m and 2°", "rotation": "0.25 m and 2°"}


def curves_picture(lines: Sequence[Line], title: str) -> bytes:
    """A PNG with rows for pairs across conditions and within one condition, and a column for each kind of start."""
    main = [line for line in lines if line.level is None and line.radius is not None]
    methods = list(dict.fromkeys(line.method for line in main))
    rows = [c for c in (ACROSS, SAME) if any(line.conditions == c for line in main)]
    columns = [w for w in _LABELS if any(line.what == w for line in main)]
    panels = []
    for conditions in rows:
        for what in columns:
            here = [line for line in main if line.what == what and line.conditions == conditions]
            looks = [(line, line.method, COLOURS[methods.index(line.method) % len(COLOURS)]) for line in here]
            panels.append((f"{conditions}: {_FOUND[what]}", what, looks))
    return _picture(panels, len(rows), len(columns), title)


def levels_picture(lines: Sequence[Line], title: str) -> bytes:
    """A PNG with a panel for each method and kind of pairs, and a curve for each pyramid level used alone."""
    alone = [line for line in lines if line.level is not None and line.radius is not None]
    methods = list(dict.fromkeys(line.method for line in alone))
    rows = [c for c in (ACROSS, SAME) if any(line.conditions == c for line in alone)]
    panels: list[tuple[str, What, list[tuple[Line, str, str]]]] = []
    for conditions in rows:
        for method in methods:
            here = [line for line in alone if line.method == method and line.conditions == conditions]
            looks = [(line, f"level {line.level}", COLOURS[(line.level or 0) % len(COLOURS)]) for line in here]
            panels.append((f"{method}, {conditions}: ends within 1 px of the level", "pixels", looks))
    return _picture(panels, len(rows), len(methods), title, floor=False)


def _picture(
    panels: Sequence[tuple[str, What, list[tuple[Line, str, str]]]],
    rows: int,
    columns: int,
    title: str,
    *,
    floor: bool = True,
) -> bytes:
    def draw(figure: Figure) -> None:
        grid = figure.subplots(rows, columns, squeeze=False)
        for axes, (name, what, looks) in zip(grid.flat, panels, strict=True):
            _panel(axes, what, looks, floor=floor)
            axes.set_title(name, fontsize=9)
        figure.suptitle(title, fontsize=11)

    size = 4.6 * columns, 0.4 + 3.2 * rows
    return png_of(size, draw, dpi=130, font_size=9, spines=False)


def _panel(axes: Axes, what: What, looks: Sequence[tuple[Line, str, str]], *, floor: bool) -> None:
    axes.axhline(50, color="#bbbbbb", linewidth=0.8)
    if floor and looks:
        line = looks[0][0]
        axes.plot(
            range(len(line.offsets)),
            100 * line.start_shares,
            color=FLOOR_COLOUR,
            linestyle=(0, (4, 2)),
            label="the starts",
        )
    for line, label, colour in looks:
        axes.plot(
            range(len(line.offsets)),
            100 * line.shares,
            color=colour,
            linewidth=1.8,
            marker="o",
            markersize=4,
            label=label,
        )
    if looks:
        offsets = looks[0][0].offsets
        axes.set_xticks(range(len(offsets)), [f"{offset:g}" for offset in offsets])
        axes.legend(frameon=False)
    axes.set_xlabel(_LABELS[what])
    axes.set_ylim(0, 101.5)
    axes.yaxis.set_major_formatter("{x:.0f} %")
    axes.grid(True, color="#dddddd", linewidth=0.6)
