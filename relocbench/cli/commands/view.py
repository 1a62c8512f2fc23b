"""``relocbench view``: a dataset and answers of methods in the viewer rerun, or one pair as a picture."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from relocbench.cli.options import Json, Quiet, split_commas

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.core.pair_set import PairSet
    from relocbench.evaluation.common.results import MethodResults
    from relocbench.progress import Reporter
    from relocbench.viewer.answers import MethodAnswers

_NEEDS_RERUN = (
    "needs the package 'rerun-sdk', which is not installed here (the extra 'viewer' brings it); "
    "--pair draws one pair without it"
)


def view(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of the dataset.", show_default=False)],
    results: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Results folder of evaluate: show the answers of its methods too."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="File to write: .rrd for rerun, with --pair a picture in PNG [default: the dataset's name].",
        ),
    ] = None,
    pair_set: Annotated[
        list[str], typer.Option(metavar="NAME,...", callback=split_commas, help="Show only these pair sets.")
    ] = [],  # noqa: B006
    methods: Annotated[
        list[str],
        typer.Option(
            "--method",
            "-m",
            metavar="NAME,...",
            callback=split_commas,
            help="Show only these methods of --results.",
        ),
    ] = [],  # noqa: B006
    every: Annotated[int, typer.Option(min=1, metavar="N", help="Show only every N-th pair of a set.")] = 1,
    pairs: Annotated[
        int, typer.Option(min=0, metavar="N", help="Most pairs of a set, spread along the drive; 0 for all.")
    ] = 100,
    points: Annotated[int, typer.Option(min=0, metavar="N", help="Most points of a keyframe.")] = 10000,
    pair: Annotated[
        tuple[int, int] | None,
        typer.Option(metavar="REF_TS QUERY_TS", help="Draw the pair with these times as a picture instead."),
    ] = None,
    pair_index: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="N", help="Draw the pair at this place of --pair-set, from 0, as a picture instead."
        ),
    ] = None,
    open_: Annotated[
        bool, typer.Option("--open", help="Open what was written in rerun, until its window is closed.")
    ] = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Show a dataset and what methods answered: cameras, keyframes in 3-D, true and estimated poses, errors over time.

    Writes a recording for the viewer rerun; with --pair or --pair-index, a picture of one pair, which needs no rerun.

    Example: relocbench view D --results results --out D.rrd --open

    Example: relocbench view D --pair 1600000000 1600000100 --results results --method dso --out pair.png
    """
    from relocbench.cli.console import reporter
    from relocbench.errors import ConfigError

    if pair is not None and pair_index is not None:
        raise ConfigError("--pair and --pair-index name one pair in two ways; give one of them")
    if methods and results is None:
        raise ConfigError("--method chooses among the methods of --results, which is not given")
    opened = _opened(dataset)
    if pair is not None or pair_index is not None:
        if open_:
            raise ConfigError("--open shows recordings for rerun; --pair draws a picture")
        _draw_pair(opened, results, out, pair_set, methods, pair, pair_index, json=json, quiet=quiet)
    else:
        chosen = {"every": every, "limit": pairs, "points": points}
        _write(opened, results, out, pair_set, methods, chosen, reporter(quiet), json=json, quiet=quiet)
        if open_:
            target = out or Path(f"{opened.name}.rrd")
            raise typer.Exit(subprocess.run([sys.executable, "-m", "rerun", target], check=False).returncode)


def _opened(folder: Path) -> Dataset:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.cross_view import is_cross_view
    from relocbench.errors import DatasetError

    if is_cross_view(folder):
        raise DatasetError("holds places with labels and no pairs; view shows pairs", folder)
    return Dataset(folder)


