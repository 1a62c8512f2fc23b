"""``relocbench inspect``: what is in a dataset, and pictures to check its truth by eye."""

from __future__ import annotations

from dataclasses import asdict
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from relocbench.cli.options import Json, Quiet, existing, split_commas

if TYPE_CHECKING:
    from relocbench.datasets.inspect.clock import DriveClock
    from relocbench.datasets.inspect.overlay import Picture


def inspect(
    dataset: Annotated[
        Path,
        typer.Argument(
            metavar="DATASET",
            callback=existing,
            help="Folder of the dataset, or a bag of ROS.",
            show_default=False,
        ),
    ],
    pictures: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Draw pairs into this folder: is the ground truth right?")
    ] = None,
    ground_truth: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Write a page about the ground truth from lidar into this folder: clouds, residuals, a map.",
        ),
    ] = None,
    pairs: Annotated[
        int, typer.Option(min=1, metavar="N", help="Pictures of each pair set, spread along the drive.")
    ] = 6,
    pair_set: Annotated[
        list[str], typer.Option(metavar="NAME,...", callback=split_commas, help="Draw only these pair sets.")
    ] = [],  # noqa: B006
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the points that are drawn.")] = 0,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Say what is in a dataset; with --pictures, draw pairs so that a person can check the ground truth.

    With --ground-truth, a page shows how drives were registered by lidar: both clouds from above, residuals, and
    where and why pairs were rejected.

    Of a bag of ROS, the topics are listed with what build-dataset would use each for.

    Example: relocbench inspect D --pictures check

    Example: relocbench inspect D --ground-truth check
    """
    from relocbench.cli.console import print_json, reporter
    from relocbench.cli.counts import of_dataset
    from relocbench.cli.summaries import print_summary
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.cross_view import is_cross_view
    from relocbench.datasets.importers.rosbag.bag import is_recording
    from relocbench.datasets.inspect.summary import take_inventory
    from relocbench.evaluation.common.opening import check_outside
    from relocbench.files import locked_output

    if is_recording(dataset):
        _inspect_bag(dataset, [pictures, ground_truth, *pair_set], json)
        return
    if is_cross_view(dataset):
        _inspect_places(dataset, [pictures, ground_truth, *pair_set], json)
        return
    opened = Dataset(dataset)
    for option, folder in (("--pictures", pictures), ("--ground-truth", ground_truth)):
        if folder is not None:
            check_outside(folder, dataset, option)
    chosen = [opened.pair_set(name) for name in pair_set] or opened.pair_sets()
    drawn: list[Picture] = []
    clocks: list[DriveClock] = []
    if not json:
        print_summary(opened)
    if pictures is not None:
        from relocbench.datasets.inspect.clock import check_clocks
        from relocbench.datasets.inspect.overlay import write_pictures

        with locked_output(pictures):
            drawn = write_pictures(opened, chosen, pictures, pairs, seed, reporter(quiet))
        clocks = check_clocks(opened, reporter(quiet))
    page: Path | None = None
    if ground_truth is not None:
        from relocbench.datasets.groundtruth.report.pictures import write_ground_truth

        with locked_output(ground_truth):
            page = write_ground_truth(opened, chosen, ground_truth, pairs, seed, reporter(quiet))
    if json:
        values = {**take_inventory(opened).to_dict(), "pictures": [p.to_dict() for p in drawn]}
        values["clocks"] = [one.to_dict() for one in clocks]
        counts = {**of_dataset(opened), "pictures": len(drawn), "pages": int(page is not None)}
        print_json({**values, "ground_truth": page}, counts)
    elif pictures is not None:
        _print_pictures(drawn, pictures)
        _print_residuals(drawn)
        _print_clocks(clocks)
    if page is not None and not json:
        print(f"the ground truth to look at: {page}")


def _inspect_bag(path: Path, options: list[object], json: bool) -> None:
    """The topics of a bag of ROS, with what each would be used for."""
    from relocbench.cli.console import print_json, print_table
    from relocbench.datasets.importers.rosbag.bag import parts_of
    from relocbench.datasets.importers.rosbag.recording import remarks
    from relocbench.datasets.importers.rosbag.roles import TABLE, table, tried
    from relocbench.datasets.importers.rosbag.survey import survey
    from relocbench.errors import ConfigError

    if any(option is not None for option in options):
        raise ConfigError("is a recording; --pictures, --ground-truth and --pair-set are for datasets", path)
    found = survey(path, parts_of(path))
    for remark in remarks(found):
        typer.echo(f"note: {remark}", err=True)
    roles, undecided = tried(found)
    rows = table(found, roles)
    if json:
        names = ("topic", "type", "messages", "rate_hz", "role", "why")
        topics = [dict(zip(names, (*row[:2], int(row[2]), float(row[3]), *row[4:]), strict=True)) for row in rows]
        print_json({"recording": path, "topics": topics, "undecided": undecided}, {"topics": len(rows)})
        return
    print_table(f"Topics of {path}", list(TABLE), rows)
    if undecided:
        typer.echo(f"build-dataset rosbag needs a decision: {undecided}", err=True)


def _inspect_places(folder: Path, options: list[object], json: bool) -> None:
    """What is in a cross-view set, which has no pairs to draw."""
    from relocbench.cli.console import print_json
    from relocbench.cli.counts import of_places
    from relocbench.cli.summaries import print_places
    from relocbench.datasets.cross_view import open_cross_view
    from relocbench.errors import ConfigError

    if any(option is not None for option in options):
        raise ConfigError("holds places with labels; --pictures, --ground-truth and --pair-set are for pairs", folder)
    opened = open_cross_view(folder)
    if not json:
        print_places(opened)
        return
    folders = [asdict(one) for one in opened.inventory()]
    values = {"name": opened.name, "fingerprint": opened.fingerprint, "folders": folders, "notes": list(opened.notes)}
    print_json(values, of_places(opened))


def _print_pictures(pictures: list[Picture], folder: Path) -> None:
    from relocbench.cli.console import print_table

    rows = [
        [
            p.file,
            _px(p.agreement.shift_px),
            f"{p.agreement.measured} of {p.agreement.regions}",
            p.agreement.verdict,
        ]
        for p in pictures
    ]
    columns = ["picture", "edges apart, px", "regions measured", "images at the true pose"]
    print_table(f"Pictures in {folder}", columns, rows)
    doubtful = [p for p in pictures if p.agreement.verdict in ("apart", "unseen")]
    if doubtful:
        typer.echo(f"check {len(doubtful)} of {len(pictures)} true poses by their pictures:", err=True)
    for p in doubtful:
        typer.echo(f"  {p.file}: {p.agreement.words}", err=True)


def _print_residuals(pictures: list[Picture]) -> None:
    """By how much true poses of pair sets differ from those that images and depth give by themselves."""
    from statistics import median

    for name in dict.fromkeys(p.pair_set for p in pictures):
        told = [(p.residual_deg, p.residual_mm) for p in pictures if p.pair_set == name]
        known = [(deg, mm) for deg, mm in told if deg is not None and mm is not None]
        if known:
            apart = f"{median(deg for deg, _ in known):.2f} deg and {median(mm for _, mm in known):.0f} mm"
            print(f"{name}: by images and depth alone, poses of {len(known)} of {len(told)} pairs differ by {apart}")


def _print_clocks(clocks: list[DriveClock]) -> None:
    """What images and poses of each drive say of each other, line by line."""
    for one in clocks:
        if one.built is not None and one.built.verdict != "cannot tell":
            how = f": {one.built.how}" if one.built.how else ""
            print(f"{one.traversal}: built with an offset of {1000 * one.built.applied_s:+.0f} ms{how}")
        left = f"; {one.check.left}" if one.check.left else ""
        print(f"{one.traversal}: {one.check.words}{left}")


def _px(pixels: float) -> str:
    return "" if isnan(pixels) else f"{pixels:.1f}"
