"""``relocbench leaderboard`` and ``relocbench report``: tables and pages from a results folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from relocbench.cli.options import Json, Quiet, split_commas

if TYPE_CHECKING:
    from relocbench.evaluation.common.dataset_lookup import DatasetLookup
    from relocbench.leaderboard.boards import Boards
    from relocbench.progress import Reporter

_USUAL = {
    "--metric": "recall@(0.25m,2deg)",
    "--retrieval-metric": "R@1",
    "--relocalization-metric": "recall@(0.25m,2deg)",
}
"""metric that ranks, unless the option names another"""


Results = Annotated[
    Path, typer.Argument(metavar="RESULTS", help="Results folder of the evaluate commands.", show_default=False)
]
Datasets = Annotated[
    list[Path] | None,
    typer.Option(
        "--dataset",
        "-d",
        metavar="FOLDER",
        help="Dataset of the results, or a folder with datasets in it: all errors and ranks are computed anew from "
        "predictions and truth. Repeat for several; datasets beside RESULTS need not be named.",
        show_default=False,
    ),
]
RankingMetric = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help=f"For results of evaluate: metric that ranks trackers; any that is a mean over pairs [default: "
        f"{_USUAL['--metric']}].",
    ),
]
RetrievalMetric = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help=f"For results of evaluate-retrieval: metric that ranks retrievers, such as R@5 or AP [default: "
        f"{_USUAL['--retrieval-metric']}].",
    ),
]
RelocalizationMetric = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help=f"For results of evaluate-relocalization: metric that ranks a retriever with a tracker; any that is a "
        f"mean over queries [default: {_USUAL['--relocalization-metric']}].",
    ),
]
Split = Annotated[str | None, typer.Option(metavar="NAME", help="Show only the pair sets of this split.")]
Seed = Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the draws that decide ranks.")]


def leaderboard(
    results: Results,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FOLDER", help="Folder to write.")],
    dataset: Datasets = None,
    metric: RankingMetric = None,
    retrieval_metric: RetrievalMetric = None,
    relocalization_metric: RelocalizationMetric = None,
    split: Split = None,
    seed: Seed = 0,
    html: Annotated[
        bool,
        typer.Option(
            "--html", help="Also write html/index.html, pages that sort, filter and zoom, opened from the disk."
        ),
    ] = False,
    pairs: Annotated[
        int,
        typer.Option(
            min=0,
            metavar="N",
            help="With --html: where the dataset is available, the pages of the N worst pairs of each method and of N "
            "drawn at random, in each pair set, show their images; about 0.1 MB a pair. So do those of queries of "
            "retrievers and of retrieval followed by tracking.",
        ),
    ] = 6,
    formats: Annotated[
        list[str],
        typer.Option(
            "--format",
            "-f",
            metavar="csv|markdown|latex|html,...",
            callback=split_commas,
            help="Formats to write [default: csv,markdown]. latex has tables for papers, html is --html.",
        ),
    ] = [],  # noqa: B006
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Compare methods in CSV and Markdown; retrievers, and retrievers with trackers, have their own pages.

    Needs the results folder alone. Where the dataset is available too, all errors are computed anew from it.
    The same results give the same bytes.

    Example: relocbench leaderboard results --out leaderboard

    Example: relocbench leaderboard results --out tables --format latex
    """
    from relocbench.cli.boards import print_board, print_by_query
    from relocbench.cli.console import print_json, reporter
    from relocbench.evaluation.common.dataset_lookup import DatasetLookup
    from relocbench.evaluation.common.opening import check_in_no_dataset
    from relocbench.files import locked_output
    from relocbench.leaderboard.common.by_query import note_missing
    from relocbench.leaderboard.common.over_datasets import over_records
    from relocbench.leaderboard.formats import How, check_formats, write_formats
    from relocbench.leaderboard.tracking.long_form import leaderboard_rows

    check_in_no_dataset(out)
    ranked_by = _ranked_by(results, metric, retrieval_metric, relocalization_metric)
    progress, chosen = reporter(quiet), check_formats(formats, html)
    lookup = DatasetLookup(results, dataset or (), progress)
    with locked_output(out):
        boards = _load(results, lookup, ranked_by, split, seed, progress)
        for _, other in boards.by_query:
            note_missing(other, progress)
        files = write_formats(boards, out, chosen, How(pairs, progress))
    board = boards.tracking
    if json:
        others: dict[str, Any] = {}
        for display, other in boards.by_query:
            others |= {f"{display.name}_metric": other.metric, display.name: display.records(other)}
            others |= {f"{display.name}_datasets": over_records(other.over)}
        rows = [] if board is None else leaderboard_rows(board)
        others["datasets"] = [] if board is None else over_records(board.over)
        counts = {
            "rows": len(rows) + sum(len(others[display.name]) for display, _ in boards.by_query),
            "pair_sets": sum(len(b.entry.pair_sets) for b in board.datasets) if board else 0,
            "files_written": len(files),
        }
        head = {"metric": ranked_by["--metric"], "seed": seed, "split": split, "formats": chosen}
        print_json({**head, "files": [str(path) for path in files], "rows": rows, **others}, counts)
    else:
        if board is not None:
            print_board(board)
        for display, other in boards.by_query:
            print_by_query(display, other)
        if not quiet:
            for path in _first_pages(files):
                typer.echo(f"written: {path}", err=True)


