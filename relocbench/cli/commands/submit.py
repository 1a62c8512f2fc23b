"""``relocbench submit-check`` and ``relocbench leaderboard add``: predictions that were made elsewhere, with a card."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from relocbench.cli.options import Json, Quiet

if TYPE_CHECKING:
    from relocbench.evaluation.submission.check import Checked
    from relocbench.evaluation.submission.contract import SubmissionOptions
    from relocbench.progress import Reporter

FAULTY = 1
"""exit status where a submission has faults; 2 is left to commands that could not look at it"""
_MOST_SHOWN = 100
"""faults of one file that are printed; --json has all"""

Datasets = Annotated[
    list[Path],
    typer.Option(
        "--dataset",
        "-d",
        metavar="FOLDER",
        help="Dataset that is answered; of answers to a blind export, the dataset it was made of, or the export "
        "itself. Repeat for several.",
        show_default=False,
    ),
]
BlindOnly = Annotated[
    bool, typer.Option("--blind-only", help="Refuse answers to a dataset whose times were available.")
]
Radius = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        min=0.0,
        help="Of a retriever along drives: distance within which an image is right [default: 25].",
    ),
]
SaltFile = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Of answers to a blind export, with the dataset that it was made of: the salt that it was made with.",
    ),
]


def submit_check(
    submission: Annotated[
        Path | None,
        typer.Argument(metavar="SUBMISSION", help="Folder with card.yaml and answers.", show_default=False),
    ] = None,
    dataset: Datasets = [],  # noqa: B006  typer copies it
    new: Annotated[
        Path | None, typer.Option("--new", metavar="FOLDER", help="Write a card to fill in to this folder, and end.")
    ] = None,
    blind_only: BlindOnly = False,
    radius: Radius = None,
    salt_file: SaltFile = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Find every fault of a submission, with file and line, and say what is in it; exit status 1 where there is one.

    A submission is a folder with card.yaml and, for each dataset, a folder with PAIRSET.txt files of nine columns, or,
    of a retriever, with TASK.txt files of lines 'query db'.

    Example: relocbench submit-check my-submission --dataset town
    """
    from relocbench.cli.console import print_json, reporter
    from relocbench.errors import ConfigError
    from relocbench.evaluation.submission.check import check_submission

    if new is not None:
        if submission is not None or dataset:
            raise ConfigError("--new writes a card and checks nothing; give it alone")
        card = _write_template(new)
        if json:
            print_json({"card": str(card)}, {"files_written": 1})
        else:
            print(card)
        return
    if submission is None:
        raise ConfigError("nothing to check: give the folder of a submission, or --new FOLDER for a card to fill in")
    progress = reporter(quiet)
    options = _options(submission, dataset, radius, salt_file, progress, blind_only=blind_only)
    checked = check_submission(submission, options, progress)
    if json:
        print_json(checked.to_dict(), _counts(checked))
    else:
        _print_checked(checked, quiet=quiet)
    if not checked.sound:
        raise typer.Exit(FAULTY)


