"""``relocbench evaluate``: run methods, keep their predictions, score them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from relocbench.cli.options import (
    AskingWorkers,
    Json,
    MemoryLimit,
    Methods,
    Quiet,
    Scheduler,
    SchedulerTlsCa,
    SchedulerTlsCert,
    SchedulerTlsKey,
    Settings,
    TimeLimit,
    scheduler_values,
)

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.core.pair_set import PairSet
    from relocbench.evaluation.common.results import MethodResults


def evaluate(
    task: Annotated[
        Literal["tracking", "retrieval", "relocalization"] | None,
        typer.Option(
            help="What is asked: the pose of a query against its keyframe, which images of a gallery are near, or both "
            "in a row: retrieve keyframes, track against the best [default: tracking]."
        ),
    ] = None,
    dataset: Annotated[
        Path | None,
        typer.Option("--dataset", "-d", help="Folder of the dataset; for retrieval also places by several views."),
    ] = None,
    method: Methods = [],  # noqa: B006  typer copies it
    settings: Settings = [],  # noqa: B006
    retriever: Annotated[
        list[str],
        typer.Option(
            "--retriever",
            "-r",
            help="Relocalization: what ranks the keyframes for the trackers of --method: a retriever as --method names "
            "one, 'oracle', which knows the truth, or LABEL=predictions:PATH with lists of 'query db' lines. Repeat "
            "for several: each is run with each tracker.",
        ),
    ] = [],  # noqa: B006
    top: Annotated[
        int | None,
        typer.Option(help="Relocalization: trackers are asked against so many of the best keyframes [default: 3]."),
    ] = None,
    predictions: Annotated[
        Path | None,
        typer.Option(
            help="Score what was made elsewhere: a folder of PAIRSET.txt files, for retrieval a folder of TASK.txt "
            "files of 'query db' lines, or one such file; --method gives the label."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Results folder [default: results].")] = None,
    split: Annotated[str | None, typer.Option(help="Only the pair sets of this split.")] = None,
    pair_set: Annotated[
        list[str], typer.Option(help="Only this pair set, or retrieval task. Repeat for several.")
    ] = [],  # noqa: B006
    overwrite: Annotated[
        Literal["never", "failed", "always"] | None,
        typer.Option(help="Which answers to ask for again: none, failed ones, or all [default: never]."),
    ] = None,
    matching: Annotated[
        bool | None,
        typer.Option(
            "--matching/--no-matching",
            help="Tracking: measure too how often single pixels are found again, of methods that offer it "
            "[default: no].",
        ),
    ] = None,
    keep: Annotated[
        int | None, typer.Option(help="Retrieval: so many retrieved images of each query are kept [default: 100].")
    ] = None,
    radius: Annotated[
        float | None,
        typer.Option(
            help="Retrieval along drives: metres within which an image is right [default: 25]. Relocalization: metres "
            "of the trackers' basin [default: as far as the pairs reach]."
        ),
    ] = None,
    heading: Annotated[
        float | None,
        typer.Option(
            help="Retrieval along drives: and that look the same way within so many degrees [default: any]. "
            "Relocalization: degrees of the basin."
        ),
    ] = None,
    probe: Annotated[
        Path | None,
        typer.Option(help="Relocalization: results of `relocbench probe`, for each tracker's own basin."),
    ] = None,
    positives: Annotated[
        Literal["radius", "pairs"] | None,
        typer.Option(
            help="Retrieval along drives: what is right, images within the radius or those that the pair set pairs "
            "with the query [default: radius]."
        ),
    ] = None,
    by_condition: Annotated[
        bool | None,
        typer.Option("--by-condition", help="Retrieval across views: ask queries of each condition by themselves too."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed for methods that have one [default: 0].")] = None,
    config: Annotated[Path | None, typer.Option(help="YAML file with any of these options.")] = None,
    time_limit: TimeLimit = None,
    memory_limit: MemoryLimit = None,
    workers: AskingWorkers = None,
    scheduler: Scheduler = None,
    scheduler_tls_ca: SchedulerTlsCa = None,
    scheduler_tls_cert: SchedulerTlsCert = None,
    scheduler_tls_key: SchedulerTlsKey = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Run methods on a dataset, keep their predictions and score them.

    What was answered before is not asked again, so a killed run goes on where it stopped.

    Example: relocbench evaluate -d D -m identity -m orb-pnp -m dso --set dso.points=1000

    Example: relocbench evaluate --task retrieval -d D -m lpn --set lpn.weights=trained/weights.safetensors

    Example: relocbench evaluate --task relocalization -d D -r orb-bow -r oracle -m gn-net -m dso --top 3
    """
    given: dict[str, Any] = {
        "dataset": dataset,
        "methods": method or None,
        "set": settings or None,
        "retriever": retriever or None,
        "top": top,
        "predictions": predictions,
        "out": out,
        "split": split,
        "pair_sets": pair_set or None,
        "overwrite": overwrite,
        "matching": matching,
        "keep": keep,
        "radius": radius,
        "heading": heading,
        "probe": probe,
        "positives": positives,
        "by_condition": by_condition,
        "seed": seed,
        "time_limit": time_limit,
        "memory_limit": memory_limit,
        "workers": workers,
        "scheduler": scheduler_values(scheduler, scheduler_tls_ca, scheduler_tls_cert, scheduler_tls_key),
    }
    chosen = {name: value for name, value in given.items() if value is not None}
    asked = task or _task_of(config)
    _EVALUATIONS[asked](config, chosen, quiet, json)


