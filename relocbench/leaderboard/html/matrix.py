"""The matrix of methods and conditions as the start page and the pages of sets show it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

from relocbench.leaderboard.common.text import number
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.colours import share_style
from relocbench.leaderboard.html.pair_page.write import middle_picture
from relocbench.leaderboard.html.payloads import id_of, marks_of
from relocbench.leaderboard.tracking.by_condition import ByCondition, Column, ConditionRecall, Line, by_condition
from relocbench.leaderboard.tracking.model import DatasetBoard, short_title


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
        "total": ranked and results.has_total,
        "across": results.across_pairs,
    }


def matrix_columns(dataset: DatasetBoard) -> list[dict[str, Any]]:
    """The columns as the script of a set's page takes them: a link to a cell names one by its place among them."""
    results = by_condition([dataset])
    return [
        {
            "title": _words(results, column),
            "pair_sets": list(column.pair_sets),
            "metres": column.metres,
            "degrees": column.degrees,
        }
        for column in results.columns
    ]


def _words(results: ByCondition, column: Column) -> str:
    return ", ".join([column.title, *results.details(column)])


def _set(dataset: DatasetBoard, datasets: Sequence[DatasetBoard], span: int) -> dict[str, Any]:
    return {"title": short_title(dataset, datasets), "page": links.set_page(id_of(dataset)), "span": span}


def _column(results: ByCondition, column: Column, pictures: bool) -> dict[str, Any]:
    return {
        "title": column.title,
        "details": [*results.details(column), f"{column.pairs} pairs"],
        "doubt": column.doubt,
        "image": middle_picture(column.dataset, column.pair_sets[0]) if pictures else None,
    }


def _line(results: ByCondition, line: Line) -> dict[str, Any]:
    return {
        "method": line.label,
        "page": links.method_page(line.label),
        "baseline": line.baseline,
        "marks": list(dict.fromkeys(mark for method in line.methods for mark in marks_of(method))),
        "rank": line.rank,
        "share": number(line.share, "share"),
        "style": "" if line.share is None else share_style(line.share),
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


def _cell(results: ByCondition, column: Column, place: int, label: str, found: ConditionRecall) -> dict[str, str]:
    if found.share is None:
        return {"text": "", "style": "", "link": "", "words": ""}
    state = {"method": label, "column": str(place)}
    return {
        "text": number(found.share, "share"),
        "style": share_style(found.share),
        "link": f"{links.set_page(id_of(column.dataset))}#{links.hash_of(state)}",
        "words": f"{int(found.right.sum())} of {len(found.right)} pairs found by {label}: {_words(results, column)}",
    }
