"""``relocbench check-method``: does a method keep the contract?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from relocbench.cli.options import Json

if TYPE_CHECKING:
    from relocbench.evaluation.common.contract import Finding
    from relocbench.execution import Loss
    from relocbench.methods import MethodSpec


def check_method(
    method: Annotated[
        str, typer.Argument(metavar="METHOD", help="A method as --method of the evaluate commands takes it.")
    ],
    settings: Annotated[
        list[str],
        typer.Option("--set", metavar="KEY=VALUE", help="Parameter of the method. Repeat for several."),
    ] = [],  # noqa: B006
    dataset: Annotated[
        Path | None,
        typer.Option(
            "--dataset",
            "-d",
            metavar="FOLDER",
            help="Try it on pairs or images of this dataset too [default: made-up views].",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Try a tracker on a few pairs or a retriever on a few images, and say whether it keeps the contract.

    An answer that is confident about a black image or a different place keeps the contract, and is called doubtful.

    Example: relocbench check-method mypackage.trackers:MyTracker
    """
    from relocbench.cli.console import print_json, print_table
    from relocbench.execution import Run, run_limited
    from relocbench.methods import kind_of, parse_method, target_of

    spec = parse_method(method, settings, kind=kind_of(target_of(method)))
    # In a process of its own, as it is evaluated: what it does to it is a finding, and Ctrl-C ends it.
    asked = [(spec, dataset)]
    findings = next(f for _, f in run_limited(_checked, [asked], Run(), on_loss=_lost))
    if json:
        values = [{"check": f.check, "passed": f.passed, "doubtful": f.doubtful, "detail": f.detail} for f in findings]
        passed, doubtful = (sum(getattr(f, name) for f in findings) for name in ("passed", "doubtful"))
        counts = {"checks": len(findings), "passed": passed, "failed": len(findings) - passed, "doubtful": doubtful}
        print_json({"method": method, "task": spec.kind.task, "checks": values}, counts)
    else:
        words = {True: "ok", False: "BROKEN"}
        rows = [[f.check, "DOUBTFUL" if f.doubtful else words[f.passed], f.detail] for f in findings]
        print_table("", ["check", "", "detail"], rows)
    if not all(f.passed for f in findings):
        raise typer.Exit(2)


def _checked(asked: tuple[MethodSpec, Path | None]) -> list[Finding]:
    """Runs in a worker."""
    from relocbench.evaluation.retrieval.check import check_retriever
    from relocbench.evaluation.tracking.check import check
    from relocbench.methods import RETRIEVERS

    spec, dataset = asked
    return check_retriever(spec, dataset) if spec.kind == RETRIEVERS else check(spec, dataset)


def _lost(asked: tuple[MethodSpec, Path | None], loss: Loss) -> list[Finding]:
    from relocbench.evaluation.common.contract import Finding

    return [Finding("leaves its process alive", False, f"it ended ({loss.words})")]
