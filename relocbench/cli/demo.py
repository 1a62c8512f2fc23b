"""``relocbench demo``: the whole line on a small dataset rendered on the spot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from relocbench.cli.options import Json, Quiet, Workers

_METHODS = ("identity", "clock", "orb-pnp", "dso")


def demo(
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FOLDER", help="Folder for dataset, results and leaderboard.")
    ] = Path("relocbench-demo"),
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the town.")] = 0,
    workers: Workers = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Render a street in four conditions, run three trackers on it and print the leaderboard, in a minute or two.

    Example: relocbench demo --out demo
    """
    from relocbench.cli.console import print_json, reporter
    from relocbench.cli.counts import of_evaluation
    from relocbench.cli.leaderboard import print_leaderboard
    from relocbench.datasets.importers import importer
    from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
    from relocbench.execution import Run, default_workers
    from relocbench.files import alone_writing_to
    from relocbench.leaderboard import write_leaderboard

    report = reporter(quiet)
    with alone_writing_to(out):
        town = importer("synthetic")
        options = town.Options.model_validate({"preset": "demo", "seed": seed})
        dataset = town.build([], options, out / "dataset", report, Run(workers or default_workers()))
        report_of_methods = evaluate_methods(
            EvaluateOptions(dataset=dataset.root, methods=_METHODS, out=out / "results", workers=workers), report
        )
        board = write_leaderboard(out / "results", out / "leaderboard", reporter=report)
    if json:
        places = {"dataset": dataset.root, "results": out / "results", "leaderboard": out / "leaderboard"}
        print_json(places, of_evaluation(report_of_methods))
        return
    print_leaderboard(board)
    if not quiet:
        typer.echo(f"\nlook at: {out / 'leaderboard' / 'leaderboard.md'}", err=True)
        typer.echo(f"pictures of the truth: relocbench inspect {dataset.root} --pictures {out / 'pictures'}", err=True)
