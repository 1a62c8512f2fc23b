"""``relocbench check-method``: does a method keep the contract?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from relocbench.cli.options import Json, Settings


def check_method(
    method: Annotated[str, typer.Argument(help="As for evaluate --method.")],
    settings: Settings = [],  # noqa: B006
    dataset: Annotated[
        Path | None,
        typer.Option("--dataset", "-d", help="Try it on pairs or images of this dataset too [default: made-up views]."),
    ] = None,
    json: Json = False,
) -> None:
    """Try a tracker on a few pairs or a retriever on a few images, and say whether it keeps the contract.

    Example: relocbench check-method mypackage.trackers:MyTracker
    """
    from relocbench.cli.console import print_json, print_table
    from relocbench.evaluation.check import check
    from relocbench.evaluation.retrieval.check import check_retriever
    from relocbench.methods import RETRIEVERS, kind_of, parse_method, target_of

    kind = kind_of(target_of(method))
    spec = parse_method(method, settings, kind=kind)
    findings = check_retriever(spec, dataset) if kind is RETRIEVERS else check(spec, dataset)
    if json:
        print_json([{"check": f.check, "passed": f.passed, "detail": f.detail} for f in findings])
    else:
        rows = [[f.check, "ok" if f.passed else "BROKEN", f.detail] for f in findings]
        print_table("", ["check", "", "detail"], rows)
    if not all(f.passed for f in findings):
        raise typer.Exit(2)
