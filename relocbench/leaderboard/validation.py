"""Checking results as leaderboards read them: retrievers, pipelines, and the cards of what was submitted.

Of a retriever or a pipeline the first fault is found, of each tracker's files every one
(:mod:`relocbench.evaluation.tracking.validation`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from relocbench.datasets.checks.faults import Findings
from relocbench.datasets.core.dataset import Dataset
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.results import DatasetResults, MethodResults, folders_with
from relocbench.evaluation.relocalization.records import SET_FILE as PIPELINE_FILE
from relocbench.evaluation.relocalization.records import PipelineSetResults
from relocbench.evaluation.relocalization.rescoring import PipelineTruth
from relocbench.evaluation.retrieval.records import SET_FILE as RETRIEVAL_FILE
from relocbench.evaluation.retrieval.records import SetResults
from relocbench.evaluation.retrieval.rescoring import truth_of
from relocbench.evaluation.submission.kept import kept_card
from relocbench.evaluation.tracking.validation import is_tracking_folder, validate_results
from relocbench.leaderboard.relocalization.board import load_pipeline
from relocbench.leaderboard.retrieval.board import load_retriever
from relocbench.progress import Reporter

_RECORDS = (RETRIEVAL_FILE, PIPELINE_FILE)


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
    rows: list[tuple[Callable[[], object], Path]] = []
    lookup = None if dataset is None else DatasetLookup(top, [dataset.root])
    for folder in map(SetResults, folders_with(RETRIEVAL_FILE, top)):
        with found.catching():
            asked, truth = folder.record, None if lookup is None else truth_of(folder, lookup)
            rows += [(partial(load_retriever, row, asked, asked.tasks, truth), row.root) for row in folder.methods()]
    for pipelines in map(PipelineSetResults, folders_with(PIPELINE_FILE, top)):
        with found.catching():
            record = pipelines.record
            of_it = dataset is not None and dataset.fingerprint == record.dataset_fingerprint
            known = PipelineTruth(dataset, pipelines) if dataset is not None and of_it else None
            rows += [
                (partial(load_pipeline, row, record, record.tasks, known), row.root) for row in pipelines.pipelines()
            ]
    return rows
