"""Writing the site: the start page, a page for each set and each method, and the payloads that they load."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from relocbench.files import remove_parts
from relocbench.leaderboard.boards import Boards
from relocbench.leaderboard.common.ranks import SHARED
from relocbench.leaderboard.common.text import json_text
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.assets import asset_files, write_assets
from relocbench.leaderboard.html.data import write_data
from relocbench.leaderboard.html.manifest import earlier_files, write_manifest
from relocbench.leaderboard.html.matrix import matrix_columns, matrix_of
from relocbench.leaderboard.html.other_tasks import results_of, retriever_labels, with_other_tasks
from relocbench.leaderboard.html.pages import write_page
from relocbench.leaderboard.html.pair_page.write import USUAL_PAIRS, write_pair_pages
from relocbench.leaderboard.html.payloads import (
    errors_payload,
    id_of,
    marks_of,
    set_payload,
    site_payload,
)
from relocbench.leaderboard.html.pipeline_pages.write import write_pipeline_pages
from relocbench.leaderboard.html.retrieval_pages.write import write_retrieval_pages
from relocbench.leaderboard.html.rows import line, sections
from relocbench.leaderboard.html.set_page.write import write_charts
from relocbench.leaderboard.tracking.cells import why_no_ranks
from relocbench.leaderboard.tracking.marks import MARKS
from relocbench.leaderboard.tracking.method import Method, evaluate_command
from relocbench.leaderboard.tracking.model import Board, DatasetBoard
from relocbench.leaderboard.tracking.reservations import reservations
from relocbench.metrics import CORRECT, LEVEL
from relocbench.progress import Reporter, Silent

READING = "reading.html"
_CHARTS = ("errors", "map", "against", "measured")
"""the scripts of a set's charts, in the order in which they draw"""


def write_site(boards: Boards, site: Path, *, pairs: int = USUAL_PAIRS, reporter: Reporter | None = None) -> Path:
    """Write the site; returns the path of its start page.

    Args:
        boards: of one results folder.
        site: its folder, which is empty or holds an earlier site. Pages and payloads of that one that are no longer
            needed are removed, and no other file.
        pairs: in each pair set, so many worst pairs of each method, and so many drawn at random, have pictures where
            the dataset is available; so have queries in each task of retrievers and of pipelines.
        reporter: receives the number of sets and of pictures that are done.

    Raises:
        PredictionError: a file of predictions is bad.
        DatasetError: a file of an available dataset cannot be read.
        ConfigError: the folder holds files and no site, or an installed package does not ship the scripts that the
            pages need.
    """
    board = boards.tracking
    earlier = earlier_files(site)
    remove_parts(site)
    fixed = {*asset_files(site), *(site / name for name in (links.PAIR_PAGE, links.START, READING))}
    write_manifest(site, earlier | fixed)  # a run that is killed leaves a site
    write_assets(site)
    written = {write_data(site, "site", with_other_tasks(site_payload(board), boards)), *fixed}
    datasets = board.datasets if board else ()
    with (reporter or Silent()).stage("site", len(datasets)) as advance:
        for dataset in datasets:
            assert board is not None
            written |= _write_set(board, dataset, site, pictures=pairs > 0)
            advance(1)
    written |= _write_methods(boards, site)
    if board is not None:
        written |= write_pair_pages(board, site, pairs=pairs, reporter=reporter)
    if boards.retrieval is not None:
        written |= write_retrieval_pages(boards.retrieval, site, queries=pairs, reporter=reporter or Silent())
    if boards.relocalization is not None:
        told = reporter or Silent()
        written |= write_pipeline_pages(boards.relocalization, board, site, queries=pairs, reporter=told)
    write_page(site / links.PAIR_PAGE, "pair.html.j2", page="pair")
    marks = [(mark.name, _code_spans(mark.words)) for mark in MARKS]
    write_page(site / READING, "reading.html.j2", page="reading", metric=board.metric if board else None, marks=marks)
    opening = _opening(board, datasets, pictures=pairs > 0)
    write_page(
        site / links.START, "start.html.j2", page="start", level=f"{LEVEL:.0%}", sections=sections(boards), **opening
    )
    write_manifest(site, earlier | written)
    for path in earlier - written:
        path.unlink(missing_ok=True)
    write_manifest(site, written)
    return site / links.START


