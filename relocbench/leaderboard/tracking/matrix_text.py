"""The matrix of methods and conditions in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import quote

from relocbench.leaderboard.common.text import METHOD, RANK, number
from relocbench.leaderboard.tracking.by_condition import ByCondition, Column, ConditionRecall, Line, by_condition
from relocbench.leaderboard.tracking.marks import DAGGER, signs
from relocbench.leaderboard.tracking.model import DatasetBoard, short_title
from relocbench.pages.markdown import escaped, table_text


def matrix_text(datasets: Sequence[DatasetBoard], pages: Sequence[str] = ()) -> str:
    """Methods as rows and conditions as columns, or the other way round where these are more; empty without results.

    Args:
        pages: link of each dataset, for a matrix that has several or stands apart from their pages.
    """
    results = by_condition(datasets)
    if not results.columns:
        return ""
    named = [escaped(short_title(dataset, datasets)) for dataset in datasets]
    linked = [f"[{name}]({quote(page)})" for name, page in zip(named, pages, strict=True)] if pages else []
    links = dict(zip(map(id, datasets), linked, strict=False))
    heads = [_head(results, column, links.get(id(column.dataset), "")) for column in results.columns]
    names = [_name(line) for line in results.lines]
    cells = [[_cell(c, f) for c, f in zip(results.columns, line.found, strict=True)] for line in results.lines]
    if len(datasets) == 1:
        return _one(results, heads, names, cells)
    if len(heads) <= len(names):
        return table_text([METHOD, *heads], [[a, *row] for a, row in zip(names, cells, strict=True)], left=1)
    across = zip(heads, zip(*cells, strict=True), strict=True)
    return table_text(["dataset", *names], [[head, *row] for head, row in across], left=1)


def _one(results: ByCondition, heads: list[str], names: list[str], cells: list[list[str]]) -> str:
    """The matrix of one dataset, with the ranks and the mean across its conditions."""
    total = [f"{results.total_title}, %"] if results.has_total else []
    columns = [METHOD, RANK, *total, *heads]
    rows = [
        [name, line.rank, *([number(line.share, "share")] if total else []), *row]
        for name, line, row in zip(names, results.lines, cells, strict=True)
    ]
    return table_text(columns, rows, left=1)


def _name(line: Line) -> str:
    label = f"*{escaped(line.label)}*" if line.baseline else escaped(line.label)
    assumed = dict.fromkeys(method.run.assumes for method in line.methods if method.run.assumes)
    return " ".join([label, *(f"({escaped(words)})" for words in assumed), *signs(*line.methods)])


def _head(results: ByCondition, column: Column, link: str) -> str:
    parts = [*([link] if link else []), escaped(column.title), *map(escaped, results.details(column))]
    return "<br>".join([*parts, f"{column.pairs} pairs", *(["**truth in doubt**"] if column.doubt else [])])


def _cell(column: Column, found: ConditionRecall) -> str:
    text = number(found.share, "share")
    return f"<sub>{text}</sub>{DAGGER}" if text and column.is_finer_than_truth else text
