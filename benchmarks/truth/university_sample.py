"""Retrievers on real drone and satellite images: the 500 pairs of University-1652's contact sheets.

The sheets come with the authors' repository (see docs/cross-view.md). According to the source note of the sample, a
colour histogram in L*a*b* reaches R@1 6.6 %, R@5 17.2 % and R@10 22.2 % from drone to satellite, and R@1 9.6 % from
satellite to drone, where chance is 0.2 %. The note does not give the cells of the histogram or the distance;
``as_noted`` in the last line says whether all four numbers are reproduced. Other retrievers are evaluated in the same
way.

With ``--unlabelled NAME`` only every second pair is asked, of all methods and within the gallery of all pairs: the
images of the others are put into a folder that does not tell which two belong together, which the named methods get as
their parameter ``unlabelled`` (``docs/lpn.md``). The pairs with odd numbers are asked; those with even ones were looked
at when that parameter was designed.

    python benchmarks/truth/university_sample.py SAMPLE [--method NAME] ... [--set NAME.key=value] ...
        [--unlabelled NAME] ...

It prints a table; the last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from relocbench.datasets.cross_view import open_cross_view
from relocbench.errors import RelocbenchError
from relocbench.methods import RETRIEVERS, MethodSpec, parse_methods
from relocbench.metrics import (
    chance_level,
    rank_descriptors,
    relevance_from_lists,
    score_retrieval,
    summarize_retrieval,
)
from relocbench.retrieval import FittingRetriever, ImageView, RetrievalTask

METRICS = ("R@1", "R@5", "R@10", "AP")
NOTED = {
    "drone-satellite": {"R@1": 0.066, "R@5": 0.172, "R@10": 0.222},
    "satellite-drone": {"R@1": 0.096},
}
"""numbers of the source note for ``colour-histogram``"""
_BATCH = 32


class Asked:
    """A retriever that describes every image once, however many tasks show it; one that fits begins anew in each."""

    def __init__(self, spec: MethodSpec, seed: int) -> None:
        self._spec, self._retriever, self._seed = spec, spec.create(), seed
        self._rows: dict[str, np.ndarray] = {}

    def metrics(self, task: RetrievalTask) -> dict[str, float]:
        """The metrics of one task."""
        if isinstance(self._retriever, FittingRetriever):
            self._retriever = self._spec.create()
            self._retriever.fit(task.gallery, self._seed)
            self._rows.clear()
        query, gallery = self._described(task.queries), self._described(task.gallery)
        ranking = rank_descriptors(query, gallery, task.relevance)
        return dict(summarize_retrieval(score_retrieval(ranking), METRICS).values)

    def _described(self, images: Sequence[ImageView]) -> np.ndarray:
        """The descriptors (N, D), computed in batches."""
        left = [image for image in images if image.key not in self._rows]
        for start in range(0, len(left), _BATCH):
            batch = left[start : start + _BATCH]
            self._rows.update(zip([image.key for image in batch], self._retriever.describe(batch), strict=True))
        return np.stack([self._rows[image.key] for image in images])


def odd_pairs(task: RetrievalTask) -> RetrievalTask:
    """The task with every second query only, and the whole gallery."""
    kept = [task.relevance.of(number) for number in range(1, len(task.queries), 2)]
    return replace(
        task,
        queries=task.queries[1::2],
        relevance=relevance_from_lists(kept, len(task.gallery)),
        groups=task.groups[1::2],
    )


def write_even_pairs(tasks: Sequence[RetrievalTask], folder: Path) -> None:
    """Write the images of every second pair, a folder for each view, in an order of its own that tells nothing."""
    rng = np.random.default_rng(0)
    for task in tasks:
        images = task.queries[::2]
        (folder / images[0].view).mkdir()
        for number, each in enumerate(rng.permutation(len(images))):
            path = folder / images[0].view / f"{number:03d}.png"
            cv2.imwrite(str(path), cv2.cvtColor(images[each].image, cv2.COLOR_RGB2BGR))


def run(
    sample: Path, methods: list[str], settings: list[str], seed: int, unlabelled: Sequence[str], folder: Path
) -> dict[str, Any]:
    """Evaluate every method in both directions; print chance, and whether the source note's numbers are reproduced.

    Args:
        unlabelled: labels of the methods that get the images of the even pairs; without any, all pairs are asked.
        folder: an empty folder for these images.
    """
    found = open_cross_view(sample)
    tasks = found.tasks()
    if unlabelled:
        write_even_pairs(tasks, folder)
        tasks = [odd_pairs(task) for task in tasks]
        settings = [*settings, *(f"{label}.unlabelled={folder}" for label in unlabelled)]
    specs = parse_methods(methods, settings, seed, RETRIEVERS)
    methods_asked = [Asked(spec, seed) for spec in specs]
    rows: dict[str, Any] = {}
    for task in tasks:
        rows[task.name] = {"chance": chance_level(task.relevance, METRICS)}
        for spec, method in zip(specs, methods_asked, strict=True):
            rows[task.name][spec.label] = method.metrics(task)
    result: dict[str, Any] = {"set": found.name, "fingerprint": found.fingerprint, "tasks": rows}
    if "colour-histogram" in [spec.label for spec in specs] and not unlabelled:
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
    parser.add_argument(
        "--unlabelled",
        action="append",
        default=[],
        help="a method that gets the even pairs' images; asks the odd pairs",
    )
    options = parser.parse_args()
    methods = options.method or ["colour-histogram=baselines.floors:ColourHistogram"]
    unknown = set(options.unlabelled) - {method.split("=")[0] for method in methods}
    if unknown:
        parser.error(f"--unlabelled {sorted(unknown)[0]}: no --method has that label")
    try:
        with tempfile.TemporaryDirectory() as folder:
            result = run(options.sample, methods, options.set, options.seed, options.unlabelled, Path(folder))
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
