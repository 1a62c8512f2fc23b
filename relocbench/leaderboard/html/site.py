"""Writing the site: the start page, a page for each set and each method, and the payloads that they load."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from relocbench.errors import ConfigError
from relocbench.evaluation.common.results import RunRecord
from relocbench.evaluation.tables.schema import STATUSES
from relocbench.files import json_text, remove_parts, write_bytes, write_text
from relocbench.leaderboard.boards import Boards
from relocbench.leaderboard.common.model import SHARED
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.data import write_data
from relocbench.leaderboard.html.looks import looks
from relocbench.leaderboard.html.manifest import earlier_files, write_manifest
from relocbench.leaderboard.html.matrix import matrix_columns, matrix_of
from relocbench.leaderboard.html.pages import write_page
from relocbench.leaderboard.html.pair_page.write import USUAL_PAIRS, write_pair_pages
from relocbench.leaderboard.html.payloads import errors_payload, marks_of, set_payload
from relocbench.leaderboard.html.query_pages import write_query_pages
from relocbench.leaderboard.html.rows import pages_by_query, query_rows, sections, tracker_row
from relocbench.leaderboard.html.set_page.write import write_charts
from relocbench.leaderboard.retrieval import page as retrieval_page
from relocbench.leaderboard.retrieval.board import RetrievalBoard
from relocbench.leaderboard.tracking.marks import MARKS, about_ranks
from relocbench.leaderboard.tracking.method import Method, evaluate_command, machine_words
from relocbench.leaderboard.tracking.model import Board, DatasetBoard
from relocbench.leaderboard.tracking.reservations import reservations
from relocbench.metrics import CORRECT, LEVEL
from relocbench.progress import Reporter, Silent

_OWN = (
    *("site.css", "core.js", "tables.js", "charts.js", "legend.js", "heat.js", "start.js"),
    *("rows.js", "parts.js", "errors.js", "recall.js", "stages.js", "map.js", "against.js", "measured.js", "board.js"),
    *("walk.js", "warp.js", "matches.js", "pair.js", "pair.css", "query.js", "places.css"),
)
_EXPORT = re.compile(r"export\{[^{}]*?(\w+) as default[^{}]*\};?")
_NOTICES = """\
The pages of this site use these programs, which are in the folder assets:

plotly.min.js     Plotly.js, copyright Plotly, Inc., MIT licence
datatables.js     DataTables and its extensions, copyright SpryMedia Ltd, MIT licence; jQuery, copyright OpenJS
                  Foundation and other contributors, MIT licence; further licences stand at the beginning of the file
datatables.css    DataTables, copyright SpryMedia Ltd, MIT licence

