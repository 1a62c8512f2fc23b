"""``relocbench evaluate``: run methods, keep their predictions, score them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from relocbench.cli.options import Json, Methods, Quiet, Scheduler, Settings, Workers

if TYPE_CHECKING:
    from relocbench.datasets.dataset import Dataset, PairSet
    from relocbench.evaluation.results import MethodResults


def evaluate(
    dataset: Annotated[Path | None, typer.Option("--dataset", "-d", help="Folder of the dataset.")] = None,
    method: Methods = [],  # noqa: B006  typer copies it
    settings: Settings = [],  # noqa: B006
    predictions: Annotated[
        Path | None,
        typer.Option(help="Score a folder of PAIRSET.txt files that were made elsewhere; --method gives the label."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Results folder [default: results].")] = None,
    split: Annotated[str | None, typer.Option(help="Only the pair sets of this split.")] = None,
    pair_set: Annotated[list[str], typer.Option(help="Only this pair set. Repeat for several.")] = [],  # noqa: B006
    overwrite: Annotated[
        Literal["never", "failed", "always"] | None,
        typer.Option(help="Which answers to ask for again: none, failed ones, or all [default: never]."),
    ] = None,
    matching: Annotated[
        bool | None,
        typer.Option(
            "--matching/--no-matching",
            help="Measure too how often single pixels are found again, of methods that offer it [default: no].",
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed for methods that have one [default: 0].")] = None,
    config: Annotated[Path | None, typer.Option(help="YAML file with any of these options.")] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Run methods on a dataset, keep their predictions and score them.

    A pair that was answered before is not asked again, so a killed run goes on where it stopped.

    Example: relocbench evaluate -d D -m identity -m orb-pnp -m dso --set dso.points=1000
    """
    from relocbench.cli.console import print_json, reporter
    from relocbench.evaluation.evaluate import EvaluateOptions, evaluate_methods

    given: dict[str, Any] = {
        "dataset": dataset,
        "methods": method or None,
        "set": settings or None,
        "predictions": predictions,
        "out": out,
        "split": split,
        "pair_sets": pair_set or None,
        "overwrite": overwrite,
        "matching": matching,
        "seed": seed,
        "workers": workers,
        "scheduler": scheduler,
    }
    from relocbench.cli.configuration import merged

    options = merged(EvaluateOptions, config, {k: v for k, v in given.items() if v is not None})
    report = evaluate_methods(options, reporter(quiet))
    if json:
        print_json(report.to_dict())
    elif not quiet:
        _print_report(report.dataset, report.pair_sets, report.folders, matching=options.matching)
        for label, message in report.broken:
            typer.echo(f"{label}: {message}", err=True)
        typer.echo(f"results: {report.results}", err=True)


COLUMNS = {
    "recall@(0.25m,2deg)": "recall 0.25 m, 2°",
    "t_auc@0.5m": "t_auc 0.5 m",
    "r_auc@0.5deg": "r_auc 0.5°",
    "median_translation_error_m": "median m",
    "median_rotation_error_deg": "median °",
    "coverage": "coverage",
    "median_seconds": "s a pair",
}


def _print_report(dataset: Dataset, pair_sets: list[PairSet], folders: list[MethodResults], *, matching: bool) -> None:
    from relocbench.cli.console import print_table

    for pair_set in pair_sets:
        rejected = f", {len(pair_set.rejected)} rejected" if pair_set.rejected else ""
        title = f"{dataset.name}: {pair_set.name} ({len(pair_set.pairs)} pairs{rejected})"
        rows = []
        for folder in folders:
            groups = folder.score_record().pair_sets.get(pair_set.name, {})
            rows += [[folder.label, group, *_cells(values)] for group, values in groups.items()]
        if rows:
            print_table(title, ["method", "pairs of", *COLUMNS.values()], rows)
        elif not pair_set.has_truth:
            typer.echo(f"{pair_set.name}: ground truth is withheld; predictions are kept, not scored", err=True)
        if matching:
            _print_matching(f"{dataset.name}: {pair_set.name}", pair_set.name, folders)


def _print_matching(title: str, pair_set: str, folders: list[MethodResults]) -> None:
    from relocbench.cli.console import print_table
    from relocbench.evaluation.matching_table import ALL

    scores = {f.label: f.score_record().matching.get(pair_set, {}).get(ALL) for f in folders}
    known = {label: summary for label, summary in scores.items() if summary}
    if not known:
        return
    offsets = list(next(iter(known.values())))
    rows = [
        [label, within, *(cell(summary[offset][f"match@{within.replace(' ', '')}"], "share") for offset in offsets)]
        for label, summary in known.items()
        for within in ("1 px", "3 px")
    ]
    columns = [offset.replace("px", " px") for offset in offsets]
    print_table(f"{title}, pixels found again by the start's offset", ["method", "within", *columns], rows)


def _cells(values: dict[str, Any]) -> list[str]:
    from relocbench.metrics import metric_named

    return [cell(values.get(name), metric_named(name).unit) for name in COLUMNS]


def cell(value: float | None, unit: str) -> str:
    """A metric as people read it: shares in percent."""
    if value is None:
        return ""
    if unit == "share":
        return f"{100 * value:.1f} %"
    return "inf" if value == float("inf") else f"{value:.4f}"
