"""``relocalization.md``: what a sceptical reader wants to know about chains, on one page."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence

from relocbench.evaluation.common.results import PREDICTIONS, RunRecord
from relocbench.evaluation.relocalization.basin import SAID
from relocbench.evaluation.relocalization.chain import RIGHT
from relocbench.evaluation.relocalization.records import KEYFRAME, ORACLE, ChainRun
from relocbench.evaluation.relocalization.score import FAILURES, HIT, RANKING
from relocbench.leaderboard.common.commands import RESUMES, again_section, labelled_target, settings_of
from relocbench.leaderboard.common.text import bullet, code, escaped, json_text, number, table_text, with_bounds
from relocbench.leaderboard.relocalization.board import Chain, ChainBoard, ChainRow, ChainSetBoard, ChainTable
from relocbench.leaderboard.tracking.load import machine_words
from relocbench.metrics import LEVEL, MIN_EFFECTIVE
from relocbench.metrics.pose.registry import SIGMA_FACTOR

_POSES = (RANKING, "recall@(0.5m,5deg)", "recall@(1m,5deg)", "recall@(5m,10deg)", "t_auc@0.5m", "r_auc@0.5deg")
_LOST = {
    "failed_retrieval": "retrieval",
    "failed_tracking": "tracking",
    "failed_choice": "choice",
    "failed_unreachable": "cannot be judged",
}
assert set(_LOST) == set(FAILURES)


def relocalization_page(board: ChainBoard) -> str:
    """The whole page."""
    parts = ["# Relocalization leaderboard", *_how_to_read(board)]
    for asked in board.sets:
        parts += _set(board, asked)
    parts += _again(board)
    return "\n\n".join(part for part in parts if part) + "\n"


def evaluate_commands(chains: Sequence[Chain]) -> list[str]:
    """The commands that run or resume chains, one for all chains that can share it."""
    groups: dict[tuple[object, ...], list[Chain]] = {}
    for chain in chains:
        floor = chain.run.tracker == KEYFRAME  # every command evaluates it
        tops = {c.run.top for c in chains if c.run.retriever == chain.run.retriever and c.run.tracker != KEYFRAME}
        if not floor or not tops:
            groups.setdefault((chain.run.top, *_basin_words(chain)), []).append(chain)
    return [line for group in groups.values() for line in _commands(group)]


def _commands(chains: Sequence[Chain]) -> list[str]:
    """One command if methods of the same name are the same in all chains, otherwise one for each chain."""
    halves: dict[str, RunRecord | None] = {}
    for chain in chains:
        for name, half in _halves(chain.run):
            if name in halves and not _same(halves[name], half) and len(chains) > 1:
                return [line for each in chains for line in _commands([each])]
            halves[name] = half
    words = ["relocbench", "evaluate-relocalization", "--dataset", "DATASET", "--out", "RESULTS"]
    settings: list[str] = []
    seeds = {half.seed for half in halves.values() if half is not None and half.seed}
    for option, names in (
        ("--retriever", dict.fromkeys(c.run.retriever for c in chains)),
        ("--method", dict.fromkeys(c.run.tracker for c in chains if c.run.tracker_run)),
    ):
        for name in names:
            half = halves[name]
            words += [option, name if half is None else labelled_target(name, half)]
            if half is not None and not half.target.startswith(PREDICTIONS):
                settings += settings_of(name, half)
    words += [word for setting in settings for word in ("--set", setting)]
    words += ["--top", str(chains[0].run.top), *_basin_words(chains[0])]
    return [shlex.join([*words, "--seed", str(max(seeds))] if seeds else words)]


def _halves(run: ChainRun) -> list[tuple[str, RunRecord | None]]:
    return [(run.retriever, run.retriever_run), (run.tracker, run.tracker_run)]


def _same(a: RunRecord | None, b: RunRecord | None) -> bool:
    if a is None or b is None:
        return a is b
    return (a.target, a.parameters, a.files, a.seed) == (b.target, b.parameters, b.files, b.seed)


def _basin_words(chain: Chain) -> list[str]:
    """The options that define the basin."""
    sources = {b.source for b in chain.basins.values()}
    if sources == {"given"}:
        basin = next(iter(chain.basins.values()))
        metres = ["--radius", f"{basin.metres:g}"] if math.isfinite(basin.metres) else []
        return [*metres, "--heading", f"{basin.degrees:g}"]
    return ["--probe", "PROBE"] if "probe" in sources else []


def _how_to_read(board: ChainBoard) -> list[str]:
    metres, degrees = RIGHT
    return [
        "A retriever ranks the keyframes of the reference traversal for each query, a tracker is asked against the "
        "best K of them, and its most confident answer is kept. The error is that of the query's pose in the map. All "
        f"numbers are in percent of all queries unless a unit is named; `[low, high]` is a {LEVEL:.0%} interval for "
        "the number of independent queries that those along the drives are worth. In a mean over tasks each task "
        "counts the same; medians are over all queries together. All numbers, in full, are in `relocalization.csv`.",
        f"**Ranks** go by `{board.metric}`. A chain's rank is one more than the number of chains that are "
        "significantly better, by a test with one error rate for the whole table. "
        f"`{ORACLE}` knows the truth and has no rank: it ranks the keyframes "
        f"as the true poses do. `{KEYFRAME}` answers the pose of the first keyframe, without looking at the query: the "
        "floor of each retriever.",
        f"**Where it is lost.** Right is within {metres:g} m and {degrees:g}°. *Basin*: keyframes from which the "
        "tracker can be expected to find the pose. Recall = P(one of the K in the basin) x P(right | that) + right "
        "otherwise. What is not right is lost to *retrieval* (none of the K in the basin), to *tracking* (there was "
        "one, and no answer is right) or to the *choice* (an answer was right, and another one was more confident).",
        "**Failures.** The denominator is every query. A query without an answer has infinite errors; an answer "
        "against a keyframe from which the truth is not known counts as wrong. A chain that misses a task has blank "
        "means and no rank.",
    ]


def _set(board: ChainBoard, asked: ChainSetBoard) -> list[str]:
    record = asked.record
    parts = [f"## {escaped(record.dataset)}", f"Fingerprint {code(record.dataset_fingerprint)}.", _tasks(asked)]
    for table in asked.tables:
        parts += [f"### {escaped(table.name)}", *_table(board, table)]
    missing = [
        f"{code(row.chain.label)} on {', '.join(map(code, row.missing))}" for row in asked.tables[0].rows if row.missing
    ]
    parts.append(bullet("**Missing results**, hence blank means and no rank:", missing))
    return [*parts, *_methods(asked)]


def _tasks(asked: ChainSetBoard) -> str:
    columns = ["task", "conditions", "queries", "images in no pair", "keyframes", "pairs", "rejected", "pairs reach"]
    columns += ["pairs disagree by, m", "sigma of the truth, m"]
    rows = [
        [
            code(name),
            f"{escaped(r.condition_gallery)} → {escaped(r.condition_query)}",
            *map(str, (r.queries, r.images_without_pair, r.gallery, r.pairs, r.rejected)),
            f"{r.reach_m:.3g} m, {r.reach_deg:.3g}°",
            number(r.truth_spread_m, "m"),
            number(r.median_sigma_translation_m, "m"),
        ]
        for name, r in asked.record.tasks.items()
        if any(name in table.tasks for table in asked.tables)
    ]
    return table_text(columns, rows, left=2)


def _table(board: ChainBoard, table: ChainTable) -> list[str]:
    parts = []
    if len(table.tasks) > 1:
        parts.append(f"Mean over {len(table.tasks)} tasks, {table.queries} queries.")
    poses = list(dict.fromkeys((board.metric, *_POSES)))
    columns = ["rank", "retriever", "tracker", "K", *(escaped(m) for m in poses), "median m", "median °", "s a query"]
    rows = []
    for row in table.rows:
        values = row.values
        medians = [
            number(values.get(f"median_{name}"), unit)
            for name, unit in (("translation_error_m", "m"), ("rotation_error_deg", "deg"), ("seconds", "s"))
        ]
        rows.append([*_head(row), *(_cell(row, m) for m in poses), *medians])
    parts.append(table_text(columns, rows, left=3))
    lost = {share: name for share, name in _LOST.items() if any(row.values[share] for row in table.rows)}
    columns = ["retriever", "tracker", "K", "basin", "basin recall@1", "basin recall@K", "right, if one is in it"]
    columns += ["right otherwise", "right among the K", *(f"lost: {name}" for name in lost.values()), "failed / broke"]
    shares = ("basin_recall@1", HIT, "right_given_hit", "right_without_hit", "right_among_K", *lost)
    rows = [
        [
            *_head(row)[1:],
            _basin(row, table),
            *(_cell(row, share) for share in shares),
            "" if row.missing else f"{row.failed} / {row.broke}",
        ]
        for row in table.rows
    ]
    parts.append(table_text(columns, rows, left=2))
    if all(row.intervals.get(board.metric) is None for row in table.rows):
        parts.append(
            f"Too few queries for intervals: they are worth fewer than {MIN_EFFECTIVE:g} independent ones."
            + (" All chains share a rank." if all(row.rank in (1, None) for row in table.rows) else "")
        )
    sigmas = [r.median_sigma_translation_m for r in table.records if r.median_sigma_translation_m is not None]
    if sigmas and SIGMA_FACTOR * max(sigmas) > RIGHT[0]:
        limit = SIGMA_FACTOR * max(sigmas)
        parts.append(
            f"The truth is known to {max(sigmas):.2f} m (one sigma): thresholds below {limit:.2f} m "
            "measure the truth rather than the chains."
        )
    return parts


def _head(row: ChainRow) -> list[str]:
    run = row.chain.run
    names = [f"*{name}*" if name in (ORACLE, KEYFRAME) else escaped(name) for name in (run.retriever, run.tracker)]
    return ["" if row.rank is None else str(row.rank), *names, str(run.top)]


def _cell(row: ChainRow, metric: str) -> str:
    return with_bounds(row.values.get(metric), row.intervals.get(metric), "share")


def _basin(row: ChainRow, table: ChainTable) -> str:
    """The size of the basin if it is the same on all tasks, else its source in words."""
    basins = [row.chain.basins[task] for task in table.tasks if task in row.chain.basins]
    if not basins:
        return ""
    sizes = {(round(b.metres, 3), round(b.degrees, 3)) for b in basins}
    if len(sizes) == 1:
        ((metres, degrees),) = sizes
        return f"{metres:.3g} m, {degrees:.3g}°" + ("" if basins[0].source == "pairs" else f" ({basins[0].source})")
    return ", ".join(sorted({SAID[b.source] for b in basins}))


def _methods(asked: ChainSetBoard) -> list[str]:
    halves: dict[tuple[str, str], RunRecord] = {}
    differ: list[str] = []
    for chain in asked.chains:
        for part, (name, half) in zip(("retriever", "tracker"), _halves(chain.run), strict=True):
            if half is not None and not _same(halves.setdefault((part, name), half), half):
                differ.append(
                    f"{code(name)} in {code(chain.label)}: {code(json_text(half.parameters, ascii_only=True))}"
                )
    rows = [
        [
            escaped(name),
            part,
            code(half.target),
            escaped(half.versions.get("method", "")),
            " ".join(f"{escaped(key)} {escaped(value[:12])}" for key, value in half.files.items()),
            escaped(machine_words(half)),
        ]
        for (part, name), half in sorted(halves.items())
    ]
    if not rows:
        return []
    lines = [
        f"{code(name)}: {code(json_text(half.parameters))}"
        for (_, name), half in sorted(halves.items())
        if half.parameters
    ]
    columns = ["method", "half", "what it is", "version", "files, SHA-256", "machine of the seconds"]
    return [
        "### Methods",
        table_text(columns, rows, left=6),
        bullet("Parameters:", lines),
        bullet("**Made otherwise** than the other chains of the same name:", differ),
    ]


def _again(board: ChainBoard) -> list[str]:
    commands = [(asked.title, evaluate_commands(asked.chains)) for asked in board.sets]
    split = f" --split {shlex.quote(board.split)}" if board.split else ""
    page = (
        f"relocbench leaderboard RESULTS --out DIR --relocalization-metric '{board.metric}' --seed {board.seed}{split}"
    )
    return again_section(RESUMES, commands, page)
