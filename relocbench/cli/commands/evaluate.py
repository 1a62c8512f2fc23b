"""``relocbench evaluate``: run trackers, keep their predictions, score them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from relocbench.cli import options as common
from relocbench.cli.evaluation import run_evaluation

if TYPE_CHECKING:
    from relocbench.datasets.core.pair_set import PairSet
    from relocbench.evaluation.common.results import MethodResults
    from relocbench.evaluation.tracking.evaluate import Report
    from relocbench.leaderboard.tracking.model import DatasetEntry
    from relocbench.progress import Reporter


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
    sandbox: common.Sandbox = None,
    one_core: common.OneCore = None,
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
    arguments = locals()
    from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods

    run_evaluation(arguments, EvaluateOptions, evaluate_methods, _print_report, _print_together)


ELSEWHERE_COLUMNS = ("answered_share", "confident_share", "confident_high")
"""of the numbers about pairs of different places, in ``scores.yaml``"""


def _print_report(report: Report, progress: Reporter) -> None:
    """The matrix of what was scored, then a table for each pair set, in the order of the dataset's splits."""
    from relocbench.cli.boards import print_matrix
    from relocbench.leaderboard.tracking.by_condition import by_condition
    from relocbench.leaderboard.tracking.doubt import check_truth
    from relocbench.leaderboard.tracking.model import DatasetBoard

    dataset, folders = report.dataset, report.folders
    scored = _scored(report)
    if scored:
        entry = replace(_entry(report, scored), truth_checks=check_truth(dataset, scored, progress))
        print_matrix(by_condition([DatasetBoard(entry, ())]))
    for pair_set in report.pair_sets:
        name = f"{dataset.name}: {pair_set.name}"
        if pair_set.name in scored:
            _print_scores(name, pair_set, folders)
        elif not pair_set.has_truth:
            typer.echo(f"{pair_set.name}: ground truth is withheld; predictions are kept, not scored", err=True)
        if pair_set.negative_pairs:
            _print_elsewhere(name, pair_set.name, folders)
        if report.matching:
            _print_matching(name, pair_set.name, folders)


def _print_together(reports: Sequence[Report], progress: Reporter) -> None:
    """What is found on all datasets together, each of which counts once; each for itself where that says nothing.

    That of each dataset alone is a leaderboard's to show.
    """
    from relocbench.cli.boards import print_over
    from relocbench.leaderboard.tracking.write import compare

    entries = [_entry(report, scored) for report in reports if (scored := _scored(report))]
    over = compare(entries, reporter=progress).over if len(entries) == len(reports) else ()
    print_over(over)
    if not over:
        for report in reports:
            _print_report(report, progress)


def _scored(report: Report) -> list[str]:
    """The pair sets on which some method has scores."""
    records = [folder.score_record() for folder in report.folders]
    return [one.name for one in report.pair_sets if any(one.name in record.pair_sets for record in records)]


def _entry(report: Report, scored: Sequence[str]) -> DatasetEntry:
    """The results on these pair sets with their truth."""
    from relocbench.evaluation.common.dataset_lookup import Truth
    from relocbench.evaluation.common.results import DatasetResults
    from relocbench.leaderboard.tracking.load import load_methods

    labels = [folder.label for folder in report.folders]
    folder = DatasetResults(report.folders[0].root.parent)
    return load_methods(folder, labels, scored, Truth(report.dataset, copy=False))


def _print_scores(name: str, pair_set: PairSet, folders: list[MethodResults]) -> None:
    """The scores of all pairs of a pair set; those of its groups are in ``scores.yaml`` and ``--json``."""
    from relocbench.cli.boards import short_heading
    from relocbench.cli.console import print_table
    from relocbench.evaluation.tables.schema import ALL
    from relocbench.leaderboard.common.text import METHOD, number
    from relocbench.leaderboard.tracking.model import RANKING
    from relocbench.metrics import metric_named, shown_in

    rejected = f", {len(pair_set.rejected)} rejected" if pair_set.rejected else ""
    negative = f", {len(pair_set.negative_pairs)} negative pairs" if pair_set.negative_pairs else ""
    metrics = shown_in("terminal", metric_named(RANKING))
    rows = []
    for folder in folders:
        values = folder.score_record().pair_sets.get(pair_set.name, {}).get(ALL)
        if values is not None:
            rows.append([folder.label, *(number(values.get(m.name), m.unit) for m in metrics)])
    heads = [METHOD, *(short_heading(m.name, m.unit) for m in metrics)]
    print_table(f"{name} ({len(pair_set.pairs)} pairs{negative}{rejected})", heads, rows)


def _print_elsewhere(title: str, pair_set: str, folders: list[MethodResults]) -> None:
    from relocbench.cli.console import print_table
    from relocbench.leaderboard.common.text import METHOD, number
    from relocbench.metrics import CONFIDENT

    scores = {f.label: f.score_record().elsewhere.get(pair_set) for f in folders}
    rows = [
        [label, str(of["pairs"]), *(number(of[name], "share") for name in ELSEWHERE_COLUMNS)]
        for label, of in scores.items()
        if of
    ]
    if rows:
        heads = [METHOD, "pairs", "answered, %", f"confidence {CONFIDENT:g} or more, %", "at most, %"]
        print_table(f"{title}, negative pairs (of different places)", heads, rows)


def _print_matching(title: str, pair_set: str, folders: list[MethodResults]) -> None:
    from relocbench.cli.console import print_table
    from relocbench.evaluation.tables.schema import ALL
    from relocbench.leaderboard.common.text import METHOD, heading, number

    scores = {f.label: f.score_record().matching.get(pair_set, {}).get(ALL) for f in folders}
    known = {label: summary for label, summary in scores.items() if summary}
    if not known:
        return
    offsets = list(next(iter(known.values())))
    rows = [
        [label, within, *(number(summary[offset][f"match@{within.replace(' ', '')}"], "share") for offset in offsets)]
        for label, summary in known.items()
        for within in ("1 px", "3 px")
    ]
    columns = [heading(offset.replace("px", " px")) for offset in offsets]
    print_table(f"{title}, pixels found again by the start's offset", [METHOD, "within", *columns], rows)
