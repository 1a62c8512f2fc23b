"""``relocbench demo``: the whole line on a small dataset rendered on the spot, and what it shows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from relocbench.cli.options import Json, Quiet, Workers

if TYPE_CHECKING:
    from relocbench.progress import Reporter

_METHODS = ("identity", "dso", "orb-pnp", "gn-net")
_FETCHED = "aliked-pnp"
"""runs too where the weights that its authors publish are installed"""
_STREET: dict[str, Any] = {
    "name": "demo",
    "conditions": ("Sunny", "Rain", "Snow", "Night"),
    "size": "320x240",
    "steps": 48,
    "correspondences": 0,
}
"""A street small enough for a minute or two and long enough for ranks, for which 32 pairs a drive are too few; nothing
here measures matching quality, so nothing reads correspondences. docs/images/demo.png and demo.txt are of this street.

The preset ``demo`` differs and stays as it is: the published leaderboard has a dataset that is made by it.
"""
PICTURE = "demo.png"


def demo(
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FOLDER", help="Folder for dataset, results and leaderboard.")
    ] = Path("relocbench-demo"),
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the town.")] = 0,
    workers: Workers = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Render a street in four conditions, run trackers on it and show which finds the camera in which.

    The map is a drive in sunshine; the queries are of the same street in the sun, in rain, in snow and at night. A
    table of the shares found is printed, and a picture and the leaderboard's pages are written.

    Example: relocbench demo --out demo
    """
    from relocbench.cli.boards import print_matrix
    from relocbench.cli.console import print_json, reporter
    from relocbench.datasets.importers import importer
    from relocbench.evaluation.common.opening import check_in_no_dataset
    from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
    from relocbench.execution import Run, default_workers
    from relocbench.files import locked_output
    from relocbench.leaderboard import write_leaderboard
    from relocbench.leaderboard.boards import Boards
    from relocbench.leaderboard.html.site import write_site
    from relocbench.leaderboard.tracking.by_condition import by_condition
    from relocbench.leaderboard.tracking.condition_picture import write_condition_picture

    check_in_no_dataset(out)
    report = reporter(quiet)
    with locked_output(out):
        _check_own(out)
        town = importer("synthetic")
        options = town.Options.model_validate({**_STREET, "seed": seed})
        dataset = town.build([], options, out / "dataset", report, Run(workers or default_workers()))
        evaluated = evaluate_methods(
            EvaluateOptions(dataset=dataset.root, methods=_able(report), out=out / "results", workers=workers), report
        )
        board = write_leaderboard(out / "results", out / "leaderboard", reporter=report)
        (of_street,) = (each for each in board.datasets if each.entry.record.fingerprint == dataset.fingerprint)
        found = by_condition([of_street])
        write_condition_picture(found, dataset, out / PICTURE)
        page = write_site(Boards(board, None, None), out / "leaderboard" / "html", reporter=report)
    if json:
        places = {"dataset": dataset.root, "results": out / "results", "leaderboard": out / "leaderboard"}
        print_json({**places, "picture": out / PICTURE, "page": page}, evaluated.counts())
        return
    print_matrix(found.usual, "demo")
    typer.echo(f"picture: {out / PICTURE}")
    typer.echo(f"page: {page}")


def _check_own(out: Path) -> None:
    """Refuse a folder that holds anything but what an earlier demo, finished or not, has left. Raises ConfigError."""
    from relocbench.errors import ConfigError

    if not out.is_dir() or (out / "dataset" / "build.yaml").is_file():
        return
    found = next((path.name for path in sorted(out.iterdir()) if not path.name.startswith(".")), None)
    if found is not None:
        raise ConfigError(f"holds '{found}' and no earlier demo; expected a new or an empty folder for --out", out)


def _able(report: Reporter) -> tuple[str, ...]:
    """The trackers that can run here; what keeps others from it is reported."""
    from relocbench.errors import MethodError
    from relocbench.methods import parse_method
    from relocbench.methods.fetching import published_files

    able = []
    for name in (*_METHODS, _FETCHED):
        try:
            parse_method(name)
            missing = name == _FETCHED and not all(path.is_file() for path in published_files(parse_method(name)))
        except MethodError as why:
            report.note(f"{name} is left out: {why}")
            continue
        if missing:
            report.note(
                f"{name} is left out, as its weights are not here; to get them: relocbench fetch-weights {name}"
            )
        else:
            able.append(name)
    return tuple(able)
