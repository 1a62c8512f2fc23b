"""The matrix of methods and conditions as the start page and the pages of sets show it.

Its scale of colours, from bad, orange, over the middle to good, blue, is the one of all maps, heat maps and cells: the
same on white and on dark pages, told apart by all kinds of colour blindness; the scripts have it too, as
``relocbench.QUALITY``.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

from relocbench.leaderboard.common.text import number
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.pair_page.write import middle_picture
from relocbench.leaderboard.html.payloads import marks_of
from relocbench.leaderboard.tracking.by_condition import ByCondition, Column, ConditionRecall, Line, by_condition
from relocbench.leaderboard.tracking.model import DatasetBoard, short_title
from relocbench.metrics import CORRECT

BAD, MIDDLE, GOOD = (179, 86, 27), (244, 244, 244), (43, 95, 184)
"""red, green and blue, 0 to 255"""


def share_style(share: float) -> str:
    """The background and the colour of the text of a cell with that share, 0 to 1, as a style attribute.

    Of black and white one always has a contrast of 4.5:1 at least.
    """
    low, high, part = (BAD, MIDDLE, 2 * share) if share < 0.5 else (MIDDLE, GOOD, 2 * share - 1)
    red, green, blue = (round(a + (b - a) * part) for a, b in zip(low, high, strict=True))
    luminance = 0.2126 * _linear(red) + 0.7152 * _linear(green) + 0.0722 * _linear(blue)
    ink = "#000" if (luminance + 0.05) / 0.05 >= 1.05 / (luminance + 0.05) else "#fff"
    return f"background:#{red:02x}{green:02x}{blue:02x};color:{ink}"


def _linear(channel: int) -> float:
    value = channel / 255
    return value / 12.92 if value <= 0.04045 else float(((value + 0.055) / 1.055) ** 2.4)


def matrix_of(datasets: Sequence[DatasetBoard], *, pictures: bool) -> dict[str, Any] | None:
    """What the template ``matrix.html.j2`` shows; None where no pair has an answer.

    Args:
        pictures: whether pictures of pairs are written, so that the heads of columns can show some.
    """
    results = by_condition(datasets)
    if not results.columns:
        return None
    ranked = len(datasets) == 1
    return {
        "ranked": ranked,
        "sets": [
            _set(dataset, datasets, len(list(own))) for dataset, own in groupby(results.columns, lambda c: c.dataset)
        ],
        "columns": [_column(results, column, pictures) for column in results.columns],
        "lines": [_line(results, line) for line in results.lines],
        "total": results.total_title if ranked and results.has_total else "",
        "across": results.across_pairs,
    }


def matrix_columns(dataset: DatasetBoard) -> list[dict[str, Any]]:
    """The columns as the script of a set's page takes them: a link to a cell names one by its place among them.

    The last is that of the total.
    """
    results = by_condition([dataset])
    together = tuple(name for column in results.in_total for name in column.pair_sets)
    columns = [(_words(results, c), c.pair_sets, c.metres, c.degrees, c.tier) for c in results.columns]
    return [
        {"title": title, "pair_sets": list(pair_sets), "metres": metres, "degrees": degrees, "tier": tier}
        for title, pair_sets, metres, degrees, tier in [*columns, (results.total_title, together, *CORRECT, "")]
    ]


def _words(results: ByCondition, column: Column) -> str:
    return ", ".join([column.title, *results.details(column)])


def _set(dataset: DatasetBoard, datasets: Sequence[DatasetBoard], span: int) -> dict[str, Any]:
    return {"title": short_title(dataset, datasets), "page": links.set_page(dataset.entry.record), "span": span}


def _column(results: ByCondition, column: Column, pictures: bool) -> dict[str, Any]:
    return {
        "title": column.title,
        "details": [*results.details(column), f"{column.pairs} pairs"],
        "doubt": column.doubt,
        "image": middle_picture(column.dataset, column.pair_sets[0]) if pictures and not column.tier else None,
    }


def _line(results: ByCondition, line: Line) -> dict[str, Any]:
    return {
        "method": line.label,
        "page": links.method_page(line.label),
        "baseline": line.baseline,
        "marks": list(dict.fromkeys(mark for method in line.methods for mark in marks_of(method))),
        "rank": line.rank,
        "total": _total(results, line),
        "cells": [_cell(results, column, place, line.label, found) for column, place, found in _placed(results, line)],
    }


def _placed(results: ByCondition, line: Line) -> list[tuple[Column, int, ConditionRecall]]:
    """Each column with its place among those of its dataset, and what is in the cell."""
    out, places = [], dict[int, int]()
    for column, found in zip(results.columns, line.found, strict=True):
        place = places.get(id(column.dataset), 0)
        places[id(column.dataset)] = place + 1
        out.append((column, place, found))
    return out


def _total(results: ByCondition, line: Line) -> dict[str, str]:
    if line.share is None:
        return _NOTHING
    words = f"pairs of {line.label}: {results.total_title}"
    return _shown(line.share, results.columns[0].dataset, len(results.columns), line.label, words)


def _cell(results: ByCondition, column: Column, place: int, label: str, found: ConditionRecall) -> dict[str, str]:
    if found.share is None:
        return _NOTHING
    words = f"{int(found.right.sum())} of {len(found.right)} pairs found by {label}: {_words(results, column)}"
    return _shown(found.share, column.dataset, place, label, words)


_NOTHING = {"text": "", "style": "", "link": "", "words": ""}


def _shown(share: float, dataset: DatasetBoard, place: int, label: str, words: str) -> dict[str, str]:
    link = f"{links.set_page(dataset.entry.record)}#{links.hash_of({'method': label, 'column': str(place)})}"
    return {"text": number(share, "share"), "style": share_style(share), "link": link, "words": words}
