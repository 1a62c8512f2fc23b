"""``relocbench evaluate-retrieval``: run retrievers, keep their rankings, score them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from relocbench.cli import options as common
from relocbench.cli.evaluation import run_evaluation

if TYPE_CHECKING:
    from relocbench.evaluation.retrieval.evaluate import RetrievalReport
    from relocbench.progress import Reporter

_DRIVES = "Only for drives"
_VIEWS = "Only for places by several views"


def evaluate_retrieval(
    dataset: Annotated[
        Path | None,
        typer.Option(
            "--dataset",
            "-d",
            metavar="FOLDER",
            callback=common.existing,
            help="The dataset, or places by several views in University-1652's layout; required, here or in --config.",
        ),
    ] = None,
    methods: Annotated[
        list[str],
        typer.Option(
            "--method",
            "-m",
            metavar="NAME,...",
            autocompletion=common.retrievers,
            callback=common.split_names,
            help="Installed names or package.module:Class; write LABEL=NAME to keep its results under that label. "
            "Repeat it, or join installed names by commas.",
        ),
    ] = [],  # noqa: B006  typer copies it
    settings: common.Settings = [],  # noqa: B006
    predictions: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="Score rankings that were computed elsewhere: a folder of TASK.txt files of 'query db' lines, or one "
            "such file. --method gives the label.",
        ),
    ] = None,
    keep: Annotated[
        int | None, typer.Option(metavar="N", help="Retrieved images of each query that are kept [default: 100].")
    ] = None,
    out: common.Results = None,
    tasks: Annotated[
        list[str],
        typer.Option(
            "--pair-set", metavar="NAME,...", callback=common.split_commas, help="Evaluate only these retrieval tasks."
        ),
    ] = [],  # noqa: B006
    overwrite: common.Overwrite = None,
    seed: common.Seed = None,
    config: common.ConfigFile = None,
    split: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Evaluate only the pair sets of this split.", rich_help_panel=_DRIVES),
    ] = None,
    positives: Annotated[
        Literal["radius", "pairs"] | None,
        typer.Option(
            metavar="WHICH",
            help="Which images are right: those within the radius (radius), or those that the pair set pairs with the "
            "query (pairs) [default: radius].",
            rich_help_panel=_DRIVES,
        ),
    ] = None,
    radius: Annotated[
        float | None,
        typer.Option(
            metavar="METRES", help="Distance within which an image is right [default: 25].", rich_help_panel=_DRIVES
        ),
    ] = None,
    heading: Annotated[
        float | None,
        typer.Option(
            metavar="DEGREES",
            help="Largest difference of the viewing directions of a right image [default: any].",
            rich_help_panel=_DRIVES,
        ),
    ] = None,
    by_condition: Annotated[
        bool | None,
        typer.Option(
            "--by-condition",
            help="Evaluate the queries of each condition also as a task of their own.",
            rich_help_panel=_VIEWS,
        ),
    ] = None,
    time_limit: common.TimeLimit = None,
    memory_limit: common.MemoryLimit = None,
    sandbox: common.Sandbox = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            "-j",
            metavar="0",
            min=0,
            help="With 0 the retriever runs in this process without limits, for a debugger [default: in one process of "
            "its own].",
            rich_help_panel="Where and how work runs",
        ),
    ] = None,
    quiet: common.Quiet = False,
    json: common.Json = False,
) -> None:
    """Run retrievers on a dataset, keep their rankings and score them.

    A retriever describes images, and those of the gallery are ranked for each query. Tasks that have an answer are not
    computed again, so that a killed run continues where it stopped.

    Example: relocbench evaluate-retrieval -d D -m lpn --set lpn.weights=trained/weights.safetensors
    """
    arguments = locals()
    from relocbench.evaluation.retrieval.evaluate import RetrievalOptions, evaluate_retrievers

    run_evaluation(arguments, RetrievalOptions, evaluate_retrievers, _print_report)


def _print_report(report: RetrievalReport, progress: Reporter) -> None:
    from relocbench.cli.boards import short_heading
    from relocbench.cli.console import print_table
    from relocbench.leaderboard.common.text import COUNTS, METHOD, SECONDS, heading
    from relocbench.leaderboard.retrieval.columns import TERMINAL

    for task in report.asked.chosen:
        record = report.record.tasks[task.name]
        without = f", {record.without_positives} of them without a right one" if record.without_positives else ""
        title = f"{report.asked.name}: {task.name} ({record.queries} queries{without}, {record.gallery} images)"
        scores = {folder.label: values for folder in report.folders if (values := report.scores(folder).get(task.name))}
        unanswered = [COUNTS] if any(values["failed"] or values["broke"] for values in scores.values()) else []
        rows = []
        for label, values in scores.items():
            seconds = values["median_seconds"]
            counts = [f"{values['failed']} / {values['broke']}"] if unanswered else []
            cells = [_percent(values, metric) for metric in TERMINAL]
            rows.append([label, *cells, "" if seconds is None else f"{seconds:.3g}", *counts])
        if rows:
            chance = [f"{100 * record.chance[metric]:.1f}" for metric in TERMINAL]
            rows.append(["(chance)", *chance, "", *[""] * len(unanswered)])
            heads = [METHOD, *map(heading, TERMINAL), short_heading(SECONDS), *unanswered]
            print_table(title, heads, rows)


def _percent(values: dict[str, float | int | None], metric: str) -> str:
    value, low, high = (values[name] for name in (metric, f"{metric}_low", f"{metric}_high"))
    if value is None:
        return ""
    bounds = "" if low is None or high is None or metric != "R@1" else f" [{100 * low:.1f}, {100 * high:.1f}]"
    return f"{100 * value:.1f}{bounds}"
