#!/usr/bin/env python3
"""Write the Markdown of a published board again from its CSV files, where the layout of pages or a metric is new.

    tools/rewrite_board.py leaderboard

A board takes hours to evaluate; its tables hold every error and all that pages show. Before anything is
written, every number of ``leaderboard.csv`` is computed again from ``errors.csv`` and compared to twelve digits (the
order in which pair sets were added up is not published). What ran, and in which order methods came, is in the records
beside the published predictions. CSV files stay as they are, but that ``leaderboard.csv``
gets the columns of metrics that did not exist when it was written.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
import tarfile
from collections import defaultdict
from pathlib import Path, PurePath

from relocbench.evaluation.common.results import DatasetRecord, RunRecord
from relocbench.evaluation.tables.errors import NUMBERS, ErrorTable, PairErrors
from relocbench.evaluation.tables.matching import MatchingRow
from relocbench.evaluation.tables.schema import ALL
from relocbench.files import parse_yaml, write_table
from relocbench.leaderboard.common.text import cell
from relocbench.leaderboard.tracking.doubt import TruthCheck
from relocbench.leaderboard.tracking.long_form import leaderboard_rows
from relocbench.leaderboard.tracking.method import Method
from relocbench.leaderboard.tracking.model import TOTALS, Board, DatasetEntry
from relocbench.leaderboard.tracking.tables import make_board
from relocbench.leaderboard.tracking.write import write_pages

Rows = list[dict[str, str]]
_KEY = ("dataset", "pair_set", "split", "group", "method")
_COUNTS = ("answered", "match@1px", "match@3px", "start@1px", "start@3px")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("board", type=Path, help="folder of leaderboard.csv")
    folder: Path = parser.parse_args().board
    published = _read(folder / "leaderboard.csv")
    board = make_board(_entries(folder, published), metric=published[0]["ranked_by"])
    header, *rows = _compare(board, published)
    if list(published[0]) != header:
        write_table(folder / "leaderboard.csv", header, rows)
    write_pages(board, folder)


def _entries(folder: Path, published: Rows) -> list[DatasetEntry]:
    """The datasets of a board that rows of its ``leaderboard.csv`` are of."""
    errors, matching = _errors(folder / "errors.csv"), _matching(folder / "matching.csv")
    truth, (datasets, runs) = _read(folder / "truth.csv"), _records(folder / "predictions")
    by_dataset: dict[str, Rows] = defaultdict(list)
    for row in published:
        by_dataset[row["dataset"]].append(row)
    return [_entry(datasets[name], rows, errors, matching, truth, runs) for name, rows in by_dataset.items()]


def _read(path: Path) -> Rows:
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def _records(archives: Path) -> tuple[dict[str, DatasetRecord], dict[tuple[str, str], RunRecord]]:
    """The records of datasets, and those of runs by dataset and method."""
    datasets, runs = {}, {}
    for path in sorted(archives.glob("*/*.tar.xz")):
        with tarfile.open(path) as archive:
            texts = {
                PurePath(member.name).name: content.read().decode()
                for member in archive
                if member.name.endswith(("/dataset.yaml", "/run.yaml"))
                and (content := archive.extractfile(member)) is not None
            }
        name, label = path.parent.name, path.name.removesuffix(".tar.xz")
        datasets[name] = DatasetRecord.model_validate(parse_yaml(texts["dataset.yaml"]))
        runs[name, label] = RunRecord.model_validate(parse_yaml(texts["run.yaml"]))
    return datasets, runs


def _errors(path: Path) -> dict[tuple[str, str, str], ErrorTable]:
    """The errors by dataset, pair set and method, in the order of the file."""
    found: dict[tuple[str, str, str], list[PairErrors]] = defaultdict(list)
    for row in _read(path):
        key = int(row["ref_timestamp_ns"]), int(row["query_timestamp_ns"])
        numbers = [float(row[name]) if row.get(name) else None for name in NUMBERS]
        place = row["dataset"], row["pair_set"], row["method"]
        found[place].append(PairErrors(*key, row["group"], row["status"], *numbers))  # type: ignore[arg-type]
    return {place: ErrorTable.of(rows) for place, rows in found.items()}


def _matching(path: Path) -> dict[tuple[str, str, str], tuple[MatchingRow, ...]]:
    """Rows that sum up to those of the file: one a group and offset, with the counts that the shares are of."""
    found: dict[tuple[str, str, str], Rows] = defaultdict(list)
    for row in _read(path):
        if row["start"] != ALL:
            found[row["dataset"], row["pair_set"], row["method"]].append(row)
    out = {}
    for place, rows in found.items():
        named = [row for row in rows if row["group"] != ALL] or rows
        out[place] = tuple(
            MatchingRow(
                0,
                number,
                "" if row["group"] == ALL else row["group"],
                int(row["start"].removesuffix("px")),
                int(row["count"]),
                *(round(float(row[name] or 0) * int(row["count"])) for name in _COUNTS),
            )
            for number, row in enumerate(named)
        )
    return out


def _entry(
    record: DatasetRecord,
    rows: Rows,
    errors: dict[tuple[str, str, str], ErrorTable],
    matching: dict[tuple[str, str, str], tuple[MatchingRow, ...]],
    truth: Rows,
    runs: dict[tuple[str, str], RunRecord],
) -> DatasetEntry:
    of_sets = [row for row in rows if row["pair_set"] not in TOTALS]
    pair_sets = {name: record.pair_sets[name] for name in dict.fromkeys(row["pair_set"] for row in of_sets)}
    splits = {split: tuple(name for name in names if name in pair_sets) for split, names in record.splits.items()}
    own = {row["method"]: row for row in of_sets}
    methods = [
        _method(row, runs[record.name, label], list(pair_sets), errors, matching) for label, row in sorted(own.items())
    ]
    checks = {row["pair_set"]: _truth_check(row) for row in truth if row["fingerprint"] == record.fingerprint}
    return DatasetEntry(record, tuple(methods), pair_sets, splits=splits, truth_checks=checks)


def _truth_check(row: dict[str, str]) -> TruthCheck:
    counts = (int(row[name]) for name in ("compared", "agree", "apart"))
    return TruthCheck(*counts, float(row["median_apart_px"] or math.nan), int(row["width_px"]))


def _method(
    row: dict[str, str],
    run: RunRecord,
    pair_sets: list[str],
    errors: dict[tuple[str, str, str], ErrorTable],
    matching: dict[tuple[str, str, str], tuple[MatchingRow, ...]],
) -> Method:
    place = row["dataset"], row["method"]
    own = {name: errors[place[0], name, place[1]] for name in pair_sets if (place[0], name, place[1]) in errors}
    matched = {name: matching[place[0], name, place[1]] for name in own if (place[0], name, place[1]) in matching}
    missing = {name: "not run" for name in pair_sets if name not in own}
    return Method(row["method"], run, own, missing, matching=matched, rescored=row["rescored"] == "yes")


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