The bundle of DataTables is that of the package itables, MIT licence, with its export replaced by a name of the window:
pages that are opened from a disk cannot load modules. All other scripts and styles are those of relocbench, licence
Apache-2.0.
"""


def asset_files(site: Path) -> set[Path]:
    """The files of :func:`write_assets`."""
    shipped = ("plotly.min.js", "datatables.js", "datatables.css")
    return {site / "notices.txt", *(site / "assets" / name for name in (*_OWN, *shipped))}


def write_assets(site: Path) -> None:
    """Write ``assets/`` and ``notices.txt`` below the folder of the site.

    Raises:
        ConfigError: the installed package itables has no bundle of DataTables that can be used.
    """
    own = files("relocbench.leaderboard.html") / "assets"
    for name in _OWN:
        write_bytes(site / "assets" / name, (own / name).read_bytes())
    write_bytes(site / "assets" / "plotly.min.js", (files("plotly") / "package_data" / "plotly.min.js").read_bytes())
    bundle = files("itables") / "html"
    write_text(site / "assets" / "datatables.js", _as_script((bundle / "dt_bundle.js").read_text(encoding="utf-8")))
    write_bytes(site / "assets" / "datatables.css", (bundle / "dt_bundle.css").read_bytes())
    write_text(site / "notices.txt", _NOTICES)


def _as_script(module: str) -> str:
    """A module with a default export as a script that puts it into ``window.DataTable``."""
    changed, count = _EXPORT.subn(lambda found: f"window.DataTable={found[1]};", module)
    if count != 1:
        raise ConfigError("the installed itables ships no DataTables that can be used; expected itables 2.4 to 2.9")
    return f"(()=>{{'use strict';\n{changed}\n}})();\n"


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
    board, report = boards.tracking, reporter or Silent()
    earlier = earlier_files(site)
    remove_parts(site)
    fixed = {*asset_files(site), *(site / name for name in (links.PAIR_PAGE, links.START, READING))}
    write_manifest(site, earlier | fixed)  # a run that is killed leaves a site
    write_assets(site)
    written = {write_data(site, "site", _site_payload(boards)), *fixed}
    datasets = board.datasets if board else ()
    with report.stage("site", len(datasets)) as advance:
        for dataset in datasets:
            assert board is not None
            written |= _write_set(board, dataset, site, pictures=pairs > 0)
            advance(1)
    written |= _write_methods(boards, site)
    if board is not None:
        written |= write_pair_pages(board, site, pairs=pairs, reporter=report)
    for pages, by_query in pages_by_query(boards):
        written |= write_query_pages(pages, by_query, site, queries=pairs, reporter=report)
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
        why = about_ranks(board, datasets[0].totals[0]) or SHARED
    return {
        "shown": matrix_of(datasets, pictures=pictures),
        "correct": CORRECT,
        "ranks": f"{why}." if why else "",
        "reservations": [words for dataset in datasets for words in reservations(dataset)],
    }


def _write_set(board: Board, dataset: DatasetBoard, site: Path, *, pictures: bool) -> set[Path]:
    record = dataset.entry.record
    key = f"sets/{links.set_id(record)}"
    payload = {**set_payload(board, dataset), "matrix": matrix_columns(dataset)}
    written = {write_data(site, key, payload)}
    for name in dataset.entry.pair_sets:
        errors = errors_payload(dataset, name)
        if errors is not None:
            written.add(write_data(site, links.unit_key("errors", record, name), errors))
    written |= write_charts(board, dataset, site)
    page = site / links.set_page(record)
    opening = _opening(board, [dataset], pictures=pictures)
    write_page(
        page,
        "set.html.j2",
        page="set",
        title=dataset.entry.title,
        entry=dataset.entry,
        key=key,
        charts=_CHARTS,
        pairs=sum(of.pairs for of in dataset.entry.pair_sets.values()),
        **opening,
    )
    return written | {page}


def _site_payload(boards: Boards) -> dict[str, Any]:
    """What every page knows: the look of each method, and which pages there are.

    Each task draws from the same colours, so that those of trackers do not depend on what else was evaluated; a
    retriever that is called as a tracker looks as that one does.
    """
    found: dict[str, dict[str, str]] = {}
    for pages, by_query in reversed(pages_by_query(boards)):
        methods = [method for of in by_query.sets for method in of.methods]
        found |= looks({m.label for m in methods}, {m.label for m in methods if pages.is_baseline(m)})
    trackers = boards.tracking.methods if boards.tracking else []
    found |= looks({m.label for m in trackers}, {m.label for m in trackers if m.is_baseline})
    in_order = dict.fromkeys([*boards.retrievers, *(m.label for m in trackers)])
    return {
        "looks": found,
        "pages": {label: links.method_page(label) for label in in_order},
        "correct": list(CORRECT),
        "statuses": list(STATUSES),
    }


def _write_methods(boards: Boards, site: Path) -> set[Path]:
    by_label: dict[str, list[tuple[DatasetBoard, Method]]] = {label: [] for label in boards.retrievers}
    board = boards.tracking
    for dataset in board.datasets if board else ():
        for method in dataset.entry.methods:
            by_label.setdefault(method.label, []).append((dataset, method))
    written = set()
    for label, own in by_label.items():
        page = site / links.method_page(label)
        write_page(
            page,
            "method.html.j2",
            page="method",
            label=label,
            metric=board.metric.name if board else "",
            marks=list(dict.fromkeys(mark for _, method in own for mark in marks_of(method))),
            numbers=[n for dataset, method in own if board for n in _numbers(board, dataset, method)],
            others=_other_numbers(label, boards),
            runs=[*(_run(dataset, method) for dataset, method in own), *_retrieval_runs(label, boards.retrieval)],
        )
        written.add(page)
    return written


def _numbers(board: Board, dataset: DatasetBoard, method: Method) -> list[dict[str, Any]]:
    """The rows of a method on the totals and pair sets of a dataset."""
    tables = [*dataset.totals, *dataset.pair_sets]
    return [tracker_row(board, dataset, t, row) for t in tables for row in t.rows if row.method is method]


def _other_numbers(label: str, boards: Boards) -> dict[str, dict[str, Any]]:
    """The rows of a method as a retriever and in pipelines, by the page of these tasks."""
    out: dict[str, dict[str, Any]] = {}
    for pages, board in pages_by_query(boards):
        lines = [line for of in board.sets for table in of.tables for line in pages.display.lines(of, table)]
        own = [line for line in lines if line.row is not None and pages.involves(line.row.method, label)]
        marks = dict.fromkeys(mark for line in own for mark in pages.marks(line.row, line.table))
        if own:
            out[pages.page] = {"rows": query_rows(pages, board, own), "metric": board.metric, "marks": list(marks)}
    return out


def _run(dataset: DatasetBoard, method: Method) -> dict[str, Any]:
    run = method.run
    return {
        "title": dataset.entry.title,
        "page": links.set_page(dataset.entry.record),
        "facts": [*_run_facts(run, method.machine), ("files", json_text(run.files))],
        "missing": [f"{name}: {why}" for name, why in method.missing.items() if name in dataset.entry.used],
        "command": evaluate_command(run, matching=bool(method.matching)),
    }


def _retrieval_runs(label: str, board: RetrievalBoard | None) -> list[dict[str, Any]]:
    own = [(of, method) for of in (board.sets if board else ()) for method in of.methods if method.label == label]
    return [
        {
            "title": of.title,
            "page": links.set_page(of.record, "retrieval"),
            "facts": [
                *_run_facts(method.run, machine_words(method.run)),
                *([("files", json_text(method.run.files))] if method.run.files else []),
                *([("what it tells of itself", json_text(method.run.info))] if method.run.info else []),
            ],
            "missing": sorted(set(of.used) - method.answers.keys()),
            "command": retrieval_page.evaluate_command(of.record, method.run),
        }
        for of, method in own
    ]


def _run_facts(run: RunRecord, machine: str) -> list[tuple[str, str]]:
    return [
        ("target", run.target),
        ("parameters", json_text(run.parameters)),
        ("versions", json_text(run.versions)),
        ("machine", machine or "not recorded"),
    ]


def _code_spans(words: str) -> Markup:
    """Markdown of our own, in which nothing but code is marked, as HTML."""
    return Markup(re.sub(r"`([^`]*)`", r"<code>\1</code>", str(escape(words))))
