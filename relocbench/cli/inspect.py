"""``relocbench inspect``: what is in a dataset, and pictures to check its truth by eye."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from relocbench.cli.options import Json, Quiet

if TYPE_CHECKING:
    from relocbench.datasets.dataset import Dataset
    from relocbench.datasets.inspection import PairSetInventory, Spread
    from relocbench.datasets.overlay import Picture


def inspect(
    dataset: Annotated[Path, typer.Argument(help="Folder of the dataset.", show_default=False)],
    pictures: Annotated[
        Path | None, typer.Option(help="Write pictures of pairs to this folder: is the ground truth right?")
    ] = None,
    ground_truth: Annotated[
        Path | None,
        typer.Option(help="Write a page about the ground truth from lidar to this folder: clouds, residuals, a map."),
    ] = None,
    pairs: Annotated[int, typer.Option(min=1, help="Pictures a pair set, spread along the drive.")] = 6,
    pair_set: Annotated[list[str], typer.Option(help="Only this pair set. Repeat for several.")] = [],  # noqa: B006
    seed: Annotated[int, typer.Option(min=0, help="Seed of the points that are drawn.")] = 0,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Say what is in a dataset; with --pictures, draw pairs so that a person can check the ground truth.

    With --ground-truth, a page shows how drives were laid together by lidar: both clouds from above, residuals, and
    where and why pairs were rejected.

    Example: relocbench inspect D --pictures check

    Example: relocbench inspect D --ground-truth check
    """
    from relocbench.cli.console import print_json, reporter
    from relocbench.datasets.cross_view import is_cross_view
    from relocbench.datasets.dataset import Dataset
    from relocbench.datasets.inspection import take_inventory
    from relocbench.files import alone_writing_to

    if is_cross_view(dataset):
        _inspect_places(dataset, [pictures, ground_truth, *pair_set], json)
        return
    opened = Dataset(dataset)
    chosen = [opened.pair_set(name) for name in pair_set] or opened.pair_sets()
    drawn: list[Picture] = []
    if not json:
        print_summary(opened)
    if pictures is not None:
        from relocbench.datasets.overlay import write_pictures

        with alone_writing_to(pictures):
            drawn = write_pictures(opened, chosen, pictures, pairs, seed, reporter(quiet))
    page: Path | None = None
    if ground_truth is not None:
        from relocbench.datasets.groundtruth.pictures import write_ground_truth

        with alone_writing_to(ground_truth):
            page = write_ground_truth(opened, chosen, ground_truth, pairs, seed, reporter(quiet))
    if json:
        print_json({**take_inventory(opened).to_dict(), "pictures": [p.to_dict() for p in drawn]})
    elif pictures is not None:
        _print_pictures(drawn, pictures)
    if page is not None and not json:
        print(f"the ground truth to look at: {page}")


def _inspect_places(folder: Path, options: list[object], json: bool) -> None:
    """What is in a cross-view set, which has no pairs to draw."""
    from relocbench.cli.build_dataset import print_places
    from relocbench.cli.console import print_json
    from relocbench.datasets.cross_view import open_cross_view
    from relocbench.errors import ConfigError

    if any(option is not None for option in options):
        raise ConfigError("holds places with labels; --pictures, --ground-truth and --pair-set are for pairs", folder)
    opened = open_cross_view(folder)
    if not json:
        print_places(opened)
        return
    folders = [asdict(one) for one in opened.inventory()]
    print_json(
        {"name": opened.name, "fingerprint": opened.fingerprint, "folders": folders, "notes": list(opened.notes)}
    )


def print_summary(dataset: Dataset) -> None:
    """The tables of ``relocbench inspect``."""
    from relocbench.cli.console import print_table
    from relocbench.datasets.fingerprint import SHORT
    from relocbench.datasets.groundtruth.reasons import by_kind, common
    from relocbench.datasets.inspection import take_inventory

    found = take_inventory(dataset)
    print(f"{found.name}: {dataset.root}")
    print(f"licence {found.licence}, fingerprint {found.fingerprint[:SHORT]}, made by {found.made_by.get('kind', '?')}")
    print_table(
        "Traversals",
        ["name", "condition", "location", "cameras", "images", "keyframes", "poses", "length m"],
        [
            [
                t.name,
                t.condition,
                t.location,
                ", ".join(f"{name} ({what})" for name, what in t.cameras.items()),
                str(t.images),
                str(t.keyframes),
                str(t.poses),
                f"{t.length_m:.1f}",
            ]
            for t in found.traversals
        ],
    )
    print_table(
        "Pair sets",
        [
            "name",
            "conditions",
            "pairs",
            "groups",
            "distance m\nmin / median / max",
            "angle deg\nmedian / max",
            "overlap\nmin / median",
            "sigma\nm / deg",
            "rejected",
        ],
        [_pair_set_row(s) for s in found.pair_sets],
    )
    for pair_set in found.pair_sets:
        for same in by_kind(Counter(pair_set.rejected).elements()).values():
            print(f"{pair_set.name}: {len(same)} rejected: {common(same)}")
    if found.splits:
        print_table("Splits", ["name", "pair sets"], [[name, ", ".join(sets)] for name, sets in found.splits.items()])


def _pair_set_row(s: PairSetInventory) -> list[str]:
    same = s.reference_condition == s.query_condition
    return [
        s.name,
        s.reference_condition if same else f"{s.reference_condition} → {s.query_condition}",
        str(s.pairs) if s.has_truth else f"{s.pairs} (withheld)",
        ", ".join(f"{group} {count}" for group, count in s.groups.items()),
        _cell(s.distance_m, "least", "median", "greatest", digits=2),
        _cell(s.angle_deg, "median", "greatest", digits=1),
        _cell(s.overlap, "least", "median", digits=2),
        f"{_cell(s.sigma_translation_m, 'median', digits=3)} / {_cell(s.sigma_rotation_deg, 'median', digits=3)}",
        str(sum(s.rejected.values())),
    ]


def _cell(spread: Spread | None, *names: str, digits: int) -> str:
    return "–" if spread is None else " / ".join(f"{getattr(spread, name):.{digits}f}" for name in names)


def _print_pictures(pictures: list[Picture], folder: Path) -> None:
    from relocbench.cli.console import print_table

    rows = [
        [p.file, f"{p.difference:.1f}", f"{p.difference_turned:.1f}", "yes" if p.truth_is_best else "NO"]
        for p in pictures
    ]
    columns = ["picture", "grey levels differ by", "turned a little", "lowest at the truth"]
    print_table(f"Pictures in {folder}", columns, rows)
