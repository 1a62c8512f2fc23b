"""``relocbench evaluate --task retrieval``: run retrievers, keep their rankings, score them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from relocbench.evaluation.retrieval.evaluate import RetrievalReport


def evaluate_retrieval(config: Path | None, given: dict[str, Any], quiet: bool, json: bool) -> None:
    """Run, score and print. Raises RelocbenchError."""
    from relocbench.cli.configuration import merged, refuse_foreign
    from relocbench.cli.console import print_json, reporter
    from relocbench.evaluation.retrieval.evaluate import RetrievalOptions, evaluate_retrievers

    refuse_foreign(RetrievalOptions, given, "retrieval")
    options = merged(RetrievalOptions, config, {**given, "task": "retrieval"})
    reports = reporter(quiet)
    report = evaluate_retrievers(options, reports)
    if json:
        print_json(report.to_dict())
    elif not quiet:
        _print_report(report)
        for label, message in [*report.broken, *report.suspicions]:
            typer.echo(f"{label}: {message}", err=True)
        typer.echo(f"results: {report.results}", err=True)


def _print_report(report: RetrievalReport) -> None:
    from relocbench.cli.console import print_table
    from relocbench.evaluation.retrieval.records import METRICS

    for task in report.asked.chosen:
        record = report.record.tasks[task.name]
        without = f", {record.without_positives} of them without a right one" if record.without_positives else ""
        title = f"{report.asked.name}: {task.name} ({record.queries} queries{without}, {record.gallery} images)"
        rows = []
        for folder in report.folders:
            values = report.scores(folder).get(task.name)
            if values:
                broke = f"{values['failed']} / {values['broke']}"
                seconds = values["median_seconds"]
                cells = [_percent(values, metric) for metric in METRICS]
                rows.append([folder.label, *cells, broke, "" if seconds is None else f"{seconds:.3g}"])
        if rows:
            rows.append(["(chance)", *(f"{100 * record.chance[metric]:.1f}" for metric in METRICS), "", ""])
            print_table(title, ["method", *(f"{m} %" for m in METRICS), "failed / broke", "s a query"], rows)


def _percent(values: dict[str, float | int | None], metric: str) -> str:
    value, low, high = (values[name] for name in (metric, f"{metric}_low", f"{metric}_high"))
    if value is None:
        return ""
    bounds = (
        "" if low is None or high is None or metric not in ("R@1", "AP") else f" [{100 * low:.1f}, {100 * high:.1f}]"
    )
    return f"{100 * value:.1f}{bounds}"
