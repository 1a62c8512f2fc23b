"""The body of the commands that evaluate methods, whatever the task."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import typer

from relocbench.cli.options import chosen

if TYPE_CHECKING:
    from relocbench.evaluation.common.options import EvaluationOptions
    from relocbench.progress import Reporter


class Report(Protocol):
    """What was evaluated."""

    @property
    def results(self) -> Path: ...

    @property
    def crashed(self) -> list[tuple[str, str]]:
        """Label of each method that crashed, and a message."""
        ...

    @property
    def left_out(self) -> list[tuple[str, str]]:
        """Label of each method that could not be made, and a message."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain values."""
        ...

    def counts(self) -> dict[str, int]:
        """What ``--json`` counts."""
        ...


Options = TypeVar("Options", bound="EvaluationOptions")
Reported = TypeVar("Reported", bound=Report)


def run_evaluation(
    arguments: Mapping[str, Any],
    options: type[Options],
    evaluate: Callable[[Options, Reporter], Reported],
    show: Callable[[Reported, Reporter], None],
    show_together: Callable[[Sequence[Reported], Reporter], None] | None = None,
) -> None:
    """Evaluate on a dataset, or on each of an edition or of one of its tiers.

    Prints one JSON object, or tables, what crashed, and where the results are.

    Args:
        arguments: of the command, as ``locals()`` has them at its beginning.
        options: their type.
        show: prints the tables of a dataset.
        show_together: prints those of several instead, where there are some.
    """
    from relocbench.cli.configuration import merged
    from relocbench.cli.console import print_json, reporter
    from relocbench.datasets.core.edition_folder import datasets_of
    from relocbench.errors import ConfigError

    quiet = arguments["quiet"]
    progress = reporter(quiet)
    given = merged(options, arguments["config"], chosen(arguments))
    reports, datasets = [], datasets_of(given.dataset)
    if len(datasets) > 1 and getattr(given, "predictions", None) is not None:
        raise ConfigError(f"--predictions are of one dataset; name one of the {len(datasets)}, such as {datasets[0]}")
    for dataset in datasets:
        report = evaluate(given.model_copy(update={"dataset": dataset}), progress)
        reports.append(report)
        if not arguments["json"]:
            if len(datasets) == 1 or show_together is None:
                show(report, progress)
            for label, message in (*report.crashed, *getattr(report, "suspicions", ())):
                print(f"{label}: {message}", file=sys.stderr)
            if not quiet:
                print(f"results: {report.results}", file=sys.stderr)
    if len(datasets) > 1 and show_together is not None and not arguments["json"]:
        show_together(reports, progress)
    if arguments["json"] and len(reports) == 1:
        print_json(reports[0].to_dict(), reports[0].counts())
    elif arguments["json"]:
        counts = [report.counts() for report in reports]
        together = {
            name: sum(each.get(name, 0) for each in counts) for name in dict.fromkeys(n for c in counts for n in c)
        }
        print_json({"datasets": [report.to_dict() for report in reports]}, together)
    left_out = dict.fromkeys(message for report in reports for _, message in report.left_out)
    for message in left_out:
        print(f"error: {message}; the other methods ran", file=sys.stderr)
    if left_out:
        raise typer.Exit(2)
