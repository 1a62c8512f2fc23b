"""Whether alignment converges where the keyframe stands: weights of GN-Net on the validation districts.

Pairs of one place are drawn in each district as for the calibration (``calibration.py``). ``gn-net-from-prior`` runs
with each weights file, on all its levels, from three starts: the keyframe's own pose (the identity), a pose as far from
the truth as that in a random direction, and the truth. Printed is how many answers are within 0.25 m and 2 degrees, by
the light and the distance of the keyframe: means over districts, and for the keyframe's pose the difference to the
first weights with its 95 % interval.

The answers of a weights file are kept in ``--scratch`` under its SHA-256; when it is run again, only what is missing is
made.

    python benchmarks/publish/keyframe_start.py --scratch S [-w NAME=FILE ...] [--districts 51,52,53,100,101,102]

Without ``-w``, it asks the weights that come with the package. The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from calibration import CAMERA, VALIDATION, build_district, same_place

from baselines.gn_net.tracker import SHIPPED, GnNetFromPrior
from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.geometry import se3_exp
from relocbench.metrics import pose_errors
from relocbench.metrics.statistics.intervals import paired_difference

KEYFRAME, ASIDE, TRUTH = "the keyframe's pose", "as far, elsewhere", "the truth"
STARTS = (KEYFRAME, ASIDE, TRUTH)
POSITION_M, ANGLE_DEG, NEAR_M = 0.25, 2.0, 1.0


@dataclass(frozen=True)
class Answer:
    """How an alignment ended; errors are None where there is no pose."""

    start: str
    same_drive: bool
    distance_m: float
    conditions: tuple[str, str]
    translation_m: float | None
    rotation_deg: float | None

    @property
    def right(self) -> float:
        """1 if the answer is within the thresholds."""
        if self.translation_m is None or self.rotation_deg is None:
            return 0.0
        return float(self.translation_m <= POSITION_M and self.rotation_deg <= ANGLE_DEG)


GROUPS: Mapping[str, Callable[[Answer], bool]] = {
    "one drive": lambda answer: answer.same_drive,
    "different drives, keyframe within 1 m": lambda answer: not answer.same_drive and answer.distance_m <= NEAR_M,
    "different drives, farther off": lambda answer: not answer.same_drive and answer.distance_m > NEAR_M,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, required=True)
    parser.add_argument("--weights", "-w", action="append", help="NAME=FILE; repeat for several")
    parser.add_argument("--districts", default=",".join(map(str, VALIDATION)))
    parser.add_argument("--pairs", type=int, default=40, help="pairs of a district")
    parser.add_argument("--workers", "-j", type=int, default=2, help="processes that render")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    seeds = [int(part) for part in options.districts.split(",")]
    named = [text.partition("=") for text in options.weights or [f"shipped={SHIPPED / 'gn-net.safetensors'}"]]
    files = {name: Path(file) for name, _, file in named}
    answers = {name: {seed: answers_of(file, seed, options) for seed in seeds} for name, file in files.items()}
    told = {name: table(name, answers, chosen) for name, chosen in GROUPS.items()}
    print(json.dumps({"benchmark": "keyframe_start", **told}))


def answers_of(weights: Path, seed: int, options: argparse.Namespace) -> list[Answer]:
    """The answers with a weights file to the pairs of a district, kept in a file of JSON lines."""
    digest = sha256(weights.read_bytes()).hexdigest()[:16]
    path = Path(options.scratch) / "keyframe_start" / f"{digest}-{seed}-{options.pairs}.jsonl"
    if not path.exists():
        dataset = build_district(options.scratch, seed, options.workers)
        tracker = GnNetFromPrior(weights=weights, min_agreement=0.0)
        lines = [json.dumps(asdict(answer)) + "\n" for answer in ask(tracker, dataset, options.pairs, seed)]
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_text("".join(lines))
        part.rename(path)
    return [Answer(**json.loads(line)) for line in path.read_text().splitlines()]


def ask(tracker: GnNetFromPrior, dataset: Dataset, count: int, seed: int) -> Iterator[Answer]:
    """The answers to the pairs of a district from all starts."""
    rng = np.random.default_rng([seed, count])
    for pair in same_place(dataset, count, seed):
        assert pair.truth is not None
        prepared = tracker.prepare(dataset.traversal(pair.reference[0]).reference(CAMERA, pair.reference[1]))
        query = dataset.traversal(pair.query[0]).query(CAMERA, pair.query[1])
        still = pose_errors(np.eye(4)[None], pair.truth[None])
        metres, degrees = float(still.translation_error_m[0]), float(still.rotation_error_deg[0])
        starts = {KEYFRAME: None, ASIDE: beside(pair.truth, metres, degrees, rng), TRUTH: pair.truth}
        names = [str(dataset.traversal(drive).condition) for drive in (pair.reference[0], pair.query[0])]
        for name, start in starts.items():
            pose = tracker.track(prepared, query, start).T_query_ref
            errors: tuple[float | None, float | None] = (None, None)
            if pose is not None:
                found = pose_errors(pose[None], pair.truth[None])
                errors = float(found.translation_error_m[0]), float(found.rotation_error_deg[0])
            same_drive = pair.reference[0] == pair.query[0]
            yield Answer(name, same_drive, metres, (names[0], names[1]), *errors)


def beside(T_query_ref: Array, metres: float, degrees: float, rng: np.random.Generator) -> Array:
    """A pose so far from a given one, in random directions."""
    aside, axis = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
    turned = se3_exp(np.concatenate([np.zeros(3), np.deg2rad(degrees) * axis])) @ T_query_ref
    turned[:3, 3] = T_query_ref[:3, 3] + metres * aside
    return np.asarray(turned)


def table(name: str, answers: Mapping[str, Mapping[int, Sequence[Answer]]], chosen: Callable[[Answer], bool]) -> Any:
    """Print the rows of a group of pairs; the same as a mapping."""
    first = next(iter(answers))
    seeds = [seed for seed in answers[first] if any(map(chosen, answers[first][seed]))]
    right = {
        (weights, start): [
            np.array([a.right for a in of_weights[seed] if chosen(a) and a.start == start]) for seed in seeds
        ]
        for weights, of_weights in answers.items()
        for start in STARTS
    }
    pairs = sum(map(len, right[first, KEYFRAME]))
    print(f"\n## {name}: {pairs} pairs of {len(seeds)} districts, right answers in %\n")
    print(f"| weights | {' | '.join(f'from {start}' for start in STARTS)} | from {KEYFRAME}, less {first} |")
    print("|---|---|---|---|---|")
    told: dict[str, Any] = {"pairs": pairs}
    for weights in answers:
        means = [100 * float(np.mean([d.mean() for d in right[weights, start]])) for start in STARTS]
        less = ""
        if weights != first:
            found = paired_difference(right[weights, KEYFRAME], right[first, KEYFRAME], roads=seeds)
            less = f"{100 * found.mean:+.1f}"
            if found.interval:
                less += f" [{100 * found.interval.low:.1f}, {100 * found.interval.high:.1f}]"
        print(f"| {weights} | {' | '.join(f'{mean:.1f}' for mean in means)} | {less} |")
        told[weights] = dict(zip(STARTS, means, strict=True))
    return told


if __name__ == "__main__":
    main()
