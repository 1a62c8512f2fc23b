"""``relocalization.md``: what a sceptical reader wants to know about pipelines, on one page."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence

from relocbench.evaluation.common.results import PREDICTIONS, RunRecord
from relocbench.evaluation.relocalization.basin import SAID
from relocbench.evaluation.relocalization.pipeline import RIGHT
from relocbench.evaluation.relocalization.records import KEYFRAME, ORACLE, PipelineRun
from relocbench.evaluation.relocalization.score import FAILURES, HIT, RANKING
from relocbench.leaderboard.common.commands import labelled_target, settings_of
from relocbench.leaderboard.common.headings import BASIN, COUNTS, RANK, RETRIEVER, SECONDS, TOP, TRACKER, heading
from relocbench.leaderboard.common.ranks import rank_text, why_no_ranks
from relocbench.leaderboard.common.text import json_text, number, with_bounds
from relocbench.leaderboard.relocalization.board import (
    Pipeline,
    PipelineBoard,
    PipelineRow,
    PipelineSetBoard,
    PipelineTable,
)
from relocbench.leaderboard.tracking.load import machine_words
from relocbench.leaderboard.tracking.marks import MARKS, made_elsewhere, not_isolated
from relocbench.metrics import LEVEL
from relocbench.metrics.pose.registry import SIGMA_FACTOR
from relocbench.pages import render
from relocbench.pages.markdown import escaped, table_text

POSES = (RANKING, "recall@(0.5m,5deg)", "recall@(1m,5deg)", "recall@(5m,10deg)", "t_auc@0.5m", "r_auc@0.5deg")
MEDIANS = ("median_translation_error_m", "median_rotation_error_deg")


def relocalization_page(board: PipelineBoard) -> str:
    """The whole page."""
    metres, degrees = RIGHT
    split = f" --split {shlex.quote(board.split)}" if board.split else ""
    rescored = any(pipeline.rescored for asked in board.sets for pipeline in asked.pipelines)
    dataset = " --dataset DATASET" if rescored else ""
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
        sets=[_set(board, asked) for asked in board.sets],
        commands=[(asked.title, evaluate_commands(asked.pipelines)) for asked in board.sets],
        page_command=f"relocbench leaderboard RESULTS --out DIR{dataset} --relocalization-metric '{board.metric}' "
        f"--seed {board.seed}{split}",
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
        "tasks": [
            (name, task)
            for name, task in asked.record.tasks.items()
            if any(name in table.tasks for table in asked.tables)
        ],
        "sections": [_section(board, table) for table in asked.tables],
        "missing": [(row.pipeline.label, row.missing) for row in asked.tables[0].rows if row.missing],
        "halves": [(name, part, half, machine_words(half)) for (part, name), half in halves],
        "parameters": [(name, json_text(half.parameters)) for (_, name), half in halves if half.parameters],
        "differing": differing,
    }


def _section(board: PipelineBoard, table: PipelineTable) -> dict[str, object]:
    sigmas = [r.median_sigma_translation_m for r in table.records if r.median_sigma_translation_m is not None]
    sigma = max(sigmas, default=0.0)
    return {
        "table": table,
        "poses": _pose_table(board, table),
        "losses": _loss_table(table),
        "why_no_ranks": why_no_ranks(table.rows, board.metric, f"{table.queries} queries"),
        "coarse": SIGMA_FACTOR * sigma > RIGHT[0],
        "sigma": f"{sigma:.2f}",
        "finest": f"{SIGMA_FACTOR * sigma:.2f}",
    }


def _pose_table(board: PipelineBoard, table: PipelineTable) -> str:
    poses = list(dict.fromkeys((board.metric, *POSES)))
    columns = [RANK, RETRIEVER, TRACKER, TOP, *map(heading, poses), *MEDIANS, SECONDS]
    rows = []
    for row in table.rows:
        medians = [
            number(row.values.get(name), unit)
            for name, unit in zip((*MEDIANS, SECONDS), ("m", "deg", "s"), strict=True)
        ]
        rows.append([*_head(row, table), *(_cell(row, m) for m in poses), *medians])
    return table_text(columns, rows, left=3)


def _loss_table(table: PipelineTable) -> str:
    lost = [share for share in FAILURES if any(row.values[share] for row in table.rows)]
    shares = ("basin_recall@1", HIT, "right_given_hit", "right_without_hit", "right_among_K", *lost)
    columns = [RETRIEVER, TRACKER, TOP, BASIN, *map(heading, shares), COUNTS]
    rows = [
        [
            *_head(row, table)[1:],
            basin_words(row, table),
            *(_cell(row, share) for share in shares),
            "" if row.missing else f"{row.failed} / {row.broke}",
        ]
        for row in table.rows
    ]
    return table_text(columns, rows, left=2)


def _head(row: PipelineRow, table: PipelineTable) -> list[str]:
    run = row.pipeline.run
    names = [f"*{name}*" if name in (ORACLE, KEYFRAME) else escaped(name) for name in (run.retriever, run.tracker)]
    times = ["(uses times)"] if row.pipeline.uses_times else []
    told = " ".join([names[1], *times, *_signs(row)])
    return [rank_text(row, table.rows), names[0], told, str(run.top)]


def _signs(row: PipelineRow) -> list[str]:
    names = marks_of_pipeline(row)
    return [mark.sign for mark in MARKS if mark.name in names]


def marks_of_pipeline(row: PipelineRow) -> list[str]:
    """The names of the marks that apply to a row."""
    halves = [half for half in (row.pipeline.run.retriever_run, row.pipeline.run.tracker_run) if half is not None]
    tracker = row.pipeline.run.tracker_run
    signs = {
        "not isolated": tracker is not None and not_isolated(tracker),
        "made elsewhere": any(map(made_elsewhere, halves)),
        "not rescored": not row.missing and not row.rescored,
    }
    return [mark.name for mark in MARKS if signs[mark.name]]


def _cell(row: PipelineRow, metric: str) -> str:
    return with_bounds(row.values.get(metric), row.intervals.get(metric), "share")


def basin_words(row: PipelineRow, table: PipelineTable) -> str:
    """The size of the basin if it is the same on all tasks, else its source in words."""
    basins = [row.pipeline.basins[task] for task in table.tasks if task in row.pipeline.basins]
    if not basins:
        return ""
    sizes = {(round(b.metres, 3), round(b.degrees, 3)) for b in basins}
    if len(sizes) == 1:
        ((metres, degrees),) = sizes
        return f"{metres:.3g} m, {degrees:.3g}°" + ("" if basins[0].source == "pairs" else f" ({basins[0].source})")
    return ", ".join(sorted({SAID[b.source] for b in basins}))


def _methods(
    asked: PipelineSetBoard,
) -> tuple[list[tuple[tuple[str, str], RunRecord]], list[tuple[str, str, str]]]:
    """The methods by half and name; where pipelines have others of the same name: name, pipeline, parameters."""
    halves: dict[tuple[str, str], RunRecord] = {}
    differing = []
    for pipeline in asked.pipelines:
        for part, (name, half) in zip(("retriever", "tracker"), _halves(pipeline.run), strict=True):
            if half is not None and not _same(halves.setdefault((part, name), half), half):
                differing.append((name, pipeline.label, json_text(half.parameters, ascii_only=True)))
    return sorted(halves.items()), differing
