"""Writing the site: the start page, a page for each set and each method, and the payloads that they load."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from relocbench import version
from relocbench.evaluation.common.matching_table import ALL
from relocbench.files import remove_parts, write_text
from relocbench.leaderboard.common.text import json_text, number
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.assets import write_assets
from relocbench.leaderboard.html.data import write_data
from relocbench.leaderboard.html.pair_page.write import USUAL_PAIRS, write_pair_pages
from relocbench.leaderboard.html.payloads import errors_payload, id_of, is_floor, set_payload, site_payload, table_title
from relocbench.leaderboard.relocalization.board import ChainBoard
from relocbench.leaderboard.retrieval.board import RetrievalBoard
from relocbench.leaderboard.tracking.load import Method, evaluate_command
from relocbench.leaderboard.tracking.model import Board, DatasetBoard, Row, Table
from relocbench.metrics import LEVEL, Interval
from relocbench.pages import render
from relocbench.progress import Reporter, Silent


@dataclass(frozen=True)
class Boards:
    """What results hold, one board a task; None where there is nothing of it."""

    tracking: Board | None = None
    retrieval: RetrievalBoard | None = None
    relocalization: ChainBoard | None = None


def write_site(boards: Boards, site: Path, *, pairs: int = USUAL_PAIRS, reporter: Reporter | None = None) -> Path:
    """Write the site; returns the path of its start page.

    Args:
        boards: of one results folder.
        site: its folder. Pages and payloads of sets and methods that are no longer there are removed.
        pairs: in each pair set, so many worst pairs of each method, and so many drawn at random, have pictures where
            the dataset is at hand.
        reporter: receives the number of sets and of pictures that are done.

    Raises:
        PredictionError: a file of predictions is bad.
        DatasetError: an image of a dataset cannot be read.
        ConfigError: an installed package does not ship the scripts that the pages need.
    """
    board = boards.tracking
    remove_parts(site)
    write_assets(site)
    written = {write_data(site, "site", site_payload(board))}
    datasets = board.datasets if board else ()
    with (reporter or Silent()).stage("site", len(datasets)) as advance:
        for dataset in datasets:
            assert board is not None
            written |= _write_set(board, dataset, site)
            advance(1)
    if board is not None:
        written |= _write_methods(board, site)
        written |= write_pair_pages(board, site, pairs=pairs, reporter=reporter)
    _page(site / links.PAIR_PAGE, "pair.html.j2", page="pair")
    _page(site / links.START, "start.html.j2", page="start", level=f"{LEVEL:.0%}", sections=_sections(boards))
    _page(site / "reading.html", "reading.html.j2", page="reading", metric=board.metric if board else None)
    _remove_old(site, written)
    return site / links.START


def _write_set(board: Board, dataset: DatasetBoard, site: Path) -> set[Path]:
    of_set = id_of(dataset)
    written = {write_data(site, f"sets/{of_set}", set_payload(board, dataset))}
    for name in dataset.entry.pair_sets:
        payload = errors_payload(dataset, name)
        if payload is not None:
            written.add(write_data(site, f"errors/{of_set}/{links.pair_set_id(name)}", payload))
    page = site / links.set_page(of_set)
    _page(page, "set.html.j2", page="set", entry=dataset.entry, of_set=of_set, pairs=_pairs(dataset))
    return written | {page}


def _pairs(dataset: DatasetBoard) -> int:
    return sum(record.pairs for record in dataset.entry.pair_sets.values())


def _write_methods(board: Board, site: Path) -> set[Path]:
    found: dict[str, list[tuple[DatasetBoard, Method]]] = {}
    for dataset in board.datasets:
        for method in dataset.entry.methods:
            found.setdefault(method.label, []).append((dataset, method))
    written = set()
    for label, own in found.items():
        page = site / links.method_page(label)
        numbers = [n for dataset, method in own for n in _numbers(board, dataset, method)]
        runs = [_run(dataset, method) for dataset, method in own]
        _page(page, "method.html.j2", page="method", label=label, numbers=numbers, runs=runs, metric=board.metric.name)
        written.add(page)
    return written


def _numbers(board: Board, dataset: DatasetBoard, method: Method) -> list[dict[str, Any]]:
    """The rows of a method on the totals and pair sets of a dataset."""
    found = []
    for table in [*dataset.totals, *dataset.pair_sets]:
        row = next((row for row in table.rows if row.method is method), None)
        if row is not None:
            found.append(_line(board, dataset, table, row))
    return found


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


def _sections(boards: Boards) -> list[dict[str, Any]]:
    """The tables of the start page: one for each task."""
    sections = []
    board = boards.tracking
    if board is not None:
        rows = [_line(board, d, table, row) for d in board.datasets for table in d.totals for row in table.rows]
        sections.append({"title": "Trackers", "metric": board.metric.name, "what": "pairs", "rows": rows})
    if boards.retrieval is not None:
        found, metric = [], boards.retrieval.metric
        for asked in boards.retrieval.sets:
            for table in asked.tables:
                for row in table.rows:
                    found.append(_other(asked.title, table, row.method.label, row, metric))
        sections.append({"title": "Retrievers", "metric": metric, "what": "queries", "rows": found})
    if boards.relocalization is not None:
        found, metric = [], boards.relocalization.metric
        for chains in boards.relocalization.sets:
            for chained in chains.tables:
                for link in chained.rows:
                    found.append(_other(chains.title, chained, link.chain.label, link, metric))
        sections.append({"title": "Retrieval, then tracking", "metric": metric, "what": "queries", "rows": found})
    return sections


def _line(board: Board, dataset: DatasetBoard, table: Table, row: Row) -> dict[str, Any]:
    metric, value = board.metric, row.values[board.metric.name]
    state = {"table": table_title(table), "method": row.method.label}
    return {
        "set": dataset.entry.title,
        "page": links.set_page(id_of(dataset)),
        "table": table_title(table),
        "count": table.pairs,
        "method": row.method.label,
        "method_page": links.method_page(row.method.label),
        "floor": is_floor(row.method),
        "marks": ["floor"] if is_floor(row.method) else (["uses times"] if row.method.run.uses_times else []),
        "rank": row.rank,
        "value": number(value, metric.unit),
        "sort": "" if value is None else repr(float(value)),
        "bounds": _bounds(row.intervals.get(metric.name), metric.unit),
        "finer": metric.name in table.finer,
        "missing": list(row.missing),
        "failed": row.failed,
        "broke": row.broke,
        "link": f"{links.set_page(id_of(dataset))}#{links.hash_of(state)}" if table.group == ALL else "",
    }


def _other(title: str, table: Any, label: str, row: Any, metric: str) -> dict[str, Any]:
    value = row.values.get(metric)
    return {
        "set": title,
        "page": "",
        "table": table.name,
        "count": table.queries,
        "method": label,
        "method_page": "",
        "floor": False,
        "marks": [],
        "rank": row.rank,
        "value": number(value, "share"),
        "sort": "" if value is None else repr(float(value)),
        "bounds": _bounds(row.intervals.get(metric), "share"),
        "finer": False,
        "missing": list(row.missing),
        "failed": row.failed,
        "broke": row.broke,
        "link": "",
    }


def _bounds(interval: Interval | None, unit: str) -> str:
    return "" if interval is None else f"[{number(interval.low, unit)}, {number(interval.high, unit)}]"


def _page(path: Path, template: str, **values: object) -> None:
    write_text(path, render(__name__, template, version=version.__version__, **values))


def _remove_old(site: Path, written: set[Path]) -> None:
    """Remove pages and payloads of sets and methods that have left the results."""
    payloads = ("sets/*", "errors/*/*", "pairs/*/*", "images/*/*/*", "depths/*/*/*")
    for pattern in ("set-*.html", "method-*.html", *(f"data/{each}.js" for each in payloads)):
        for path in set(site.glob(pattern)) - written:
            path.unlink()
