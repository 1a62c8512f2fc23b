"""What a command prints of what it has made or opened: a dataset, a cross-view set, a folder of recordings."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.core.edition_folder import EditionFolder
    from relocbench.datasets.core.recording_folder import RecordingFolder
    from relocbench.datasets.cross_view import CrossViewSet
    from relocbench.datasets.inspect.summary import PairSetInventory, Spread


def print_summary(dataset: Dataset) -> None:
    """The tables of ``relocbench inspect``."""
    from relocbench.cli.console import print_table
    from relocbench.datasets.core.fingerprint import SHORT
    from relocbench.datasets.groundtruth.pairs.reasons import by_kind, common
    from relocbench.datasets.inspect.summary import take_inventory

    found = take_inventory(dataset)
    print(f"{found.name}: {dataset.root}")
    print(f"licence {found.licence}, fingerprint {found.fingerprint[:SHORT]}, made by {found.made_by.get('kind', '?')}")
    print_table(
        "Traversals",
        ["name", "condition", "images", "keyframes", "poses", "length m", "cameras", "location"],
        [
            [
                t.name,
                t.condition,
                str(t.images),
                str(t.keyframes),
                str(t.poses),
                f"{t.length_m:.1f}",
                ", ".join(f"{name} ({what})" for name, what in t.cameras.items()),
                t.location,
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
            "rejected",
            "overlap\nmin / median",
            "distance m\nmin / median / max",
            "angle deg\nmedian / max",
            "sigma\nm / deg",
            "tiers",
            "groups",
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
        f"{s.pairs}{f' + {s.elsewhere} negative' if s.elsewhere else ''}{'' if s.has_truth else ' (withheld)'}",
        str(sum(s.rejected.values())),
        _cell(s.overlap, "least", "median", digits=2),
        _cell(s.distance_m, "least", "median", "greatest", digits=2),
        _cell(s.angle_deg, "median", "greatest", digits=1),
        f"{_cell(s.sigma_translation_m, 'median', digits=3)} / {_cell(s.sigma_rotation_deg, 'median', digits=3)}",
        *(", ".join(f"{name} {count}" for name, count in of.items()) for of in (s.tiers, s.groups)),
    ]


def _cell(spread: Spread | None, *names: str, digits: int) -> str:
    return "–" if spread is None else " / ".join(f"{getattr(spread, name):.{digits}f}" for name in names)


def print_places(made: CrossViewSet) -> None:
    """What is in a cross-view set."""
    from relocbench.cli.console import print_table
    from relocbench.datasets.core.fingerprint import SHORT

    print(f"{made.name}: {made.root}, fingerprint {made.fingerprint[:SHORT]}")
    rows = [[f.folder, str(f.classes), str(f.images), f.conditions] for f in made.inventory()]
    print_table("Folders", ["folder", "classes", "images", "conditions"], rows)
    for note in made.notes:
        print(f"note: {note}")


def print_edition(edition: EditionFolder) -> None:
    """What was built of an edition, and whether it asks what everybody is asked."""
    from relocbench.cli.console import print_table

    file = edition.file
    rows = []
    for tier, pairs in edition.pairs.items():
        questions, expected = file.tiers[tier].questions, edition.expected.get(tier)
        same = "none published" if expected is None else "as published" if questions == expected else "NOT AS PUBLISHED"
        rows.append([tier, str(file.districts), str(pairs), questions[:12], same])
    print_table(f"{file.edition}, split {file.split}", ["tier", "districts", "pairs", "questions", ""], rows)
    for tier in edition.pairs:
        print(f"relocbench evaluate -d {edition.root / tier} -m METHOD")


def print_recording(recorded: RecordingFolder) -> None:
    """Which drives were recorded."""
    from relocbench.cli.console import print_table

    print(f"{len(recorded.drives)} drives recorded in the layout '{recorded.layout}': {recorded.root}")
    print_table(
        "Drives",
        ["name", "split", "condition", "route", "traversal", "images", "scans", "length m"],
        [
            [d.name, d.split, d.condition, d.route, str(d.traversal), str(d.images), str(d.scans), f"{d.length_m:.1f}"]
            for d in recorded.drives
        ],
    )
    print(f"which drive is which: {recorded.root / 'drives.csv'}; the exact truth: {recorded.root / 'truth'}")
