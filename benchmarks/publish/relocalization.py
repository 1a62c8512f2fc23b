"""Where relocalization fails: at the retriever, the tracker, or the choice among K keyframes, on test districts.

In each district that no training saw (test split, ``--seeds``) drives in several conditions are rendered; all are
localized in the map of the first one, with the front camera. ``relocbench evaluate-relocalization`` runs every
retriever with every tracker: retrievers that need no training, the oracle that knows the nearest keyframes, and a
random order. ``relocbench leaderboard`` writes the page. Printed are means over all tasks, and by how much the pipeline
with the oracle is ahead of that with each retriever, which is what better retrieval could gain for the tracker.

Datasets and results are kept in ``--scratch``; when it is run again, only what is missing is made. Beside the page goes
``predictions.tar.xz``, all rankings and poses. With ``--published`` such an archive is read in place of asking anybody,
and every row is computed anew by the truth of the rendered districts.

    python benchmarks/publish/relocalization.py --scratch S [--out leaderboard/relocalization] [--workers N]
        [-r RETRIEVER ...] [-m TRACKER ...] [--published leaderboard/relocalization/predictions.tar.xz]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from archives import extract, pack_folder

from relocbench.evaluation.relocalization.records import KEYFRAME, ORACLE
from relocbench.evaluation.relocalization.score import FAILURES, RANKING, per_query
from relocbench.leaderboard.common.by_query import load_board
from relocbench.leaderboard.relocalization.board import RELOCALIZATION, Pipeline, PipelineBoard
from relocbench.metrics import Difference, controlled, in_points, paired_difference

CONDITIONS = ("WetNoon", "SoftRainNoon", "Overcast", "Night")
"""the condition of the map first"""
RETRIEVERS = (ORACLE, "imagenet-average", "colour-histogram", "orb-bow", "random")
TRACKERS = ("dso", "orb-pnp", "gn-net-from-prior", "gn-net")
SHARES = (RANKING, "recall@(1m,5deg)", "basin_recall@1", "hit", "right_given_hit", "right_without_hit", *FAILURES)


def main() -> None:
    options = _options()
    with tempfile.TemporaryDirectory() as temporary:
        scratch = options.scratch or Path(temporary)
        results, page = scratch / "results", options.out or scratch / "page"
        if options.published:
            extract(options.published, results)
        for seed in options.seeds.split(","):
            dataset = _build(scratch, seed, options)
            if not options.published:
                _evaluate(dataset, results, options)
        _run("leaderboard", results, "--dataset", scratch, "--out", page, "-q")
        if not options.published:
            pack_folder(results, page / "predictions.tar.xz")
        board = load_board(RELOCALIZATION, results, split=options.split)
        assert board is not None
        rows = _rows(page / "relocalization.csv")
        ahead = _ahead(board)
    print(_table(rows))
    print("percentage points, with 95 % intervals; *: significant with one error rate for all of this list")
    for (tracker, retriever), difference in ahead.items():
        print(f"{tracker}: {ORACLE} less {retriever}, {RANKING}: {in_points(difference)}")
    print(json.dumps({"benchmark": "relocalization", "chains": rows, "oracle_less": _plain(ahead)}))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, help="folder that keeps datasets and results; default: a temporary one")
    parser.add_argument("--out", type=Path, help="folder for pages and predictions.tar.xz; default: SCRATCH/page")
    parser.add_argument(
        "--published", type=Path, help="predictions.tar.xz of an earlier run, in place of asking anybody"
    )
    parser.add_argument("--split", default="test")
    parser.add_argument("--seeds", default="100", help="seeds of the districts")
    parser.add_argument(
        "--steps", type=int, default=120, help="steps of each drive, which is the number of queries in each condition"
    )
    parser.add_argument("--speed", type=float, default=15.0, help="m/s; a step is a tenth of a second")
    parser.add_argument("--size", default="512x512", help="pixels")
    parser.add_argument("--conditions", default=",".join(CONDITIONS), help="the condition of the map first")
    parser.add_argument("--top", type=int, default=3, help="number of keyframes that a tracker is run against")
    parser.add_argument("--workers", "-j", type=int, default=2)
    parser.add_argument("-r", dest="retrievers", action="append", help=f"default: {', '.join(RETRIEVERS)}")
    parser.add_argument("-m", dest="trackers", action="append", help=f"default: {', '.join(TRACKERS)}")
    parser.add_argument("--set", dest="settings", action="append", default=[], help="method.key=value")
    options = parser.parse_args()
    options.retrievers = options.retrievers or list(RETRIEVERS)
    options.trackers = options.trackers or list(TRACKERS)
    return options


def _build(scratch: Path, seed: str, options: argparse.Namespace) -> Path:
    out = scratch / f"relocalization-{seed}"
    _run(
        "build-dataset", "synthetic", "--name", out.name, "--conditions", options.conditions, "--cameras", "front",
        "--size", options.size, "--steps", options.steps, "--speed", options.speed, "--split", options.split,
        "--seed", seed, "--reference", "first", "--correspondences", 0, "--out", out, "-j", options.workers, "-q",
    )  # fmt: skip
    return out


def _evaluate(dataset: Path, results: Path, options: argparse.Namespace) -> None:
    words = [word for retriever in options.retrievers for word in ("-r", retriever)]
    words += [word for tracker in options.trackers for word in ("-m", tracker)]
    words += [word for setting in options.settings for word in ("--set", setting)]
    _run(
        "evaluate-relocalization", "-d", dataset, "--out", results, "--split", options.split,
        "--top", options.top, "-j", options.workers, "-q", *words,
    )  # fmt: skip


def _run(*words: object) -> None:
    """Run a relocbench command; its messages go to standard error."""
    subprocess.run([sys.executable, "-m", "relocbench", *map(str, words)], check=True, stdout=sys.stderr)


def _rows(path: Path) -> list[dict[str, Any]]:
    """For each pipeline, the means over the districts of the means over a district's single tasks."""
    with path.open(encoding="utf-8") as stream:
        single = [row for row in csv.DictReader(stream) if " " not in row["tasks"] and not row["missing"]]
    pipelines: dict[tuple[str, str, str], list[dict[str, str]]] = {}
    for row in single:
        pipelines.setdefault((row["retriever"], row["tracker"], row["top"]), []).append(row)
    out = []
    for (retriever, tracker, top), of in pipelines.items():
        districts: dict[str, list[dict[str, str]]] = {}
        for row in of:
            districts.setdefault(row["dataset"], []).append(row)
        of_districts = {share: [_mean([row[share] for row in some]) for some in districts.values()] for share in SHARES}
        means = {share: _mean(values) for share, values in of_districts.items()}
        queries = sum(int(row["queries"]) for row in of)
        named = {"retriever": retriever, "tracker": tracker, "top": int(top), "queries": queries}
        out.append({**named, "tasks": len(of), **means})
    return sorted(out, key=lambda row: (row["retriever"], row["tracker"]))


