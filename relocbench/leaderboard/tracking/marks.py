"""What the records of runs say that readers of a table must know: marks on rows, and who takes part in ranks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from relocbench.evaluation.common.results import PREDICTIONS, RunRecord
from relocbench.evaluation.tracking.clock import TARGET as CLOCK_TARGET
from relocbench.leaderboard.tracking.method import Method


def is_ranked(method: Method) -> bool:
    """Whether a method takes part in ranks: neither trivial baselines do nor methods that are shown times."""
    return not (method.is_baseline or method.run.uses_times)


def made_elsewhere(run: RunRecord) -> bool:
    """Whether the predictions were made elsewhere and imported."""
    return run.made_elsewhere or run.target.startswith(PREDICTIONS)


def not_isolated(run: RunRecord) -> bool:
    """Whether a tracker may have seen the truth: it ran beside it, or nothing says that it did not."""
    return run.isolated is not True and not made_elsewhere(run) and run.target != CLOCK_TARGET


def not_rescored(method: Method) -> bool:
    """Whether the errors are those that the results folder claims."""
    return bool(method.errors) and not method.rescored


@dataclass(frozen=True)
class Mark:
    """A sign behind the names of methods, and what it says of them."""

    sign: str
    name: str
    words: str
    """Markdown of our own"""
    applies: Callable[[Method], bool]


MARKS = (
    Mark(
        "¹",
        "not isolated",
        "the method ran in the evaluator's own process (`--workers 0`), where the truth lies, or its "
        "record does not say where it ran",
        lambda method: not_isolated(method.run),
    ),
    Mark(
        "²",
        "made elsewhere",
        "the predictions were imported, and nobody here saw what made them or how long it took",
        lambda method: made_elsewhere(method.run),
    ),
    Mark(
        "³",
        "not rescored",
        "the dataset, or the answers that the numbers follow from, were unavailable: the errors are those that the "
        "results folder claims",
        not_rescored,
    ),
)


def signs(*methods: Method) -> list[str]:
    """The signs of the marks that apply to a method, or to any of several of one name, in their order."""
    return [mark.sign for mark in MARKS if any(map(mark.applies, methods))]
