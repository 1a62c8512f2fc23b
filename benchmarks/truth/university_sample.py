"""Retrievers on real drone and satellite images: the 500 pairs of University-1652's contact sheets.

The sheets come with the authors' repository (see docs/cross-view.md). According to the source note of the sample, a
colour histogram in L*a*b* reaches R@1 6.6 %, R@5 17.2 % and R@10 22.2 % from drone to satellite, and R@1 9.6 % from
satellite to drone, where chance is 0.2 %. The note does not give the cells of the histogram or the distance;
``as_noted`` in the last line says whether all four numbers are reproduced. Other retrievers are evaluated in the same
way.

    python benchmarks/truth/university_sample.py SAMPLE [--method NAME] ... [--set NAME.key=value] ...

It prints a table; the last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.datasets.cross_view import open_cross_view
from relocbench.errors import RelocbenchError
from relocbench.methods import RETRIEVERS, MethodSpec, parse_methods
from relocbench.metrics import chance_level, rank_descriptors, score_retrieval, summarize_retrieval
from relocbench.retrieval import FittingRetriever, ImageView, RetrievalTask, Retriever

METRICS = ("R@1", "R@5", "R@10", "AP")
NOTED = {
    "drone-satellite": {"R@1": 0.066, "R@5": 0.172, "R@10": 0.222},
    "satellite-drone": {"R@1": 0.096},
}
"""numbers of the source note for ``colour-histogram``"""
_BATCH = 32


def asked(task: RetrievalTask, spec: MethodSpec, seed: int) -> dict[str, float]:
    """The metrics of a retriever on one task."""
    retriever = spec.create()
    if isinstance(retriever, FittingRetriever):
        retriever.fit(task.gallery, seed)
    query, gallery = described(retriever, task.queries), described(retriever, task.gallery)
    ranking = rank_descriptors(query, gallery, task.relevance)
    return dict(summarize_retrieval(score_retrieval(ranking), METRICS).values)


def described(retriever: Retriever, images: tuple[ImageView, ...]) -> np.ndarray:
    """The descriptors (N, D), computed in batches."""
    parts = [retriever.describe(images[k : k + _BATCH]) for k in range(0, len(images), _BATCH)]
    return np.concatenate(parts)


def run(sample: Path, methods: list[str], settings: list[str], seed: int) -> dict[str, Any]:
    """Evaluate every method in both directions; print chance, and whether the source note's numbers are reproduced."""
    found = open_cross_view(sample)
    specs = parse_methods(methods, settings, seed, RETRIEVERS)
    rows: dict[str, Any] = {}
    for task in found.tasks():
        rows[task.name] = {"chance": chance_level(task.relevance, METRICS)}
        for spec in specs:
            rows[task.name][spec.label] = asked(task, spec, seed)
    result: dict[str, Any] = {"set": found.name, "fingerprint": found.fingerprint, "tasks": rows}
    if "colour-histogram" in [spec.label for spec in specs]:
        result["as_noted"] = all(
            round(rows[task]["colour-histogram"][metric], 3) == value
            for task, values in NOTED.items()
            for metric, value in values.items()
        )
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sample", type=Path, help="folder with sample_drone.jpg and sample_satellite.jpg")
    parser.add_argument("--method", action="append", help="a retriever; may be repeated (default: colour-histogram)")
    parser.add_argument("--set", action="append", default=[], help="NAME.key=value")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    methods = options.method or ["colour-histogram=baselines.floors:ColourHistogram"]
    try:
        result = run(options.sample, methods, options.set, options.seed)
    except RelocbenchError as bad:
        print(bad, file=sys.stderr)
        return 2
    for task, rows in result["tasks"].items():
        print(f"{task}: {' '.join(f'{metric:>6}' for metric in METRICS)}")
        for label, values in rows.items():
            print(f"  {label:<20} {' '.join(f'{100 * values[metric]:6.1f}' for metric in METRICS)}")
    print(json.dumps(result))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
