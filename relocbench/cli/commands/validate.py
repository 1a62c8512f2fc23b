"""``relocbench validate``: every fault of a dataset, of predictions or of results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from relocbench.cli.options import Json, Quiet
from relocbench.errors import USER_ERROR

if TYPE_CHECKING:
    from relocbench.datasets.checks.faults import Findings
    from relocbench.progress import Reporter


def validate(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="PATH",
            help="A dataset, an edition or one of its tiers; a results folder, or one dataset or method in it; a "
            "prediction file, or a folder of them.",
            show_default=False,
        ),
    ],
    dataset: Annotated[
        Path | None,
        typer.Option("--dataset", "-d", metavar="FOLDER", help="Dataset that the predictions must belong to."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Skip decoding and hashing images.")] = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Find every fault of a dataset, results or predictions, with file and line; exit status 2 where there is one.

    Example: relocbench validate predictions/summer__winter__cam0.txt -d D
    """
    from relocbench.cli.console import print_json, reporter

    kind, found = _check(path, dataset, quick, reporter(quiet))
    found = found.by_place()
    if json:
        counts = {"faults": len(found.faults), "notes": len(found.notes)}
        print_json({"path": str(path), "kind": kind, "valid": not found.faults, **found.to_dict()}, counts)
    else:
        for finding in found.faults:
            print(finding)
        if not quiet:
            for finding in found.notes:
                print(f"note: {finding}")
        print(f"{path}: {found.count} ({kind})")
    if found.faults:
        raise typer.Exit(USER_ERROR)


def _check(path: Path, dataset: Path | None, quick: bool, reporter: Reporter) -> tuple[str, Findings]:
    """What ``path`` is, and what is wrong with it. Raises RelocbenchError where it is nothing of ours."""
    from relocbench.errors import PredictionError, RelocbenchError

    if not path.exists():
        raise RelocbenchError("no such file or folder; expected a dataset, results or predictions", path)
    from relocbench.datasets.checks.faults import Findings
    from relocbench.datasets.checks.validation import is_dataset_folder, validate_dataset
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.core.edition_folder import datasets_of
    from relocbench.datasets.cross_view import is_cross_view
    from relocbench.datasets.cross_view.checking import validate_cross_view
    from relocbench.evaluation.tracking.validation import validate_prediction_files
    from relocbench.leaderboard.validation import is_results_folder, validate_all_results

    against = Dataset(dataset) if dataset is not None else None
    if path.is_file():
        if path.suffix != ".txt":
            raise PredictionError("expected a prediction or pair file (.txt), or a folder", path)
        return "predictions" if against else "pair file", validate_prediction_files(path, against)
    if is_cross_view(path):
        if against is not None:
            raise RelocbenchError("is a dataset; --dataset is for predictions and results", path)
        return "cross-view set", validate_cross_view(path, reporter, quick=quick)
    if is_dataset_folder(path):
        if against is not None:
            raise RelocbenchError("is a dataset; --dataset is for predictions and results", path)
        return "dataset", validate_dataset(path, reporter, quick=quick)
    districts = [folder for folder in datasets_of(path) if folder != path]
    if districts:
        return "edition", Findings.joined(validate_dataset(folder, reporter, quick=quick) for folder in districts)
    if is_results_folder(path):
        return "results", validate_all_results(path, against, reporter)
    if any(path.glob("*.txt")):
        return "predictions", validate_prediction_files(path, against)
    raise RelocbenchError("neither a dataset, nor results, nor predictions (PAIRSET.txt)", path)
