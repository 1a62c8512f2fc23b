"""``relocbench evaluate --task relocalization``: retrievers and trackers in a row."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from relocbench.evaluation.relocalization.evaluate import RelocalizationReport


def evaluate_relocalization(config: Path | None, given: dict[str, Any], quiet: bool, json: bool) -> None:
    """Run, score and print. Raises RelocbenchError."""
    from relocbench.cli.configuration import merged, refuse_foreign
    from relocbench.cli.console import print_json, reporter
    from relocbench.evaluation.relocalization.evaluate import RelocalizationOptions, evaluate_chains

    refuse_foreign(RelocalizationOptions, given, "relocalization")
    options = merged(RelocalizationOptions, config, {**given, "task": "relocalization"})
    report = evaluate_chains(options, reporter(quiet))
    if json:
        print_json(report.to_dict())
    elif not quiet:
        _print_report(report)
        for label, message in report.broken:
            typer.echo(f"{label}: {message}", err=True)
        typer.echo(f"results: {report.results}", err=True)


def _print_report(report: RelocalizationReport) -> None:
    from relocbench.cli.console import print_table
    from relocbench.evaluation.relocalization.score import FAILURES, RANKING
    from relocbench.leaderboard.common.text import number

    for name, record in report.tasks.record.tasks.items():
        title = (
            f"{report.tasks.record.dataset}: {name} ({record.queries} queries, {record.gallery} keyframes, pairs reach "
            f"{record.reach_m:.3g} m, {record.reach_deg:.3g}°)"
        )
        found = [(folder.run_record(), report.scores(folder)[name]) for folder in report.folders]
        lost = [share for share in FAILURES if share != "failed_unreachable" or any(v[share] for _, v in found)]
        rows = []
        for run, values in found:
            low, high = values[f"{RANKING}_low"], values[f"{RANKING}_high"]
            bounds = "" if low is None else f" [{number(low, 'share')}, {number(high, 'share')}]"
            shares = (_COARSE, "basin_recall@1", "hit", "right_given_hit", "right_without_hit", *lost)
            rows.append(
                [
                    f"{run.retriever} + {run.tracker}",
                    str(run.top),
                    number(values[RANKING], "share") + bounds,
                    *(number(values[share], "share") for share in shares),
                    number(values["median_translation_error_m"], "m"),
                    number(values["median_rotation_error_deg"], "deg"),
                ]
            )
        columns = [*_COLUMNS, *(f"lost: {share.removeprefix('failed_')}" for share in lost), "median m", "median °"]
        print_table(title, columns, rows)


_COARSE = "recall@(1m,5deg)"
_COLUMNS = (
    "chain",
    "K",
    "0.25 m, 2° %",
    "1 m, 5° %",
    "basin@1 %",
    "basin@K %",
    "right in basin %",
    "right else %",
)
