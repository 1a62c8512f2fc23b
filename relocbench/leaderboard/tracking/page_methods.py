"""The page's section on the methods: parameters, versions, machines, and the commands that run them again."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from relocbench.evaluation.common.results import PREDICTIONS
from relocbench.leaderboard.common.commands import RESUMES, again_section
from relocbench.leaderboard.common.text import bullet, code, escaped, json_text, table_text
from relocbench.leaderboard.tracking.load import Method, evaluate_command
from relocbench.leaderboard.tracking.model import Board, DatasetBoard


def methods_section(dataset: DatasetBoard) -> list[str]:
    """A table of all methods with version, seed and machine, and the parameters in which runs of one method differ."""
    methods = dataset.entry.methods
    rows = [
        [
            escaped(m.label),
            code(m.run.target),
            escaped(m.run.versions.get("method", "")),
            escaped(m.run.versions.get("relocbench", "")),
            "" if m.seed is None else str(m.seed),
            escaped(m.machine) or "not recorded",
        ]
        for m in methods
    ]
    return [
        "### Methods",
        table_text(["method", "what it is", "version", "relocbench", "seed", "machine of the seconds"], rows, left=6),
        *_machine_notes(methods),
        bullet("Parameters:", [f"{code(m.label)}: {code(json_text(m.settings))}" for m in methods if m.settings]),
        *_differences(methods),
    ]


def reproduce_section(board: Board) -> list[str]:
    """The commands that reproduce the page."""
    intro = (
        "`DATASET` is a folder whose `dataset.yaml` has the fingerprint above (`relocbench validate DATASET` checks "
        f"it), `RESULTS` a folder for the results. {RESUMES}"
    )
    commands = [
        (d.entry.title, [evaluate_command(m.run, matching=bool(m.matching)) for m in d.entry.methods])
        for d in board.datasets
    ]
    split = f" --split {shlex.quote(board.split)}" if board.split else ""
    page = f"relocbench leaderboard RESULTS --out DIR --metric '{board.metric.name}' --seed {board.seed}{split}"
    return again_section(intro, commands, page)


def _machine_notes(methods: Sequence[Method]) -> list[str]:
    notes = []
    if any(m.run.target.startswith(PREDICTIONS) for m in methods):
        notes.append("Seconds of predictions that were made elsewhere are what their authors say.")
    if len({m.machine for m in methods if m.machine}) > 1:
        notes.append("The methods ran on different machines or loads: their seconds are not comparable.")
    return notes


def _differences(methods: Sequence[Method]) -> list[str]:
    """For each target that was run several times, a table of the parameters that differ."""
    parts = []
    for target in dict.fromkeys(m.run.target for m in methods):
        runs = [m for m in methods if m.run.target == target]
        names = list(dict.fromkeys(name for m in runs for name in m.run.parameters))
        differing = [n for n in names if len({json_text(m.run.parameters.get(n)) for m in runs}) > 1]
        if differing:
            rows = [[escaped(m.label), *(code(json_text(m.run.parameters.get(n))) for n in differing)] for m in runs]
            parts += [f"Runs of {code(target)} differ in:", table_text(["method", *map(code, differing)], rows, left=1)]
    return parts
