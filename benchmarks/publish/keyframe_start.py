"""Whether alignment converges where the keyframe stands: weights of GN-Net on the validation districts.

Pairs of one place are drawn in each district as for the calibration (``calibration.py``). ``gn-net-from-prior`` runs
with each weights file from three priors: the keyframe's own pose (the identity), a pose as far from the truth as that
in a random direction, and the truth, and by default along the road from there too; ``gn-net`` starts from the
keyframe's pose, along the road and from its own matches. Printed is how many answers are within 0.25 m and 2 degrees,
by the light and the distance of the keyframe: means over districts, and the difference to the first weights with its
95 % interval; a star marks those that are significant with one error rate for all of a table. Other trackers (``-m``)
stand beside them.

The answers of a weights file are kept in ``--scratch`` under its SHA-256; when it is run again, only what is missing is
made.

    python benchmarks/publish/keyframe_start.py --scratch S [-w NAME=FILE[,KEY=VALUE...] ...] [-m METHOD ...]

A KEY is a parameter of the tracker: ``-w both=mine.safetensors,first_levels=4,halvings=1``; the KEY ``one_start`` has
no value, and stands for those of one alignment from the prior alone. Without ``-w``, it asks the weights that come with
the package. The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from answers import Answer, kept, questions
from calibration import VALIDATION, build_district, made_by

from baselines.feature_cache import FeatureCache
from baselines.gn_net.method import SHIPPED
from baselines.gn_net.tracker import ONE_START, GnNet
from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.geometry import se3_exp
from relocbench.methods import parse_method
from relocbench.metrics import controlled, in_points, paired_difference

KEYFRAME, ASIDE, TRUTH, MATCHES = "the keyframe's pose", "as far, elsewhere", "the truth", "its matches too"
STARTS = (KEYFRAME, ASIDE, TRUTH, MATCHES)
NEAR_M = 1.0
ONE = "one_start"
IMAGES = 500
"""whose feature maps are kept: those of all districts"""
_REMEMBERED: dict[tuple[str, int], FeatureCache[Any]] = {}
"""by the digest of the weights and the halvings of the image"""

GROUPS: Mapping[str, Callable[[Answer], bool]] = {
    "one drive": lambda answer: answer.same_drive,
    "different drives, keyframe within 1 m": lambda answer: not answer.same_drive and answer.distance_m <= NEAR_M,
    "different drives, farther off": lambda answer: not answer.same_drive and answer.distance_m > NEAR_M,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, required=True)
    parser.add_argument("--weights", "-w", action="append", help="NAME=FILE[,KEY=VALUE...]; repeat for several")
    parser.add_argument(
        "--method", "-m", action="append", default=[], help="another tracker, METHOD[,KEY=VALUE...]; repeat for several"
    )
    parser.add_argument("--districts", default=",".join(map(str, VALIDATION)))
    parser.add_argument("--pairs", type=int, default=40, help="pairs of a district")
    parser.add_argument("--workers", "-j", type=int, default=2, help="processes that render")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    seeds = [int(part) for part in options.districts.split(",")]
    named = [text.partition("=") for text in options.weights or [f"shipped={SHIPPED / 'gn-net.safetensors'}"]]
    missing = [file for file in (split(given)[0] for _, _, given in named) if not Path(file).is_file()]
    if missing:
        parser.error(
            f"no such file: {', '.join(missing)}; docs/weights.md says how to train the weights of other seeds"
        )
    answers = {name: {seed: answers_of(given, seed, options) for seed in seeds} for name, _, given in named}
    answers |= {name: {seed: answers_of_other(name, seed, options) for seed in seeds} for name in options.method}
    told = {name: table(name, answers, chosen) for name, chosen in GROUPS.items()}
    print(json.dumps({"benchmark": "keyframe_start", **told}))


def answers_of(asked: str, seed: int, options: argparse.Namespace) -> list[Answer]:
    """The answers with a weights file and parameters (FILE,KEY=VALUE...) to the pairs of a district."""
    file, *settings = split(asked)
    if ONE in settings:
        settings.remove(ONE)
        settings = [*(f"{name}={json.dumps(value)}" for name, value in ONE_START.items()), *settings]
    digest = sha256(Path(file).read_bytes()).hexdigest()[:16]
    name = "-".join([digest, made_by(GnNet), *(text.replace(" ", "") for text in settings), f"{seed}-{options.pairs}"])
    path = Path(options.scratch) / "keyframe_start" / f"{name}.jsonl"

    def make() -> Iterator[Answer]:
        trackers: list[GnNet] = [
            parse_method(name, [*settings, f"weights={file}", "min_agreement=0"]).create()
            for name in ("gn-net-from-prior", "gn-net")
        ]
        for tracker in trackers:
            # Trackers that differ in their parameters alone take each image through the network once.
            tracker._cache = _REMEMBERED.setdefault((digest, tracker.halvings), FeatureCache(IMAGES))
        return ask(*trackers, build_district(options.scratch, seed, options.workers), options.pairs, seed)

    return kept(path, make)


def split(asked: str) -> list[str]:
    """``NAME,KEY=VALUE,KEY=[VALUE,VALUE]`` at its outer commas."""
    return re.split(rf",(?=\w+=|{ONE}(?:,|$))", asked)


def answers_of_other(asked: str, seed: int, options: argparse.Namespace) -> list[Answer]:
    """The answers of another tracker (METHOD,KEY=VALUE...), which is given no prior."""
    method, *settings = split(asked)
    by = made_by(type(parse_method(method, settings).create()))
    path = Path(options.scratch) / "keyframe_start" / f"{asked}-{by}-{seed}-{options.pairs}.jsonl"

    def make() -> Iterator[Answer]:
        tracker = parse_method(method, settings).create()
        for question in questions(build_district(options.scratch, seed, options.workers), options.pairs, seed):
            found = tracker.track(tracker.prepare(question.reference), question.query)
            yield question.answer(KEYFRAME, found.T_query_ref)

    return kept(path, make)


def ask(alone: GnNet, matched: GnNet, dataset: Dataset, count: int, seed: int) -> Iterator[Answer]:
    """The answers to the pairs of a district from all starts."""
    rng = np.random.default_rng([seed, count])
    for question in questions(dataset, count, seed):
        aside = beside(question.truth, question.metres, question.degrees, rng)
        prepared = alone.prepare(question.reference)
        for row, start in {KEYFRAME: None, ASIDE: aside, TRUTH: question.truth}.items():
            yield question.answer(row, alone.track(prepared, question.query, start).T_query_ref)
        yield question.answer(MATCHES, matched.track(prepared, question.query).T_query_ref)


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
            np.array([a.right for a in of_weights[seed] if chosen(a) and a.row == start]) for seed in seeds
        ]
        for weights, of_weights in answers.items()
        for start in STARTS
        if any(a.row == start for of_seed in of_weights.values() for a in of_seed)
    }
    pairs = sum(map(len, right[first, KEYFRAME]))
    print(f"\n## {name}: {pairs} pairs of {len(seeds)} districts, right answers in %\n")
    print(
        f"| weights | {' | '.join(f'from {start}' for start in STARTS)} | from {KEYFRAME}, less {first} | "
        f"from {MATCHES}, less {first} |\n|---|---|---|---|---|---|---|"
    )
    told: dict[str, Any] = {"pairs": pairs}
    compared = [(name, start) for name, start in right if name != first and start in (KEYFRAME, MATCHES)]
    less = controlled([paired_difference(right[each], right[first, each[1]], roads=seeds) for each in compared])
    texts = dict(zip(compared, map(in_points, less), strict=True))
    for weights in answers:
        means = {start: 100 * float(np.mean([d.mean() for d in right[w, start]])) for w, start in right if w == weights}
        cells = [f"{means[start]:.1f}" if start in means else "" for start in STARTS]
        cells += [texts.get((weights, start), "") for start in (KEYFRAME, MATCHES)]
        print(f"| {weights} | {' | '.join(cells)} |")
        told[weights] = means
    return told


if __name__ == "__main__":
    main()
