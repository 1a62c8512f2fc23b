"""A dataset at work: what all steps of a build share, and work on many units."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from relocbench.datasets.core.build_options import DatasetOptions
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.execution import Run, run_units
from relocbench.progress import Reporter

Options = TypeVar("Options", bound=DatasetOptions, covariant=True)
Unit = TypeVar("Unit")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Build(Generic[Options]):
    """A dataset that is being written, by which options, whom to report to, and where work runs."""

    writer: DatasetWriter
    options: Options
    reporter: Reporter
    run: Run

    def work(self, title: str, step: Callable[[Unit], Result], units: Sequence[Unit]) -> list[Result]:
        """As the function of this name, where the build runs."""
        return work(title, step, units, self.run, self.reporter)


def work(
    title: str, step: Callable[[Unit], Result], units: Sequence[Unit], run: Run, reporter: Reporter
) -> list[Result]:
    """The results of ``step`` for all units, in their order, with a progress bar of this title."""
    results: dict[int, Result] = {}
    with reporter.stage(title, len(units)) as advance:
        for index, result in run_units(step, units, run):
            results[index] = result
            advance(1)
    return [results[index] for index in range(len(units))]
