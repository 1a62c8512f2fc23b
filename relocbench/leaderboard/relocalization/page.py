"""``relocalization.md``: what a sceptical reader wants to know about pipelines, on one page."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence

from relocbench.evaluation.common.results import PREDICTIONS, RunRecord
from relocbench.evaluation.common.runs import labelled_target, settings_of
from relocbench.evaluation.relocalization.pipeline import RIGHT
from relocbench.evaluation.relocalization.records import KEYFRAME, ORACLE, PipelineRun
from relocbench.files import json_text
from relocbench.leaderboard.common.columns import texts
from relocbench.leaderboard.common.commands import page_command
from relocbench.leaderboard.common.model import about_ranks
from relocbench.leaderboard.common.over_datasets import over_sections
from relocbench.leaderboard.common.text import RETRIEVER, TRACKER, number
from relocbench.leaderboard.relocalization.board import (
    Pipeline,
    PipelineBoard,
    PipelineRow,
    PipelineSetBoard,
    PipelineTable,
    is_rescored,
)
from relocbench.leaderboard.relocalization.columns import lines_of, pipeline_columns, pose_columns, stage_columns
from relocbench.leaderboard.tracking.marks import MARKS, made_elsewhere, not_isolated
from relocbench.leaderboard.tracking.method import machine_words
from relocbench.metrics import LEVEL
from relocbench.metrics.pose.metric import SIGMA_FACTOR
from relocbench.pages import render
from relocbench.pages.markdown import escaped, table_text


def relocalization_page(board: PipelineBoard) -> str:
    """The whole page."""
    metres, degrees = RIGHT
    rescored = any(pipeline.rescored for asked in board.sets for pipeline in asked.methods)
    return render(
        __name__,
        "page.md.j2",
        metric=board.metric,
        level=f"{LEVEL:.0%}",
        oracle=ORACLE,
        keyframe=KEYFRAME,
        right=f"{metres:g} m and {degrees:g}°",
        number=number,
        marks=MARKS,
        over=over_sections(board.over),
        sets=[_set(board, asked) for asked in board.sets],
        commands=[(asked.title, evaluate_commands(asked.methods)) for asked in board.sets],
        page_command=page_command(
            "--relocalization-metric", board.metric, board.seed, board.split, "DATASET" if rescored else ""
        ),
    )


def evaluate_commands(pipelines: Sequence[Pipeline]) -> list[str]:
    """The commands that run or resume pipelines, one for all pipelines that can share it."""
    groups: dict[tuple[object, ...], list[Pipeline]] = {}
    for pipeline in pipelines:
        baseline = pipeline.run.tracker == KEYFRAME  # every command evaluates it
        tops = {c.run.top for c in pipelines if c.run.retriever == pipeline.run.retriever and c.run.tracker != KEYFRAME}
        if not baseline or not tops:
            groups.setdefault((pipeline.run.top, *_basin_words(pipeline)), []).append(pipeline)
    return [line for group in groups.values() for line in _commands(group)]


def _commands(pipelines: Sequence[Pipeline]) -> list[str]:
    """One command if methods of the same name are the same in all pipelines, otherwise one for each pipeline."""
    halves: dict[str, RunRecord | None] = {}
    for pipeline in pipelines:
        for name, half in _halves(pipeline.run):
            if name in halves and not _same(halves[name], half) and len(pipelines) > 1:
                return [line for each in pipelines for line in _commands([each])]
            halves[name] = half
    words = ["relocbench", "evaluate-relocalization", "--dataset", "DATASET", "--out", "RESULTS"]
    settings: list[str] = []
    seeds = {half.seed for half in halves.values() if half is not None and half.seed}
    for option, names in (
        ("--retriever", dict.fromkeys(c.run.retriever for c in pipelines)),
        ("--method", dict.fromkeys(c.run.tracker for c in pipelines if c.run.tracker_run)),
    ):
        for name in names:
            half = halves[name]
            words += [option, name if half is None else labelled_target(name, half)]
            if half is not None and not half.target.startswith(PREDICTIONS):
                settings += settings_of(name, half)
    words += [word for setting in settings for word in ("--set", setting)]
    words += ["--top", str(pipelines[0].run.top), *_basin_words(pipelines[0])]
    return [shlex.join([*words, "--seed", str(max(seeds))] if seeds else words)]


def _halves(run: PipelineRun) -> list[tuple[str, RunRecord | None]]:
    return [(run.retriever, run.retriever_run), (run.tracker, run.tracker_run)]


def _same(a: RunRecord | None, b: RunRecord | None) -> bool:
    if a is None or b is None:
        return a is b
    return (a.target, a.parameters, a.files, a.seed) == (b.target, b.parameters, b.files, b.seed)


def _basin_words(pipeline: Pipeline) -> list[str]:
    """The options that define the basin."""
    sources = {b.source for b in pipeline.basins.values()}
    if sources == {"given"}:
        basin = next(iter(pipeline.basins.values()))
        metres = ["--radius", f"{basin.metres:g}"] if math.isfinite(basin.metres) else []
        return [*metres, "--heading", f"{basin.degrees:g}"]
    return ["--probe", "PROBE"] if "probe" in sources else []


def _set(board: PipelineBoard, asked: PipelineSetBoard) -> dict[str, object]:
    halves, differing = _methods(asked)
    return {
        "record": asked.record,
        "tasks": [(name, asked.units[name]) for name in asked.used],
        "sections": [_section(board, asked, table) for table in asked.tables],
        "missing": asked.missing,
        "halves": [(name, part, half, machine_words(half)) for (part, name), half in halves],
        "parameters": [(name, json_text(half.parameters)) for (_, name), half in halves if half.parameters],
        "differing": differing,
    }


def _section(board: PipelineBoard, asked: PipelineSetBoard, table: PipelineTable) -> dict[str, object]:
    sigmas = [r.median_sigma_translation_m for r in table.records if r.median_sigma_translation_m is not None]
    sigma = max(sigmas, default=0.0)
    return {
        "table": table,
        "poses": _table(board, asked, table, pose_columns(board), left=3),
        "losses": _table(board, asked, table, stage_columns(table), left=2),
        "about_ranks": about_ranks(table.rows, board.metric, f"{table.queries} queries"),
        "coarse": SIGMA_FACTOR * sigma > RIGHT[0],
        "sigma": f"{sigma:.2f}",
        "finest": f"{SIGMA_FACTOR * sigma:.2f}",
    }


def _table(board: PipelineBoard, asked: PipelineSetBoard, table: PipelineTable, keys: Sequence[str], left: int) -> str:
    """A table in Markdown, whose columns of names say what a reader must know of them."""
    columns = pipeline_columns(board)
    heads, rows = texts([columns[key] for key in keys], lines_of(asked, table))
    of_retriever, of_tracker = keys.index(RETRIEVER), keys.index(TRACKER)
    for cells, row in zip(rows, table.rows, strict=True):
        cells[of_retriever] = _name(cells[of_retriever])
        words = ["(uses times)"] if row.method.uses_times else []
        words += [f"({escaped(row.method.assumes)})"] if row.method.assumes else []
        cells[of_tracker] = " ".join([_name(cells[of_tracker]), *words, *_signs(row, table)])
    return table_text(heads, rows, left=left)


def _name(name: str) -> str:
    return f"*{name}*" if name in (ORACLE, KEYFRAME) else escaped(name)


def _signs(row: PipelineRow, table: PipelineTable) -> list[str]:
    names = marks_of_pipeline(row, table)
    return [mark.sign for mark in MARKS if mark.name in names]


def marks_of_pipeline(row: PipelineRow, table: PipelineTable) -> list[str]:
    """The names of the marks that apply to a row."""
    halves = [half for half in (row.method.run.retriever_run, row.method.run.tracker_run) if half is not None]
    tracker = row.method.run.tracker_run
    signs = {
        "not isolated": tracker is not None and not_isolated(tracker),
        "made elsewhere": any(map(made_elsewhere, halves)),
        "not rescored": not row.missing and not is_rescored(row, table),
    }
    return [mark.name for mark in MARKS if signs[mark.name]]


def _methods(
    asked: PipelineSetBoard,
) -> tuple[list[tuple[tuple[str, str], RunRecord]], list[tuple[str, str, str]]]:
    """The methods by half and name; where pipelines have others of the same name: name, pipeline, parameters."""
    halves: dict[tuple[str, str], RunRecord] = {}
    differing = []
    for pipeline in asked.methods:
        for part, (name, half) in zip(("retriever", "tracker"), _halves(pipeline.run), strict=True):
            if half is not None and not _same(halves.setdefault((part, name), half), half):
                differing.append((name, pipeline.label, json_text(half.parameters, ascii_only=True)))
    return sorted(halves.items()), differing