def _opening(board: Board | None, datasets: Sequence[DatasetBoard], *, pictures: bool) -> dict[str, Any]:
    """What the start page and the page of a set open with: the matrix, and what a reader must know before it."""
    why = ""
    if board is not None and len(datasets) == 1 and datasets[0].totals:
        why = why_no_ranks(board, datasets[0].totals[0]) or SHARED
    return {
        "shown": matrix_of(datasets, pictures=pictures),
        "correct": CORRECT,
        "ranks": f"{why}." if why else "",
        "reservations": [words for dataset in datasets for words in reservations(dataset)],
    }


def _write_set(board: Board, dataset: DatasetBoard, site: Path, *, pictures: bool) -> set[Path]:
    of_set = id_of(dataset)
    key = f"sets/{of_set}"
    payload = {**set_payload(board, dataset), "matrix": matrix_columns(dataset)}
    written = {write_data(site, key, payload)}
    for name in dataset.entry.pair_sets:
        errors = errors_payload(dataset, name)
        if errors is not None:
            written.add(write_data(site, f"errors/{of_set}/{links.pair_set_id(name)}", errors))
    written |= write_charts(board, dataset, site)
    page = site / links.set_page(of_set)
    opening = _opening(board, [dataset], pictures=pictures)
    write_page(
        page,
        "set.html.j2",
        page="set",
        title=dataset.entry.title,
        entry=dataset.entry,
        key=key,
        charts=_CHARTS,
        pairs=_pairs(dataset),
        **opening,
    )
    return written | {page}


def _pairs(dataset: DatasetBoard) -> int:
    return sum(record.pairs for record in dataset.entry.pair_sets.values())


def _write_methods(boards: Boards, site: Path) -> set[Path]:
    by_label: dict[str, list[tuple[DatasetBoard, Method]]] = {label: [] for label in retriever_labels(boards)}
    board = boards.tracking
    for dataset in board.datasets if board else ():
        for method in dataset.entry.methods:
            by_label.setdefault(method.label, []).append((dataset, method))
    written = set()
    for label, own in by_label.items():
        page = site / links.method_page(label)
        numbers = [n for dataset, method in own if board for n in _numbers(board, dataset, method)]
        runs = [_run(dataset, method) for dataset, method in own]
        marks = list(dict.fromkeys(mark for _, method in own for mark in marks_of(method)))
        shown = {"label": label, "marks": marks, "numbers": numbers, "runs": runs, **results_of(label, boards)}
        shown["metric"] = board.metric.name if board else ""
        write_page(page, "method.html.j2", page="method", **shown)
        written.add(page)
    return written


def _numbers(board: Board, dataset: DatasetBoard, method: Method) -> list[dict[str, Any]]:
    """The rows of a method on the totals and pair sets of a dataset."""
    rows = []
    for table in [*dataset.totals, *dataset.pair_sets]:
        row = next((row for row in table.rows if row.method is method), None)
        if row is not None:
            rows.append(line(board, dataset, table, row))
    return rows


def _run(dataset: DatasetBoard, method: Method) -> dict[str, Any]:
    run = method.run
    return {
        "title": dataset.entry.title,
        "page": links.set_page(id_of(dataset)),
        "facts": [
            ("target", run.target),
            ("parameters", json_text(run.parameters)),
            ("versions", json_text(run.versions)),
            ("machine", method.machine or "not recorded"),
            ("files", json_text(run.files)),
        ],
        "missing": [(name, why) for name, why in method.missing.items() if name in dataset.entry.used],
        "command": evaluate_command(run, matching=bool(method.matching)),
    }


def _code_spans(words: str) -> Markup:
    """Markdown of our own, in which nothing but code is marked, as HTML."""
    return Markup(re.sub(r"`([^`]*)`", r"<code>\1</code>", str(escape(words))))
