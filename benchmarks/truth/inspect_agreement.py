"""How many wrong true poses ``relocbench inspect`` sees in the images, and how often it doubts a right one.

The true pose of pairs is spoilt on purpose: the query's camera is turned about, or its centre moved in, a drawn
direction, so far that the keyframe's points move by 2, 5 or 10 pixels in the median. Counted are the verdicts of
``relocbench inspect`` at the true pose, where "apart" is a false alarm, and at spoilt ones, where "apart" is right and
"agree" a miss. Without DATASET a rendered district of the validation split is asked, all hundred combinations of ten
conditions; its truth is exact. That of a recording is not: what is "apart" at its true pose is to be looked at.

    python benchmarks/truth/inspect_agreement.py [DATASET ...] [--pairs N] [--seed S] [--scratch S]

It prints a table of each dataset by the conditions of keyframe and query; the last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.inspect.agreement import Verdict, measure_agreement
from relocbench.datasets.inspect.overlay import spread_pairs
from relocbench.datasets.pairs.visibility import ReferencePoints, warp
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS
from relocbench.geometry import make_transform, so3_exp
from relocbench.tracking import Query, Reference

OFFSETS_PX = (2.0, 5.0, 10.0)
TURNED, MOVED = "turned", "moved"
TRUTH = "truth"
SEED = 51
_POINTS = 2000
"""of the keyframe, whose median displacement is set"""
_MOST = {TURNED: np.radians(20.0), MOVED: 10.0}
_HALVINGS = 30


@dataclass(frozen=True)
class Asked:
    """A verdict on a pose."""

    conditions: tuple[str, str]
    what: str
    """:data:`TRUTH`, or how it was spoilt and by how many pixels"""
    verdict: Verdict


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", type=Path, nargs="*", metavar="DATASET")
    parser.add_argument("--pairs", type=int, default=2, help="pairs of each pair set")
    parser.add_argument("--seed", type=int, default=0, help="of what is spoilt")
    parser.add_argument("--scratch", type=Path, help="folder that keeps the rendered district")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as temporary:
        folders = options.datasets or [rendered(options.scratch or Path(temporary))]
        told = {folder.name: table(Dataset(folder), options.pairs, options.seed) for folder in folders}
    print(json.dumps({"benchmark": "inspect_agreement", **told}))


def rendered(scratch: Path) -> Path:
    """A district of the validation split in all conditions."""
    out = scratch / f"inspect-{SEED}"
    asked = ("--split", "validation", "--seed", SEED, "--steps", 6, "--speed", 20, "--size", "512x512", "--reference")
    words = ("--conditions", ",".join(CONDITIONS), "--cameras", "front", *asked, "all", "--correspondences", 0)
    command = ("relocbench", "build-dataset", "synthetic", *words, "--out", out, "-q")
    subprocess.run([sys.executable, "-m", *map(str, command)], check=True, stdout=sys.stderr)
    return out


def table(dataset: Dataset, pairs: int, seed: int) -> dict[str, dict[str, int]]:
    """Print the verdicts of a dataset; those of all conditions together."""
    asked = list(answers(dataset, pairs, seed))
    kinds = [TRUTH, *(f"{how} {px:g} px" for px in OFFSETS_PX for how in (TURNED, MOVED))]
    print(f"\n{dataset.name}: apart / agree / cannot tell or unseen\n")
    print(f"| keyframe | query | {' | '.join(kinds)} |\n|---|---|{'---|' * len(kinds)}")
    by_conditions: dict[tuple[str, str], list[Asked]] = defaultdict(list)
    for one in asked:
        by_conditions[one.conditions].append(one)
    for (reference, query), some in sorted(by_conditions.items()):
        print(f"| {reference} | {query} | {' | '.join(_counts(some, kind) for kind in kinds)} |")
    print(f"| all | all | {' | '.join(_counts(asked, kind) for kind in kinds)} |")
    return {kind: dict(Counter(one.verdict for one in asked if one.what == kind)) for kind in kinds}


def _counts(asked: Sequence[Asked], kind: str) -> str:
    found = Counter(one.verdict for one in asked if one.what == kind)
    return f"{found['apart']} / {found['agree']} / {found['cannot tell'] + found['unseen']}"


def answers(dataset: Dataset, pairs: int, seed: int) -> Iterator[Asked]:
    """The verdicts on the true and the spoilt poses of up to so many pairs of each pair set."""
    for pair_set in dataset.pair_sets():
        drives = dataset.traversal(pair_set.reference), dataset.traversal(pair_set.query)
        conditions = str(drives[0].condition), str(drives[1].condition)
        for pair in spread_pairs(pair_set.pairs, pairs):
            assert pair.T_query_ref is not None
            reference, query = dataset.reference(pair_set, pair), dataset.query(pair_set, pair)
            yield Asked(conditions, TRUTH, measure_agreement(reference, query, pair.T_query_ref).verdict)
            rng = np.random.default_rng([seed, *(time % 2**64 for time in pair.key)])
            for px in OFFSETS_PX:
                for how in (TURNED, MOVED):
                    spoilt = spoil(reference, query, pair.T_query_ref, px, how, rng)
                    verdict = measure_agreement(reference, query, spoilt).verdict
                    yield Asked(conditions, f"{how} {px:g} px", verdict)


def spoil(
    reference: Reference, query: Query, T_query_ref: Array, px: float, how: str, rng: np.random.Generator
) -> Array:
    """A pose (4, 4) under which the keyframe's points lie so many pixels from where they belong, in the median."""
    points = ReferencePoints.of(reference)
    points = points.take(np.unique(np.linspace(0, len(points) - 1, _POINTS).astype(int)))
    stacked = np.column_stack([points.uv, points.depth])
    right, _, seen = warp(stacked, reference.camera, query.camera, T_query_ref)
    seen &= query.camera.contains(right)
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)

    def spoilt(amount: float) -> Array:
        turn, move = (direction * amount, np.zeros(3)) if how == TURNED else (np.zeros(3), direction * amount)
        return np.asarray(make_transform(so3_exp(turn), move) @ T_query_ref)

    low, high = 0.0, float(_MOST[how])
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        wrong, _, known = warp(stacked, reference.camera, query.camera, spoilt(middle))
        apart = np.linalg.norm(wrong - right, axis=1)[seen & known]
        if len(apart) and np.median(apart) < px:
            low = middle
        else:
            high = middle
    return spoilt(low)


if __name__ == "__main__":
    main()
