#!/usr/bin/env python3
"""Write a published board again from the archives of its predictions, where the layout of pages or a metric is new.

    tools/rewrite_board.py leaderboard

A board takes hours to evaluate; the archives beside it hold every error. Before anything is written, every number of
``leaderboard.csv`` is computed again from these and compared to twelve digits. Its values stay as they are, but that it
gets the columns of metrics that did not exist when it was written.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from relocbench.files import write_table
from relocbench.leaderboard.common.text import cell
from relocbench.leaderboard.tracking.doubt import TruthCheck
from relocbench.leaderboard.tracking.load import load_results
from relocbench.leaderboard.tracking.long_form import leaderboard_rows
from relocbench.leaderboard.tracking.model import Board, DatasetEntry
from relocbench.leaderboard.tracking.tables import make_board
from relocbench.leaderboard.tracking.write import write_pages, write_tables

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks" / "publish"))
import archives

Rows = list[dict[str, str]]
_KEY = ("dataset", "pair_set", "split", "group", "method")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("board", type=Path, help="folder of leaderboard.csv")
    folder: Path = parser.parse_args().board
    published = _read(folder / "leaderboard.csv")
    board = make_board(_entries(folder), metric=published[0]["ranked_by"])
    header, *rows = _compare(board, published)
    write_tables(board, folder)
    write_table(folder / "leaderboard.csv", header, rows)
    write_pages(board, folder)


def _entries(folder: Path) -> list[DatasetEntry]:
    """The datasets of a board; their errors were computed, and their truth was checked, when it was published."""
    with tempfile.TemporaryDirectory() as temporary:
        entries = load_results(archives.unpack(folder / "predictions", Path(temporary) / "results"))
    checks: dict[str, dict[str, TruthCheck]] = {}
    for row in _read(folder / "truth.csv"):
        checks.setdefault(row["fingerprint"], {})[row["pair_set"]] = _truth_check(row)
    return [
        replace(
            entry,
            methods=tuple(replace(method, rescored=True) for method in entry.methods),
            truth_checks=checks.get(entry.record.fingerprint, {}),
        )
        for entry in entries
    ]


def _read(path: Path) -> Rows:
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def _truth_check(row: dict[str, str]) -> TruthCheck:
    counts = (int(row[name]) for name in ("compared", "agree", "apart"))
    return TruthCheck(*counts, float(row["median_apart_px"] or math.nan), int(row["width_px"]))


def _compare(board: Board, published: Rows) -> list[list[str]]:
    """The header and the published rows with new columns; exits unless all published values follow from the errors."""
    made = {tuple(str(row[key]) for key in _KEY): row for row in leaderboard_rows(board)}
    wrong, rows = [], [list(next(iter(made.values())))]
    for row in published:
        key = tuple(row[name] for name in _KEY)
        again = made.pop(key, None)
        values = {} if again is None else {name: str(cell(value)) for name, value in again.items()}
        wrong += [
            (key, name, row[name], values.get(name)) for name in row if not _same(values.get(name, ""), row[name])
        ]
        rows.append(list((values | row).values()))
    if wrong or made:
        for key, name, was, now in wrong[:20]:
            print(f"{' '.join(key)}: {name} is {now}, published as {was}", file=sys.stderr)
        sys.exit(f"{len(wrong)} values and {len(made)} rows are not those that were published: nothing was written")
    return rows


def _same(made: str, published: str) -> bool:
    if made == published:
        return True
    try:
        return math.isclose(float(made), float(published), rel_tol=1e-12)
    except ValueError:
        return False


if __name__ == "__main__":
    main()
