"""The body of the commands that evaluate methods, whatever the task."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import typer

from relocbench.cli.options import chosen

if TYPE_CHECKING:
    from relocbench.datasets.core.schema import Strict
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


Options = TypeVar("Options", bound="Strict")
Reported = TypeVar("Reported", bound=Report)


def run_evaluation(
    arguments: Mapping[str, Any],
    options: type[Options],
    evaluate: Callable[[Options, Reporter], Reported],
    show: Callable[[Reported, Reporter], None],
) -> None:
    """Evaluate, and print one JSON object, or tables, what crashed, and where the results are.

    Args:
        arguments: of the command, as ``locals()`` has them at its beginning.
        options: their type.
        show: prints the tables.
    """
    from relocbench.cli.configuration import merged
    from relocbench.cli.console import print_json, reporter

    quiet = arguments["quiet"]
    progress = reporter(quiet)
    report = evaluate(merged(options, arguments["config"], chosen(arguments)), progress)
    if arguments["json"]:
        print_json(report.to_dict(), report.counts())
    else:
        show(report, progress)
        for label, message in (*report.crashed, *getattr(report, "suspicions", ())):
            print(f"{label}: {message}", file=sys.stderr)
        if not quiet:
            print(f"results: {report.results}", file=sys.stderr)
    for _, message in report.left_out:
        print(f"error: {message}; the other methods ran", file=sys.stderr)
    if report.left_out:
        raise typer.Exit(2)
