"""Checking results as leaderboards read them: retrievers, pipelines, and the cards of what was submitted.

Every fault of a table is found, and of whatever else a retriever or a pipeline consists of the first one; trackers have
more to check (:mod:`relocbench.evaluation.tracking.validation`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from relocbench.datasets.checks.faults import Findings
from relocbench.datasets.core.dataset import Dataset
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.folders import folders_with, sets_in
from relocbench.evaluation.common.results import (
    DatasetResults,
    MethodResults,
)
from relocbench.evaluation.submission.kept import kept_card
from relocbench.evaluation.tracking.validation import is_tracking_folder, validate_results
from relocbench.leaderboard.common.by_query import F, M, QueryTask, S, T, U
from relocbench.leaderboard.relocalization.board import RELOCALIZATION
from relocbench.leaderboard.retrieval.board import RETRIEVAL
from relocbench.progress import Reporter

_RECORDS = (RETRIEVAL.kind.FILE, RELOCALIZATION.kind.FILE)


def is_results_folder(path: Path) -> bool:
    """Whether a folder is a results folder, the part of one dataset, or that of one method in it."""
    others = any((path / name).exists() or any(path.glob(f"*@*/{name}")) for name in _RECORDS)
    return others or is_tracking_folder(path)


def validate_all_results(root: Path, dataset: Dataset | None, reporter: Reporter) -> Findings:
    """Check a results folder, one ``NAME@FINGERPRINT`` folder of it, or one method's folder.

    Args:
        dataset: if given, what is of it is compared with it and scored again.
    """
    is_row = (root / "run.yaml").exists()
    top = root.parent if is_row else root
    found = Findings() if _is_of_others(top) else validate_results(root, dataset, reporter)
    for tracker in _trackers(root, found):
        if tracker.run_yaml not in found.faulty_files:
            with found.catching():
                kept_card(tracker.root, tracker.run_record())
    checks = [check for check, row in _other_rows(top, dataset, found) if not is_row or row == root]
    with reporter.stage("checking retrievers and pipelines", len(checks)) as advance:
        for check in checks:
            with found.catching():
                check()
            advance(1)
    return found


def _is_of_others(top: Path) -> bool:
    return any((top / name).exists() for name in _RECORDS)


def _trackers(root: Path, found: Findings) -> list[MethodResults]:
    """The folders of trackers; a label that is none is a fault."""
    if (root / "run.yaml").exists():
        return [] if _is_of_others(root.parent) else [MethodResults(root)]
    trackers: list[MethodResults] = []
    for folder in folders_with("dataset.yaml", root):
        with found.catching():
            trackers += DatasetResults(folder).methods()
    return trackers


def _other_rows(top: Path, dataset: Dataset | None, found: Findings) -> list[tuple[Callable[[], object], Path]]:
    """What checks each retriever and pipeline, and its folder; a record that cannot be read is a fault."""
    lookup = None if dataset is None else DatasetLookup(top, [dataset.root])
    return [*_rows_of(RETRIEVAL, top, lookup, found), *_rows_of(RELOCALIZATION, top, lookup, found)]


def _rows_of(
    task: QueryTask[F, S, U, M, T], top: Path, lookup: DatasetLookup | None, found: Findings
) -> list[tuple[Callable[[], object], Path]]:
    rows: list[tuple[Callable[[], object], Path]] = []
    for folder in sets_in(top, task.kind):
        with found.catching():
            record = folder.record
            truth = None if lookup is None else task.truth(folder, record, lookup)
            rows += [(partial(_check_row, task, row, record, truth, found), row.root) for row in folder.methods()]
    return rows


def _check_row(task: QueryTask[F, S, U, M, T], row: F, record: S, truth: T | None, found: Findings) -> None:
    """Check the tables of a method and, where they are whole, all that is read of it."""
    units, before = task.units(record), len(found.faults)
    for name in units:
        if row.answers(name).exists():
            task.schema.check(row.answers(name), found)
    if len(found.faults) == before:
        task.read(row, record, units, truth)
