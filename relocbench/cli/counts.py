"""What ``--json`` counts. Every command prints one JSON object, whose key ``counts`` has whole numbers by name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.core.recording_folder import RecordingFolder
    from relocbench.datasets.cross_view import CrossViewSet
    from relocbench.evaluation.common.results import MethodResults
    from relocbench.evaluation.relocalization.evaluate import RelocalizationReport
    from relocbench.evaluation.retrieval.evaluate import RetrievalReport
    from relocbench.evaluation.tracking.evaluate import Report

Counts = dict[str, int]


def of_dataset(dataset: Dataset) -> Counts:
    """Traversals, pair sets, and pairs by what became of them."""
    sets = dataset.pair_sets()
    return {
        "traversals": len(dataset.traversal_names),
        "pair_sets": len(sets),
        "pairs": sum(len(s.pairs) for s in sets),
        "pairs_of_different_places": sum(len(s.negative_pairs) for s in sets),
        "rejected": sum(len(s.rejected) for s in sets),
    }


def of_places(places: CrossViewSet) -> Counts:
    """Folders and images of a cross-view set."""
    folders = places.inventory()
    return {"folders": len(folders), "images": sum(folder.images for folder in folders)}


def of_recording(recorded: RecordingFolder) -> Counts:
    """Drives, images and scans."""
    return {
        "drives": len(recorded.drives),
        "images": sum(drive.images for drive in recorded.drives),
        "scans": sum(drive.scans for drive in recorded.drives),
    }


def of_evaluation(report: Report) -> Counts:
    """Answers of all methods to all evaluated pairs, by their status."""
    statuses = _statuses(report.folders, [s.name for s in report.pair_sets])
    return {
        "pair_sets": len(report.pair_sets),
        "pairs": sum(len(s.evaluated) for s in report.pair_sets),
        "rejected": sum(len(s.rejected) for s in report.pair_sets),
        "methods": len(report.folders),
        "answered": statuses["ok"],
        "failed": statuses["failed"],
        "broke": statuses["error"],
    }


def of_retrieval(report: RetrievalReport) -> Counts:
    """Queries of all tasks, and how many of them each retriever did not answer, together."""
    values = [v for folder in report.folders for v in report.scores(folder).values()]
    return {
        "tasks": len(report.asked.chosen),
        "queries": sum(report.record.tasks[task.name].queries for task in report.asked.chosen),
        "methods": len(report.folders),
        "failed": total(v["failed"] for v in values),
        "broke": total(v["broke"] for v in values),
        "suspicious": len(report.suspicions),
    }


def of_pipelines(report: RelocalizationReport) -> Counts:
    """Queries of all tasks, and how many of them each pipeline did not answer, together."""
    values = [v for folder in report.folders for v in report.scores(folder).values()]
    tasks = report.tasks.record.tasks
    return {
        "tasks": len(tasks),
        "queries": sum(task.queries for task in tasks.values()),
        "pipelines": len(report.folders),
        "failed": total(v["failed"] for v in values),
        "broke": total(v["broke"] for v in values),
    }


def total(values: Iterable[float | int | None]) -> int:
    """The sum of the known values."""
    return int(sum(value for value in values if value is not None))


def leaves(values: Mapping[str, Any]) -> int:
    """How many values nested mappings hold."""
    return sum(leaves(value) if isinstance(value, Mapping) else 1 for value in values.values())


def _statuses(folders: Iterable[MethodResults], pair_sets: list[str]) -> Counter[str]:
    """How often each status occurs in the tables of answers; predictions made elsewhere may have none."""
    from relocbench.evaluation.common.answer_table import read_answers

    tables = [folder.answers(name) for folder in folders for name in pair_sets]
    return Counter(answer.status for table in tables if table.exists() for answer in read_answers(table).values())
