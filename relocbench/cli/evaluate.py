"""``relocbench evaluate``: run trackers, keep their predictions, score them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from relocbench.cli import options as common

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.core.pair_set import PairSet
    from relocbench.evaluation.common.results import MethodResults


def evaluate(
    dataset: common.Dataset = None,
    methods: common.Methods = [],  # noqa: B006  typer copies it
    settings: common.Settings = [],  # noqa: B006
    predictions: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="Score poses that were computed elsewhere: a folder of PAIRSET.txt files or one such file, of pairs "
            "or, as hloc writes them, of image names. --method gives the label.",
        ),
    ] = None,
    matching: Annotated[
        bool | None,
        typer.Option(
            "--matching",
            help="Measure also how often single pixels are found again, for methods that offer matching.",
        ),
    ] = None,
    out: common.Results = None,
    split: common.Split = None,
    pair_sets: common.PairSets = [],  # noqa: B006
    overwrite: common.Overwrite = None,
    seed: common.Seed = None,
    config: common.ConfigFile = None,
    time_limit: common.TimeLimit = None,
    memory_limit: common.MemoryLimit = None,
    workers: common.AskingWorkers = None,
    scheduler: common.Scheduler = None,
    scheduler_tls_ca: common.SchedulerTlsCa = None,
    scheduler_tls_cert: common.SchedulerTlsCert = None,
    scheduler_tls_key: common.SchedulerTlsKey = None,
    quiet: common.Quiet = False,
    json: common.Json = False,
) -> None:
    """Run trackers on the pairs of a dataset, keep their predictions and score them.

    A tracker estimates the pose of each query against its keyframe. Pairs that have an answer are not computed again,
    so that a killed run continues where it stopped. See also: evaluate-retrieval, evaluate-relocalization.

    Example: relocbench evaluate -d D -m identity -m orb-pnp -m dso --set dso.points=1000
    """
    from relocbench.cli.configuration import merged
    from relocbench.cli.console import print_json, reporter
    from relocbench.cli.counts import of_evaluation
    from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods

    chosen = common.given(
        dataset=dataset,
        methods=methods,
        set=settings,
        predictions=predictions,
        matching=matching,
        out=out,
        split=split,
        pair_sets=pair_sets,
        overwrite=overwrite,
        seed=seed,
        time_limit=time_limit,
        memory_limit=memory_limit,
        workers=workers,
        scheduler=common.scheduler_values(scheduler, scheduler_tls_ca, scheduler_tls_cert, scheduler_tls_key),
    )
    options = merged(EvaluateOptions, config, chosen)
    report = evaluate_methods(options, reporter(quiet))
    if json:
        print_json(report.to_dict(), of_evaluation(report))
    else:
        _print_report(report.dataset, report.pair_sets, report.folders, matching=options.matching)
        for label, message in report.crashed:
            typer.echo(f"{label}: {message}", err=True)
        if not quiet:
            typer.echo(f"results: {report.results}", err=True)


COLUMNS = (
    "recall@(0.25m,2deg)",
    "t_auc@0.5m",
    "r_auc@0.5deg",
    "median_translation_error_m",
    "median_rotation_error_deg",
    "coverage",
    "median_seconds",
)
ELSEWHERE_COLUMNS = ("answered_share", "confident_share", "confident_high")
"""of the numbers about pairs of different places, in ``scores.yaml``"""


def _print_report(dataset: Dataset, pair_sets: list[PairSet], folders: list[MethodResults], *, matching: bool) -> None:
    from relocbench.cli.console import print_table
    from relocbench.leaderboard.common.headings import METHOD, heading
    from relocbench.metrics import metric_named

    for pair_set in pair_sets:
        rejected = f", {len(pair_set.rejected)} rejected" if pair_set.rejected else ""
        elsewhere = f", {len(pair_set.negative_pairs)} of different places" if pair_set.negative_pairs else ""
        title = f"{dataset.name}: {pair_set.name} ({len(pair_set.pairs)} pairs{elsewhere}{rejected})"
        rows = []
        for folder in folders:
            groups = folder.score_record().pair_sets.get(pair_set.name, {})
            rows += [[folder.label, group, *_cells(values)] for group, values in groups.items()]
        if rows:
            print_table(title, [METHOD, "group", *(heading(m, metric_named(m).unit) for m in COLUMNS)], rows)
        elif not pair_set.has_truth:
            typer.echo(f"{pair_set.name}: ground truth is withheld; predictions are kept, not scored", err=True)
        if pair_set.negative_pairs:
            _print_elsewhere(f"{dataset.name}: {pair_set.name}", pair_set.name, folders)
        if matching:
            _print_matching(f"{dataset.name}: {pair_set.name}", pair_set.name, folders)


def _print_elsewhere(title: str, pair_set: str, folders: list[MethodResults]) -> None:
    from relocbench.cli.console import print_table
    from relocbench.leaderboard.common.headings import ELSEWHERE, METHOD
    from relocbench.metrics import CONFIDENT

    scores = {f.label: f.score_record().elsewhere.get(pair_set) for f in folders}
    rows = [
        [label, str(of["pairs"]), *(cell(of[name], "share") for name in ELSEWHERE_COLUMNS)]
        for label, of in scores.items()
        if of
    ]
    if rows:
        wrong = f"elsewhere_confident: answered with a confidence of {CONFIDENT:g} or more"
        print_table(f"{title}, pairs of different places ({wrong})", [METHOD, *ELSEWHERE], rows)


def _print_matching(title: str, pair_set: str, folders: list[MethodResults]) -> None:
    from relocbench.cli.console import print_table
    from relocbench.evaluation.common.matching_table import ALL
    from relocbench.leaderboard.common.headings import METHOD, heading

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
    columns = [heading(offset.replace("px", " px")) for offset in offsets]
    print_table(f"{title}, pixels found again by the start's offset", [METHOD, "within", *columns], rows)


def _cells(values: dict[str, Any]) -> list[str]:
    from relocbench.metrics import metric_named

    return [cell(values.get(name), metric_named(name).unit) for name in COLUMNS]


def cell(value: float | None, unit: str) -> str:
    """A metric as people read it: shares in percent."""
    if value is None:
        return ""
    if unit == "share":
        return f"{100 * value:.1f}"
    return "inf" if value == float("inf") else f"{value:.4f}"