def _write(
    dataset: Dataset,
    results: Path | None,
    out: Path | None,
    pair_set: list[str],
    methods: list[str],
    chosen: dict[str, int],
    reporter: Reporter,
    *,
    json: bool,
    quiet: bool,
) -> None:
    """Write the recording."""
    from relocbench.cli.console import print_json
    from relocbench.errors import ConfigError
    from relocbench.viewer.choice import chosen_pairs, chosen_sets

    try:
        from relocbench.viewer.recording import write_recording
    except ModuleNotFoundError as bad:
        if (bad.name or "").split(".")[0] != "rerun":
            raise
        raise ConfigError(_NEEDS_RERUN) from None
    target = _target(out or Path(f"{dataset.name}.rrd"), ".rrd", dataset)
    sets = chosen_sets(dataset, pair_set)
    found = _methods(results, dataset, methods)
    answers = {method.label: _answers(dataset, sets, method, reporter) for method in found}
    shown = chosen_pairs(sets, chosen["every"], chosen["limit"])
    of = sum(len(s.evaluated) for s in sets)
    if len(shown) < of:
        reporter.note(f"{len(shown)} of {of} pairs are shown; --pairs 0 and --every 1 show all")
    written = write_recording(dataset, shown, answers, target, points=chosen["points"], reporter=reporter)
    for camera in written.undistorted:
        reporter.note(f"camera {camera} has distortion: its images are shown undistorted")
    if written.without_pose:
        reporter.note(f"{written.without_pose} pairs have no place in 3-D: their traversal has no pose of the keyframe")
    if json:
        counts = {name: value for name, value in asdict(written).items() if isinstance(value, int)}
        counts |= {"pairs_left_out": of - len(shown), "files_written": 1}
        print_json({"file": str(target), "undistorted": written.undistorted}, counts)
    elif not quiet:
        size = f"{written.bytes / 1e6:.1f} MB"
        held = f"{written.pairs} pairs, {written.images} images, {written.methods} methods"
        typer.echo(f"written: {target} ({size}: {held}); look at it: rerun {target}", err=True)


def _draw_pair(
    dataset: Dataset,
    results: Path | None,
    out: Path | None,
    pair_set: list[str],
    methods: list[str],
    pair: tuple[int, int] | None,
    pair_index: int | None,
    *,
    json: bool,
    quiet: bool,
) -> None:
    """Draw one pair."""
    from relocbench.cli.console import print_json
    from relocbench.errors import ConfigError, PredictionError
    from relocbench.files import write_bytes
    from relocbench.viewer.answers import answers_to
    from relocbench.viewer.choice import chosen_sets, nth_pair, one_pair
    from relocbench.viewer.pair_picture import draw_pair, numbers

    sets = chosen_sets(dataset, pair_set)
    of_set, chosen = nth_pair(sets, pair_index) if pair is None else one_pair(sets, pair)  # type: ignore[arg-type]
    dataset.require_images([of_set], "there is no picture to draw; without --pair and --pair-index, poses are shown")
    target = _target(
        out or Path(f"{of_set.name}_{chosen.ref_timestamp_ns}_{chosen.query_timestamp_ns}.png"), ".png", dataset
    )
    found = _methods(results, dataset, methods)
    if len(found) > 1:
        there = ", ".join(method.label for method in found)
        raise ConfigError(f"a picture shows one method; choose it by --method from {there}")
    answer = None
    if found:
        answers = answers_to(dataset, of_set, found[0])
        if answers is None:
            raise PredictionError(f"holds no predictions for {of_set.name}", found[0].root)
        answer = answers[chosen.key]
    name = found[0].label if found else None
    write_bytes(target, draw_pair(dataset, of_set, chosen, name, answer))
    if json:
        values = numbers(dataset, of_set, chosen, name, answer)
        print_json({"file": str(target), **values}, {"files_written": 1, "pairs": 1})
    elif not quiet:
        typer.echo(f"written: {target}", err=True)


def _target(out: Path, suffix: str, dataset: Dataset) -> Path:
    """The file to write. Raises ConfigError for another suffix, or a place within the dataset."""
    from relocbench.errors import ConfigError
    from relocbench.evaluation.common.opening import check_outside

    if out.suffix.lower() != suffix:
        raise ConfigError(f"--out is a file whose name ends in {suffix}", out)
    check_outside(out, dataset.root)
    return out


def _methods(results: Path | None, dataset: Dataset, names: list[str]) -> list[MethodResults]:
    from relocbench.viewer.answers import chosen_methods, results_of

    return [] if results is None else chosen_methods(results_of(results, dataset), names)


def _answers(
    dataset: Dataset, sets: list[PairSet], method: MethodResults, reporter: Reporter
) -> dict[str, MethodAnswers]:
    """A method's answers by pair set; sets without a complete run are left out, with a note."""
    from relocbench.viewer.answers import answers_to

    found = {s.name: answers_to(dataset, s, method) for s in sets}
    missing = [name for name, answers in found.items() if answers is None]
    if missing:
        reporter.note(f"{method.label} has no predictions for {', '.join(missing)}")
    return {name: answers for name, answers in found.items() if answers is not None}
