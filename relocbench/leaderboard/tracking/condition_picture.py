"""The picture of what each method finds in each condition: a query of each condition above a mark for every pair."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from relocbench.arrays import Image
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.images import as_rgb
from relocbench.files import write_bytes
from relocbench.leaderboard.tracking.by_condition import ByCondition, Column, ConditionRecall
from relocbench.metrics import CORRECT
from relocbench.pages.figures import png_of

_FOUND, _MISSED, _TEXT, _FAINT, _BAND = "#0072B2", "#8A8A8A", "#1A1A1A", "#5F5F5F", "#F3F3F3"
"""a found pair is a full disc or a long stroke, a missed one an empty ring or a short stroke: colours are not needed"""
_WIDTH = 11.0
"""inches, as all lengths here; at the width of a README the smallest text is about 11 pixels high"""
_EDGE, _GAP = 0.08, 0.1
_HEADING, _UNDER_IMAGES, _LINE, _LEGEND = 0.52, 0.14, 0.38, 0.38
_SHARE = 0.68
"""for the number at the right of a cell"""
_RADIUS = 0.062
_MOST_DISCS, _MOST_MARKS = 12, 96
"""pairs of a cell that are marked by discs, and by strokes; of more the cell has the number alone"""
_STROKE, _LONG, _SHORT = 0.028, 0.24, 0.06
"""width of the widest stroke, and heights"""
_LONGEST = 24
"""characters of a name or a condition"""


@dataclass(frozen=True, eq=False)
class ConditionPicture:
    """The content of the picture."""

    results: ByCondition
    keyframe: Image
    """(H, W, 3) of the map"""
    queries: tuple[Image, ...]
    """(H, W, 3) for each column, all near the keyframe"""


def write_condition_picture(results: ByCondition, dataset: Dataset, path: Path) -> None:
    """Write the picture as PNG.

    Args:
        results: on ``dataset``.

    Raises:
        DatasetError: a damaged image.
        ValueError: the results are of several maps, or of none.
    """
    write_bytes(path, draw(condition_picture(results, dataset)))


def condition_picture(results: ByCondition, dataset: Dataset) -> ConditionPicture:
    """Choose a place that is asked about in all conditions: the middle keyframe, and the query nearest in time to it.

    Drives of the rendered town are in step, so that equal places in a drive are equal places in the street.
    """
    results = results.usual
    if len({column.map_condition for column in results.columns}) != 1:
        raise ValueError("expected results of one map")
    sets = [dataset.pair_set(column.pair_sets[0]) for column in results.columns]
    middle = sets[-1].pairs[len(sets[-1].pairs) // 2]
    queries = [as_rgb(dataset.query(one, one.pairs[len(one.pairs) // 2]).image) for one in sets]
    return ConditionPicture(results, as_rgb(dataset.reference(sets[-1], middle).image), tuple(queries))


def draw(picture: ConditionPicture) -> bytes:
    """The picture as PNG."""
    results = picture.results
    count = len(results.columns) + 1
    wide = (_WIDTH - 2 * _EDGE - (count - 1) * _GAP) / count
    high = wide * picture.keyframe.shape[0] / picture.keyframe.shape[1]
    below_images = _EDGE + _HEADING + high + _UNDER_IMAGES
    tall = below_images + _LINE * len(results.lines) + _LEGEND

    def fill(figure: Figure) -> None:
        _fill(figure.add_axes((0, 0, 1, 1)), picture, (wide, high, below_images, tall))

    return png_of((_WIDTH, tall), fill, dpi=160, layout=None, compress_level=1)


def _fill(axes: Axes, picture: ConditionPicture, sizes: tuple[float, float, float, float]) -> None:
    """Draw images, names and marks; ``sizes`` are of an image, of what is above the lines, and of all."""
    results, (wide, high, below_images, tall) = picture.results, sizes
    count = len(results.columns) + 1
    lefts = [_EDGE + i * (wide + _GAP) for i in range(count)]
    headings = [(results.columns[0].map_condition, "the map"), *((c.condition, _role(c)) for c in results.columns)]
    for left, image, (condition, role) in zip(lefts, (picture.keyframe, *picture.queries), headings, strict=True):
        top = _EDGE + _HEADING
        axes.imshow(image, extent=(left, left + wide, top + high, top), aspect="auto", interpolation="lanczos")
        axes.text(left, _EDGE + 0.12, _short(condition), va="center", size=10.3, weight="bold", color=_TEXT)
        axes.text(left, _EDGE + 0.34, role, va="center", size=10.3, color=_FAINT)
    for number, line in enumerate(results.lines):
        y = below_images + (number + 0.5) * _LINE
        if number % 2 == 0:
            axes.add_patch(Rectangle((0, y - _LINE / 2), _WIDTH, _LINE, facecolor=_BAND, linewidth=0))
        colour = _FAINT if line.baseline else _TEXT
        axes.text(lefts[0] + 0.05, y, _short(line.label), va="center_baseline", size=12, color=colour)
        for left, found in zip(lefts[1:], line.found, strict=True):
            _cell(axes, found, left, wide, y)
    discs = all(len(found.right) <= _MOST_DISCS for line in results.lines for found in line.found)
    _legend(axes, _mark if discs else _stroke, lefts, tall - _LEGEND / 2)
    axes.set_xlim(0, _WIDTH)
    axes.set_ylim(tall, 0)
    axes.set_axis_off()


def _cell(axes: Axes, found: ConditionRecall, left: float, wide: float, y: float) -> None:
    """The marks of a method's pairs of one column, and their share at the right."""
    text = "" if found.share is None else f"{100 * found.share:.0f} %"
    axes.text(left + wide - 0.05, y, text, va="center_baseline", ha="right", size=11.5, color=_TEXT)
    if len(found.right) <= _MOST_MARKS:
        step = min((wide - _SHARE) / max(len(found.right), 1), 2.7 * _RADIUS)
        draw = _mark if len(found.right) <= _MOST_DISCS else _stroke
        for number, right in enumerate(found.right):
            draw(axes, left + 0.03 + step / 2 + number * step, y, right=bool(right), step=step)