def _mean(values: Sequence[str | float | None]) -> float | None:
    known = [float(value) for value in values if value is not None and value != ""]
    return float(np.mean(known)) if known else None


def _ahead(board: PipelineBoard) -> dict[tuple[str, str], Difference]:
    """By how much the oracle's pipeline is ahead of each retriever's, by (tracker, retriever)."""
    out = {}
    labels = dict.fromkeys((c.run.tracker, c.run.retriever) for of in board.sets for c in of.methods)
    for tracker, retriever in labels:
        if retriever == ORACLE or tracker == KEYFRAME:
            continue
        a, b, roads = [], [], []
        for of in board.sets:
            known = {(c.run.tracker, c.run.retriever): c for c in of.methods}
            for task in (t.tasks[0] for t in of.tables if len(t.tasks) == 1):
                both = known.get((tracker, ORACLE)), known.get((tracker, retriever))
                if all(c is not None and task in c.answers for c in both):
                    a.append(_values(both[0], task))
                    b.append(_values(both[1], task))
                    roads.append(of.title)
        if a:
            out[tracker, retriever] = paired_difference(a, b, roads=roads)
    return dict(zip(out, controlled(list(out.values())), strict=True))


def _values(pipeline: Pipeline | None, task: str) -> np.ndarray:
    assert pipeline is not None
    return per_query(pipeline.answers[task], RANKING)


def _table(rows: list[dict[str, Any]]) -> str:
    lines = [
        f"| retriever | tracker | K | queries | {' | '.join(SHARES)} |",
        f"|---|---|---|---|{'---|' * len(SHARES)}",
    ]
    for row in rows:
        cells = ["" if row[share] is None else f"{100 * row[share]:.1f}" for share in SHARES]
        lines.append(
            f"| {row['retriever']} | {row['tracker']} | {row['top']} | {row['queries']} | {' | '.join(cells)} |"
        )
    return "\n".join(lines)


def _plain(ahead: dict[tuple[str, str], Difference]) -> dict[str, list[float | None]]:
    return {
        f"{tracker}, {retriever}": [d.mean, *((d.interval.low, d.interval.high) if d.interval else (None, None))]
        for (tracker, retriever), d in ahead.items()
    }


if __name__ == "__main__":
    main()