def _task_of(config: Path | None) -> str:
    """What a configuration file asks for, where the command line does not say."""
    from relocbench.errors import ConfigError
    from relocbench.files import load_yaml_values, yaml_line

    if config is None:
        return TRACKING
    values, node = load_yaml_values(config, "options with their values", ConfigError)
    asked = values.get("task", TRACKING)
    if asked not in _EVALUATIONS:
        line = yaml_line(node, ("task",))
        raise ConfigError(f"key 'task' is '{asked}', expected {' or '.join(_EVALUATIONS)}", config, line)
    return str(asked)


def _evaluate_tracking(config: Path | None, given: dict[str, Any], quiet: bool, json: bool) -> None:
    from relocbench.cli.configuration import merged, refuse_foreign
    from relocbench.cli.console import print_json, reporter
    from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods

    refuse_foreign(EvaluateOptions, given, TRACKING)
    options = merged(EvaluateOptions, config, given)
    report = evaluate_methods(options, reporter(quiet))
    if json:
        print_json(report.to_dict())
    elif not quiet:
        _print_report(report.dataset, report.pair_sets, report.folders, matching=options.matching)
        for label, message in report.broken:
            typer.echo(f"{label}: {message}", err=True)
        typer.echo(f"results: {report.results}", err=True)


def _evaluate_retrieval(config: Path | None, given: dict[str, Any], quiet: bool, json: bool) -> None:
    from relocbench.cli.evaluate_retrieval import evaluate_retrieval

    evaluate_retrieval(config, given, quiet, json)


def _evaluate_relocalization(config: Path | None, given: dict[str, Any], quiet: bool, json: bool) -> None:
    from relocbench.cli.evaluate_relocalization import evaluate_relocalization

    evaluate_relocalization(config, given, quiet, json)


TRACKING = "tracking"
_EVALUATIONS: dict[str, Callable[[Path | None, dict[str, Any], bool, bool], None]] = {
    TRACKING: _evaluate_tracking,
    "retrieval": _evaluate_retrieval,
    "relocalization": _evaluate_relocalization,
}
"""by ``--task``: each takes the configuration file, the options that were given, ``--quiet`` and ``--json``"""

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
    from relocbench.evaluation.common.matching_table import ALL

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
