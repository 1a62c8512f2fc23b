"""What alignment adds to another tracker's pose, by the level on which it begins, on the validation districts.

Pairs of one place are drawn in each district as for the calibration (``calibration.py``). ``gn-net-from-prior`` starts
from the pose that another tracker finds, on its coarsest level or on finer ones alone (``prior_level``; 0 is the finest
map). Where the other tracker fails, nothing is aligned and all rows fail. Printed are, for all pairs and for those of
one drive and of different conditions, how many are within 0.25 m and 2 degrees, r_auc@0.5deg, and by how much both
exceed the start's own, with intervals by districts. A star marks the differences that are significant with one error
rate for all of a table.

Datasets (those of ``calibration.py``) and answers are kept in ``--scratch``; when it is run again, only what is missing
is made.

    python benchmarks/publish/refined.py --scratch S [--start orb-pnp] [--districts 51,52,53,100,101,102] [--pairs 40]

``--start aliked-pnp`` needs its authors' weights where the method looks for them. The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from answers import Answer, kept, questions
from calibration import VALIDATION, build_district, made_by

from baselines.feature_pnp import OrbPnp, SiftPnp
from baselines.gn_net.tracker import ONE_START, GnNetFromPrior
from baselines.learned_pnp import AlikedPnp
from relocbench.datasets.core.dataset import Dataset
from relocbench.metrics import controlled, in_points, paired_difference

STARTS: Mapping[str, Callable[[], Any]] = {"orb-pnp": OrbPnp, "sift-pnp": SiftPnp, "aliked-pnp": AlikedPnp}
LEVELS = {"coarsest": None, "2": 2, "1": 1, "0": 0}
"""``prior_level`` by the name of its row"""
ALONE = "the start alone"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scratch", type=Path, required=True)
    parser.add_argument("--start", choices=STARTS, default="orb-pnp")
    parser.add_argument("--districts", default=",".join(map(str, VALIDATION)))
    parser.add_argument("--pairs", type=int, default=40, help="pairs of a district")
    parser.add_argument("--workers", "-j", type=int, default=2, help="processes that render")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    seeds = [int(part) for part in options.districts.split(",")]
    answers = {seed: answers_of(seed, options) for seed in seeds}
    told = {}
    for name, chosen in GROUPS.items():
        of_group = {seed: [a for a in of_seed if chosen(a)] for seed, of_seed in answers.items()}
        if any(of_group.values()):
            told[name] = table(name, of_group)
    print(json.dumps({"benchmark": "refined", "start": options.start, **told}))


GROUPS: Mapping[str, Callable[[Answer], bool]] = {
    "all pairs": lambda answer: True,
    "one drive": lambda answer: answer.same_drive,
    "different drives": lambda answer: not answer.same_drive,
    "night on one side": lambda answer: not answer.same_drive and any("night" in each for each in answer.conditions),
}


def answers_of(seed: int, options: argparse.Namespace) -> list[Answer]:
    """The answers of all rows to the pairs of a district."""
    start = STARTS[options.start]
    by = f"{made_by(start)}-{made_by(GnNetFromPrior)}"
    path = options.scratch / "refined" / f"{options.start}-{by}-{seed}-{options.pairs}.jsonl"

    def make() -> Iterator[Answer]:
        return ask(start(), build_district(options.scratch, seed, options.workers), options.pairs, seed)

    return kept(path, make)


def ask(start: Any, dataset: Dataset, count: int, seed: int) -> Iterator[Answer]:
    """The answers of the start and of alignment from it on each first level."""
    aligners = {
        name: GnNetFromPrior(min_agreement=0.0, prior_level=level, **ONE_START) for name, level in LEVELS.items()
    }
    for question in questions(dataset, count, seed):
        first = start.track(start.prepare(question.reference), question.query).T_query_ref
        yield question.answer(ALONE, first)
        prepared = aligners["coarsest"].prepare(question.reference)
        for name, aligner in aligners.items():
            pose = None if first is None else aligner.track(prepared, question.query, first).T_query_ref
            yield question.answer(name, pose)


def table(name: str, answers: Mapping[int, Sequence[Answer]]) -> dict[str, Any]:
    """Print the rows of a group of pairs; the same as a mapping."""
    rows = (ALONE, *LEVELS)
    seeds = [seed for seed, of_seed in answers.items() if of_seed]
    by_row = {row: [[a for a in answers[seed] if a.row == row] for seed in seeds] for row in rows}
    pairs = sum(map(len, by_row[ALONE]))
    print(f"\n## {name}: {pairs} pairs of {len(seeds)} districts\n")
    print(
        "| begins on | right, % | r_auc@0.5deg | right, less the start | r_auc, less the start |\n|---|---|---|---|---|"
    )
    told: dict[str, Any] = {"pairs": pairs}
    both = [
        {row: [np.array([getattr(a, what) for a in d]) for d in by_row[row]] for row in rows}
        for what in ("right", "area")
    ]
    aligned = [(row, values) for row in LEVELS for values in both]
    less = controlled([paired_difference(values[row], values[ALONE], roads=seeds) for row, values in aligned])
    texts = {ALONE: ["", ""]} | {row: [] for row in LEVELS}
    for (row, _), difference in zip(aligned, less, strict=True):
        texts[row].append(in_points(difference))
    for row in rows:
        means = [100 * float(np.mean([d.mean() for d in values[row]])) for values in both]
        print(f"| {row} | {means[0]:.1f} | {means[1]:.1f} | {' | '.join(texts[row])} |")
        told[row] = {"right": means[0], "r_auc": means[1]}
    return told


if __name__ == "__main__":
    main()