def _stroke(axes: Axes, x: float, y: float, *, right: bool, step: float = _STROKE) -> None:
    width, height = min(_STROKE, 0.72 * step), _LONG if right else _SHORT
    colour = _FOUND if right else _MISSED
    axes.add_patch(Rectangle((x - width / 2, y - height / 2), width, height, facecolor=colour, linewidth=0))


def _mark(axes: Axes, x: float, y: float, *, right: bool, step: float = 2.7 * _RADIUS) -> None:
    radius = min(_RADIUS, 0.42 * step)
    if right:
        axes.add_patch(Circle((x, y), radius, facecolor=_FOUND, edgecolor=_FOUND, linewidth=1.1))
    else:
        axes.add_patch(Circle((x, y), radius, facecolor="white", edgecolor=_MISSED, linewidth=1.1))


def _legend(axes: Axes, draw: Callable[..., None], lefts: Sequence[float], y: float) -> None:
    metres, degrees = CORRECT
    draw(axes, lefts[1] + 0.1, y, right=True)
    axes.text(
        lefts[1] + 0.27, y, f"within {metres:g} m and {degrees:g}°", va="center_baseline", size=10.3, color=_FAINT
    )
    draw(axes, lefts[2] + 0.1, y, right=False)
    axes.text(lefts[2] + 0.27, y, "not found", va="center_baseline", size=10.3, color=_FAINT)
    axes.text(_WIDTH - _EDGE - 0.05, y, "a mark is a query", va="center_baseline", ha="right", size=10.3, color=_FAINT)


def _role(column: Column) -> str:
    return "queries, of the same drive" if column.same_drive else "queries"


def _short(text: str) -> str:
    plain = "".join(c if c.isprintable() else "\ufffd" for c in text)
    return plain if len(plain) <= _LONGEST else f"{plain[: _LONGEST - 1]}…"