def _first_pages(files: Sequence[Path]) -> list[Path]:
    """The files to look at first: of each format the page of each task, without what lies beside it."""
    pages = [path for path in files if path.stem in ("leaderboard", "retrieval", "relocalization", "index")]
    return [path for path in pages if path.suffix != ".csv"] or pages


def report(
    results: Results,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FOLDER", help="Folder to write; index.html is in it.")],
    dataset: Datasets = None,
    metric: RankingMetric = None,
    retrieval_metric: RetrievalMetric = None,
    relocalization_metric: RelocalizationMetric = None,
    split: Split = None,
    seed: Seed = 0,
    pairs: Annotated[
        int,
        typer.Option(
            min=0,
            metavar="N",
            help="Where the dataset is available, the pages of the N worst pairs of each method and of N drawn at "
            "random, in each pair set, show their images; about 0.1 MB a pair. So do those of queries of retrievers "
            "and of retrieval followed by tracking.",
        ),
    ] = 6,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Write results as pages that sort, filter and zoom, opened from the disk without a server or the network.

    The same pages as those of leaderboard --html, alone. The same results give the same bytes.

    Example: relocbench report results --out report --pairs 20

    Example: relocbench report results --out report --metric "pose_auc@(0.5m,4deg)"
    """
    from relocbench.cli.console import print_json, reporter
    from relocbench.evaluation.common.dataset_lookup import DatasetLookup
    from relocbench.files import locked_output
    from relocbench.leaderboard.html.manifest import earlier_files
    from relocbench.leaderboard.html.site import write_site

    ranked_by = _ranked_by(results, metric, retrieval_metric, relocalization_metric)
    progress = reporter(quiet)
    earlier_files(out)  # a folder that is not for pages is refused before the work
    lookup = DatasetLookup(results, dataset or (), progress)
    with locked_output(out):
        boards = _load(results, lookup, ranked_by, split, seed, progress)
        start = write_site(boards, out, pairs=pairs, reporter=progress)
    if json:
        counts = {
            "sets": boards.sets,
            "methods": len(boards.methods),
            "files_written": len(earlier_files(out)),
        }
        print_json({"page": start, "metric": ranked_by["--metric"]}, counts)
    elif not quiet:
        typer.echo(f"written: {start}", err=True)


def _load(
    results: Path,
    lookup: DatasetLookup,
    ranked_by: Mapping[str, str],
    split: str | None,
    seed: int,
    progress: Reporter,
) -> Boards:
    """The boards of all tasks that the folder holds something of."""
    from relocbench.evaluation.common.folders import folders_with
    from relocbench.leaderboard.boards import Boards
    from relocbench.leaderboard.common.by_query import load_board
    from relocbench.leaderboard.relocalization.board import RELOCALIZATION
    from relocbench.leaderboard.retrieval.board import RETRIEVAL
    from relocbench.leaderboard.tracking.load import load_results
    from relocbench.leaderboard.tracking.tables import ranking_metric
    from relocbench.leaderboard.tracking.write import compare

    asked: dict[str, Any] = {"split": split, "seed": seed, "datasets": lookup}
    retrievers = load_board(RETRIEVAL, results, metric=ranked_by["--retrieval-metric"], **asked)
    pipelines = load_board(RELOCALIZATION, results, metric=ranked_by["--relocalization-metric"], **asked)
    entries = None
    if (retrievers is None and pipelines is None) or folders_with("dataset.yaml", results):
        ranking_metric(ranked_by["--metric"])  # a mistyped metric is reported before anything is read
        entries = load_results(results, split, datasets=lookup)
    lookup.check_used()  # before anything is written
    board = None
    if entries is not None:
        board = compare(entries, metric=ranked_by["--metric"], split=split, seed=seed, reporter=progress)
    return Boards(board, retrievers, pipelines)


def _ranked_by(
    results: Path, metric: str | None, retrieval_metric: str | None, relocalization_metric: str | None
) -> dict[str, str]:
    """The metric that ranks for each option. Raises ConfigError for one that does not apply to what is there."""
    given = {"--metric": metric, "--retrieval-metric": retrieval_metric}
    given["--relocalization-metric"] = relocalization_metric
    _check_metrics_apply(results, given)
    return {option: name or _USUAL[option] for option, name in given.items()}


def _check_metrics_apply(results: Path, given: Mapping[str, str | None]) -> None:
    """Raise ConfigError if a metric is given for a task of which the folder holds no results, but some of others."""
    from relocbench.errors import ConfigError
    from relocbench.evaluation.common.folders import folders_with

    files = ("dataset.yaml", "retrieval.yaml", "relocalization.yaml")
    held = {option: bool(folders_with(file, results)) for option, file in zip(given, files, strict=True)}
    made_by = dict(zip(held, ("evaluate", "evaluate-retrieval", "evaluate-relocalization"), strict=True))
    for option, name in given.items():
        if name is not None and any(held.values()) and not held[option]:
            there = " and ".join(f"{made_by[other]} (for {other})" for other, is_there in held.items() if is_there)
            raise ConfigError(
                f"{option} ranks results of {made_by[option]}, of which there are none here, only of {there}", results
            )