def leaderboard_add(
    submission: Annotated[
        Path, typer.Argument(metavar="SUBMISSION", help="Folder with card.yaml and answers.", show_default=False)
    ],
    results: Annotated[Path, typer.Option("--results", metavar="FOLDER", help="Results folder that gets the row.")],
    dataset: Datasets = [],  # noqa: B006
    replace: Annotated[
        bool, typer.Option("--replace", help="Replace the row of an earlier submission of the same label.")
    ] = False,
    blind_only: BlindOnly = False,
    radius: Radius = None,
    salt_file: SaltFile = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Check a submission, score its answers and put them into a results folder as a row that was made elsewhere.

    Nothing is written where the check finds a fault. Each row appears whole or not at all, and a command that was
    stopped goes on when it is given again. A results folder called 'add' is given to leaderboard as ./add.

    Example: relocbench leaderboard add my-submission --results results --dataset town
    """
    from relocbench.cli.console import print_json, print_table, reporter
    from relocbench.evaluation.submission.add import add_submission
    from relocbench.evaluation.submission.check import check_submission

    progress = reporter(quiet)
    options = _options(submission, dataset, radius, salt_file, progress, blind_only=blind_only)
    checked = check_submission(submission, options, progress)
    if not checked.sound:
        if json:
            print_json({**checked.to_dict(), "rows": []}, {**_counts(checked), "rows": 0})
        else:
            _print_checked(checked, quiet=quiet)
        raise typer.Exit(FAULTY)
    added = add_submission(checked, results, options, progress, replace=replace)
    if json:
        rows = [{"folder": str(one.folder), "state": one.state, "remarks": one.remarks} for one in added]
        print_json({**checked.to_dict(), "rows": rows}, {**_counts(checked), "rows": len(rows)})
        return
    print_table("", ["row", ""], [[str(one.folder), one.state] for one in added])
    for one in added:
        for remark in one.remarks:
            print(f"odd: {one.folder.parent.name}: {remark}")
    if not quiet:
        typer.echo(f"to compare: relocbench leaderboard {results} --out FOLDER", err=True)


def _counts(checked: Checked) -> dict[str, int]:
    """Faults, notes and suspicions, and answers by what became of them."""
    found = {"faults": len(checked.found.faults), "notes": len(checked.found.notes)}
    answers = {
        name: sum(getattr(row, name) for row in checked.rows)
        for name in ("pairs", "answered", "missing", "unknown", "duplicate", "invalid")
    }
    return {**found, "suspicions": len(checked.suspicions), **answers}


def _options(
    submission: Path,
    dataset: list[Path],
    radius: float | None,
    salt_file: Path | None,
    progress: Reporter,
    *,
    blind_only: bool,
) -> SubmissionOptions:
    from relocbench.datasets.core.salt import read_salt
    from relocbench.errors import ConfigError
    from relocbench.evaluation.retrieval.opening import SetOptions
    from relocbench.evaluation.submission.contract import SubmissionOptions

    if not dataset:
        raise ConfigError("a submission is checked against what it answers: give --dataset FOLDER")
    if radius == 0:
        raise ConfigError("--radius is 0, expected metres")
    salt = None if salt_file is None else read_salt(salt_file, [*dataset, submission], progress)
    return SubmissionOptions(tuple(dataset), blind_only, SetOptions(radius_m=radius), salt)


def _write_template(folder: Path) -> Path:
    """Write a card to fill in; returns its path. Raises ConfigError where there is one already."""
    from relocbench.errors import ConfigError
    from relocbench.evaluation.submission.card import CARD, TEMPLATE
    from relocbench.files import write_text

    path = folder / CARD
    if path.exists() or path.is_symlink():
        raise ConfigError("exists already, and is not overwritten", path)
    write_text(path, TEMPLATE)
    return path


def _print_checked(checked: Checked, *, quiet: bool) -> None:
    from relocbench.cli.console import print_table
    from relocbench.errors import printable

    found = checked.found.by_place()
    shown: Counter[Path | None] = Counter()
    for fault in found.faults:
        shown[fault.path] += 1
        if shown[fault.path] <= _MOST_SHOWN:
            print(fault)
    for path, count in shown.items():
        if count > _MOST_SHOWN:
            print(f"{printable(str(path))}: {count - _MOST_SHOWN} more faults (--json has all)")
    if not quiet:
        for note in found.notes:
            print(f"note: {note}")
    for odd in checked.suspicions:
        print(f"odd: {odd}")
    if checked.rows:
        columns = ["dataset", "of", "pairs", "answered", "missing", "unknown", "twice", "unreadable"]
        rows = [
            [r.dataset, r.asked, *map(str, (r.pairs, r.answered, r.missing, r.unknown, r.duplicate, r.invalid))]
            for r in checked.rows
        ]
        print_table("answers", columns, rows)
    print(f"{checked.root}: {found.count}")
