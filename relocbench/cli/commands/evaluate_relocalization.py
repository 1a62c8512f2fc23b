"""``relocbench evaluate-relocalization``: retrieve keyframes, then track against the best of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from relocbench.cli import options as common
from relocbench.cli.evaluation import run_evaluation

if TYPE_CHECKING:
    from relocbench.evaluation.relocalization.evaluate import RelocalizationReport
    from relocbench.progress import Reporter

_BASIN = "The trackers' convergence"


def evaluate_relocalization(
    dataset: common.Dataset = None,
    retrievers: Annotated[
        list[str],
        typer.Option(
            "--retriever",
            "-r",
            metavar="NAME,...",
            autocompletion=common.retrievers,
            callback=common.split_names,
            help="What ranks the keyframes: retrievers as evaluate-retrieval takes them, 'oracle', which knows the "
            "truth, or LABEL=predictions:PATH with lists of 'query db' lines. Each is run with each tracker.",
        ),
    ] = [],  # noqa: B006  typer copies it
    methods: common.Methods = [],  # noqa: B006
    settings: common.Settings = [],  # noqa: B006
    top: Annotated[
        int | None,
        typer.Option(metavar="K", help="Each tracker runs against the K best keyframes of a query [default: 3]."),
    ] = None,
    out: common.Results = None,
    split: common.Split = None,
    pair_sets: common.PairSets = [],  # noqa: B006
    overwrite: common.Overwrite = None,
    seed: common.Seed = None,
    config: common.ConfigFile = None,
    radius: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Largest distance of a keyframe to converge from [default: that of the pairs; none beside --heading].",
            rich_help_panel=_BASIN,
        ),
    ] = None,
    heading: Annotated[
        float | None,
        typer.Option(
            metavar="DEGREES",
            help="Largest rotation of a keyframe to converge from [default: that of the pairs; none beside --radius].",
            rich_help_panel=_BASIN,
        ),
    ] = None,
    probe: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Results of `relocbench probe`, which measured the convergence of each tracker.",
            rich_help_panel=_BASIN,
        ),
    ] = None,
    time_limit: common.TimeLimit = None,
    memory_limit: common.MemoryLimit = None,
    sandbox: common.Sandbox = None,
    workers: common.AskingWorkers = None,
    scheduler: common.Scheduler = None,
    scheduler_tls_ca: common.SchedulerTlsCa = None,
    scheduler_tls_cert: common.SchedulerTlsCert = None,
    scheduler_tls_key: common.SchedulerTlsKey = None,
    quiet: common.Quiet = False,
    json: common.Json = False,
) -> None:
    """Retrieve keyframes, track each query against the best of them, and score the most confident answer.

    Queries that have an answer are not computed again, so that a killed run continues where it stopped.

    Example: relocbench evaluate-relocalization -d D -r orb-bow -r oracle -m gn-net -m dso --top 3
    """
    arguments = locals()
    from relocbench.evaluation.relocalization.evaluate import RelocalizationOptions, evaluate_pipelines

    run_evaluation(arguments, RelocalizationOptions, evaluate_pipelines, _print_report)


def _print_report(report: RelocalizationReport, progress: Reporter) -> None:
    from relocbench.cli.boards import short_heading
    from relocbench.cli.console import print_table
    from relocbench.evaluation.relocalization.score import FAILURES, RANKING
    from relocbench.leaderboard.common.text import RETRIEVER, TOP, TRACKER, number

    for name, record in report.tasks.record.tasks.items():
        title = (
            f"{report.tasks.record.dataset}: {name} ({record.queries} queries, {record.gallery} keyframes, pairs reach "
            f"{record.reach_m:.3g} m, {record.reach_deg:.3g}°)"
        )
        found = [(folder.run_record(), report.scores(folder)[name]) for folder in report.folders]
        median = "median_translation_error_m"
        lost = [share for share in FAILURES if share != "failed_unreachable" or any(v[share] for _, v in found)]
        of_lost = f"lost, %: {' / '.join(share.removeprefix('failed_') for share in lost)}"
        rows = []
        for run, values in found:
            low, high = values[f"{RANKING}_low"], values[f"{RANKING}_high"]
            bounds = "" if low is None else f" [{number(low, 'share')}, {number(high, 'share')}]"
            rows.append(
                [
                    run.retriever,
                    run.tracker,
                    str(run.top),
                    number(values[RANKING], "share") + bounds,
                    " / ".join(number(values[share], "share") for share in lost),
                    number(values[median], "m"),
                ]
            )
        print_table(title, [RETRIEVER, TRACKER, TOP, short_heading(RANKING), of_lost, short_heading(median)], rows)
