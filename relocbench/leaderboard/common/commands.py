"""The commands on a page that run its methods again and make the page again."""

from __future__ import annotations

import shlex

from relocbench.evaluation.common.results import PREDICTIONS, RunRecord
from relocbench.evaluation.common.runs import labelled_target, settings_of
from relocbench.evaluation.tracking.trivial import CLOCK
from relocbench.evaluation.tracking.trivial import TARGET as CLOCK_TARGET


def page_command(option: str, metric: str, seed: int, split: str | None, datasets: str = "") -> str:
    """The command that makes a page again.

    Args:
        option: the one that chooses the metric.
        datasets: what stands for the datasets that errors are computed anew from; empty where none were available.
    """
    dataset = f" --dataset {datasets}" if datasets else ""
    of_split = f" --split {shlex.quote(split)}" if split else ""
    return f"relocbench leaderboard RESULTS --out DIR{dataset} {option} '{metric}' --seed {seed}{of_split}"


def method_words(run: RunRecord) -> list[str]:
    """The options of ``relocbench evaluate`` for a method as it was run, or for the predictions that were imported."""
    if run.target.startswith(PREDICTIONS):
        return ["--method", run.method, "--predictions", run.target.removeprefix(PREDICTIONS)]
    if run.target == CLOCK_TARGET:
        return ["--method", CLOCK]
    words = ["--method", labelled_target(run.method, run)]
    words += [word for setting in settings_of(run.method, run) for word in ("--set", setting)]
    return [*words, "--seed", str(run.seed)] if run.seed else words
