"""Fit the confidences of the trackers on some validation districts, and see on others what they are worth.

In each district drives in three conditions are rendered. Pairs are drawn from all images of the district that are at
most 14 m and 45 degrees apart (``--pairs``), and between its keyframes and images of another district
(``--different``), where nothing can be answered and every answer is wrong. These are fitted to; a dataset's own pairs
of different places (``build-dataset --elsewhere``), which lie in one district, test what came of it. ``--edition E``
adds the pairs of the validation split of an edition (``build-dataset edition``) that is in the folder E: of the tiers
medium, hard and extreme, the first half of the districts to those that are fitted, and the others as a report of each
tier. Every method answers all pairs, however little speaks for its answer. On the districts of ``--fit`` a logistic
regression, never falling in the evidence, predicts which answers are within 0.25 m and 2 degrees. Printed are its
coefficients, to be written into ``baselines/calibration.py``; how many right and wrong answers each limit on the
evidence would refuse; and, for the districts of ``--report``, how often answers of each confidence are right, how
precise those of at least 0.5 are, in all and of queries and keyframes of one drive, and how many pairs of different
places have one.

Datasets and answers are kept in ``--scratch``; when it is run again, only what is missing is made.

    python benchmarks/publish/calibration.py --scratch S [--edition E] [-m METHOD ...]

``-m aliked-pnp`` needs its authors' weights where the method looks for them, and is not among the default methods. The
last line is JSON.
"""

from __future__ import annotations

import argparse
import inspect
import itertools
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from scipy.optimize import minimize
from scipy.special import expit

from baselines.calibration import Calibration
from baselines.dso import Dso, DsoMultiStart
from baselines.feature_pnp import OrbPnp, SiftPnp
from baselines.gn_net.tracker import GnNet, GnNetContrastive, GnNetFromPrior, GnNetPnp, LmNet
from baselines.learned_pnp import AlikedPnp
from relocbench.arrays import Array, Mask
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.edition_folder import datasets_of
from relocbench.geometry import invert, rotation_angle
from relocbench.metrics import pose_errors
from relocbench.tracking import Query, TrackResult

Frame = tuple[str, int]
"""traversal and timestamp of an image"""

VALIDATION = {
    51: ("Sunny", "Night", "Rain"),
    52: ("WetNoon", "Snow", "Overcast"),
    53: ("WetNoon", "Night", "Fog"),
    100: ("WetNoon", "Night", "Snow"),
    101: ("Sunny", "WetCloudySunset", "Fog"),
    102: ("Overcast", "Night", "Rain"),
}
"""the conditions of each district; none of them is a test district"""
FORMER_TESTS = (100, 101, 102)
"""validation districts that lie in the split ``test`` of the procedural town"""
CAMERA = "front"
FARTHEST_M, WIDEST_DEG = 14.0, 45.0
REMEMBERED = 200
"""images whose features a method keeps for the pairs that show them again: those of two districts"""
METHODS: Mapping[str, Callable[[], Any]] = {
    "gn-net": lambda: GnNet(min_agreement=0.0, cache_size=REMEMBERED),
    "gn-net-pnp": lambda: GnNetPnp(min_agreement=0.0, cache_size=REMEMBERED),
    "gn-net-from-prior": lambda: GnNetFromPrior(min_agreement=0.0, cache_size=REMEMBERED),
    "gn-net-contrastive": lambda: GnNetContrastive(min_agreement=0.0, cache_size=REMEMBERED),
    "lm-net": lambda: LmNet(min_agreement=0.0, cache_size=REMEMBERED),
    "dso": lambda: Dso(min_correlation=-1.0),
    "dso-multistart": lambda: DsoMultiStart(min_correlation=-1.0),
    "orb-pnp": OrbPnp,
    "sift-pnp": SiftPnp,
    "aliked-pnp": lambda: AlikedPnp(cache_size=REMEMBERED),
}
"""each without a limit on the evidence of its answers"""
GIVEN_WEIGHTS = ("aliked-pnp",)
"""methods whose weights the user has to fetch"""
EDGES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
"""of the confidences that are counted together"""
TIERS = ("medium", "hard", "extreme")
"""of an edition; in the easy one hardly any answer is wrong"""
CAUTION = 8.0
"""how often a wrong answer counts in the fit, so that confidences are lower estimates: one of 0.5 stands for odds of
eight to one. In districts whose streets repeat themselves more answers are wrong that look right"""
RIDGE = 1e-3
"""weight of the squared coefficients beside the mean log loss, evidence in units of its standard deviation"""


@dataclass(frozen=True)
class Asked:
    """A pair to be answered."""

    reference: Frame
    query: Frame
    truth: Array | None
    """(4, 4) T_query_ref; None for different places"""


@dataclass(frozen=True)
class Answered:
    """What a method made of a pair."""

    different: bool
    """whether the pair shows different places"""
    same_drive: bool
    """whether both images are of one drive, so that a keyframe is a step of the drive away"""
    answered: bool
    right: bool
    info: dict[str, Any]


def main() -> None:
    options = _options()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as temporary:
        scratch = options.scratch or Path(temporary)
        seeds = {"fit": _seeds(options.fit), "report": _seeds(options.report)}
        told = {}
        for seed in itertools.chain.from_iterable(seeds.values()):
            build_district(scratch, seed, options.workers)
        for method in options.methods:
            answers: dict[str, list[Answered]] = {"fit": [], "report": []}
            for role, districts in seeds.items():
                for seed in districts:
                    answers[role] += _answers(scratch, method, seed, neighbour(seed, districts), options)
            for tier in TIERS if options.edition else ():
                folders = datasets_of(options.edition / tier)
                for at, folder in enumerate(folders):
                    role = "fit" if 2 * at < len(folders) else tier
                    answers.setdefault(role, []).extend(_of_district(scratch, method, folder))
            told[method] = _told(method, METHODS[method]().calibration, answers)
    print(json.dumps({"benchmark": "calibration", **told}))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, help="folder that keeps datasets and answers; default: a temporary one")
    parser.add_argument("--fit", default="51,52,53", help="seeds of the districts that are fitted")
    parser.add_argument("--report", default="100,101,102", help="seeds of the districts that are reported")
    parser.add_argument("--edition", type=Path, help="folder of the validation split of an edition; default: none")
    parser.add_argument("--pairs", type=int, default=150, help="pairs of a district")
    parser.add_argument("--different", type=int, default=50, help="pairs of different places of a district")
    parser.add_argument("--workers", "-j", type=int, default=2, help="processes that render")
    parser.add_argument("-m", dest="methods", action="append", choices=METHODS, help="default: all that ship weights")
    options = parser.parse_args()
    options.methods = options.methods or [method for method in METHODS if method not in GIVEN_WEIGHTS]
    return options


def _seeds(text: str) -> list[int]:
    seeds = [int(part) for part in text.split(",")]
    unknown = [seed for seed in seeds if seed not in VALIDATION]
    if unknown or len(seeds) < 2:
        sys.exit(f"two or more districts of {', '.join(map(str, VALIDATION))} are needed, not {text}")
    return seeds


def neighbour(seed: int, seeds: Sequence[int]) -> int:
    """The district whose images are shown as a different place: the one before, for the first one the one after."""
    at = seeds.index(seed)
    return seeds[at - 1] if at else seeds[1]


def build_district(scratch: Path, seed: int, workers: int) -> Dataset:
    """A validation district, rendered unless it is there."""
    split = "test" if seed in FORMER_TESTS else "validation"
    words = (
        "build-dataset", "synthetic", "--name", f"d{seed}", "--conditions", ",".join(VALIDATION[seed]),
        "--cameras", CAMERA, "--size", "512x512", "--steps", 26, "--speed", 40, "--reference", "all",
        "--split", split, "--seed", seed, "--correspondences", 0, "--out", _data(scratch, seed), "-j", workers, "-q",
    )  # fmt: skip
    subprocess.run([sys.executable, "-m", "relocbench", *map(str, words)], check=True, stdout=sys.stderr)
    return Dataset(_data(scratch, seed))


def _data(scratch: Path, seed: int) -> Path:
    return scratch / "data" / f"d{seed}"


def _answers(scratch: Path, method: str, seed: int, other: int, options: argparse.Namespace) -> list[Answered]:
    """The answers of a method to the pairs of a district, kept in a file of JSON lines."""
    dataset, elsewhere = Dataset(_data(scratch, seed)), Dataset(_data(scratch, other))

    def asked(tracker: Any) -> Iterator[Answered]:
        yield from ask(tracker, dataset, dataset, same_place(dataset, options.pairs, seed))
        yield from ask(tracker, dataset, elsewhere, different_places(dataset, elsewhere, options.different, seed))

    return _kept(scratch, method, f"{seed}-{options.pairs}-{options.different}", asked)


def _of_district(scratch: Path, method: str, folder: Path) -> list[Answered]:
    """The answers of a method to the pairs of a district of an edition."""
    dataset = Dataset(folder)
    pairs = [
        Asked((of.reference, pair.ref_timestamp_ns), (of.query, pair.query_timestamp_ns), pair.T_query_ref)
        for of in map(dataset.pair_set, dataset.pair_set_names)
        for pair in of.pairs
    ]
    in_order = sorted(pairs, key=lambda pair: (pair.reference, pair.query))
    return _kept(scratch, method, dataset.name, lambda tracker: ask(tracker, dataset, dataset, in_order))


def _kept(scratch: Path, method: str, name: str, asked: Callable[[Any], Iterable[Answered]]) -> list[Answered]:
    """The answers of a method, kept in a file of JSON lines."""
    path = scratch / "answers" / f"{method}-{made_by(type(METHODS[method]()))}-{name}.jsonl"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_text("".join(f"{json.dumps(asdict(each))}\n" for each in asked(METHODS[method]())))
        part.rename(path)
    return [Answered(**json.loads(line)) for line in path.read_text().splitlines()]


def made_by(kind: type) -> str:
    """A digest of the defaults and weights of a method: answers of others are not kept ones."""
    digest = sha256(f"{kind.__qualname__}{inspect.signature(kind)}".encode())
    if hasattr(kind, "files"):
        for _, path in sorted(kind.files().items()):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def same_place(dataset: Dataset, count: int, seed: int) -> list[Asked]:
    """Pairs of near images of one district, drawn at random, nearer ones with larger probability.

    Images of one drive are 4 m apart and more; the next ones of a drive count like near ones of different drives.
    """
    frames = _frames(dataset)
    poses = {frame: dataset.traversal(frame[0]).T_world_cam(CAMERA, frame[1]) for frame in frames}
    near, weights = [], []
    for reference, query in itertools.permutations(frames, 2):
        T_query_ref = invert(poses[query]) @ poses[reference]
        metres = np.linalg.norm(poses[query][:3, 3] - poses[reference][:3, 3])
        if metres <= FARTHEST_M and np.degrees(rotation_angle(T_query_ref[:3, :3])) <= WIDEST_DEG:
            near.append(Asked(reference, query, T_query_ref))
            next_of_drive = reference[0] == query[0] and metres < 6.0
            weights.append(3.0 if metres < 2.0 or next_of_drive else 1.0 if metres < 6.0 else 0.5)
    share = np.array(weights) / np.sum(weights)
    drawn = np.random.default_rng(seed).choice(len(near), min(count, len(near)), replace=False, p=share)
    return sorted((near[i] for i in drawn), key=lambda pair: (pair.reference, pair.query))


def different_places(dataset: Dataset, other: Dataset, count: int, seed: int) -> list[Asked]:
    """Keyframes of one district with images of another, drawn at random."""
    rng, keyframes, queries = np.random.default_rng(seed), _frames(dataset), _frames(other)
    drawn = [(keyframes[rng.integers(len(keyframes))], queries[rng.integers(len(queries))]) for _ in range(count)]
    return [Asked(reference, query, None) for reference, query in sorted(drawn)]


def _frames(dataset: Dataset) -> list[Frame]:
    return [(name, time) for name in dataset.traversal_names for time in dataset.traversal(name).timestamps(CAMERA)]


def ask(tracker: Any, dataset: Dataset, queries: Dataset, pairs: Iterable[Asked]) -> Iterator[Answered]:
    """The answers of a tracker to pairs of keyframes of one dataset and images of another."""
    for reference, of_reference in itertools.groupby(pairs, lambda pair: pair.reference):
        prepared = tracker.prepare(dataset.traversal(reference[0]).reference(CAMERA, reference[1]))
        for pair in of_reference:
            query: Query = queries.traversal(pair.query[0]).query(CAMERA, pair.query[1])
            result: TrackResult = tracker.track(prepared, query)
            numbers = {name: value for name, value in result.info.items() if isinstance(value, int | float)}
            same_drive = dataset is queries and pair.reference[0] == pair.query[0]
            yield Answered(pair.truth is None, same_drive, result.answered, _right(result, pair.truth), numbers)


def _right(result: TrackResult, truth: Array | None) -> bool:
    if result.T_query_ref is None or truth is None:
        return False
    errors = pose_errors(result.T_query_ref[None], truth[None])
    return bool(errors.translation_error_m[0] <= 0.25 and errors.rotation_error_deg[0] <= 2.0)


def fit(evidence: Array, right: Mask, names: Sequence[str], caution: float = 1.0) -> Calibration:
    """Fit a logistic regression whose weights are not negative to evidence (N, D) of answers that are right or wrong.

    Minimised is the mean log loss, in which a wrong answer counts ``caution`` times, with a little of the squared
    weights so that evidence that separates right from wrong without any exception has finite ones.
    """
    middle, spread = evidence.mean(axis=0), np.maximum(evidence.std(axis=0), 1e-12)
    scaled, sign = (evidence - middle) / spread, np.where(right, 1.0, -1.0)
    share = np.where(right, 1.0, caution)
    share /= share.sum()

    def loss(free: Array) -> tuple[float, Array]:
        margin = sign * (free[0] + scaled @ free[1:])
        slope = -sign * expit(-margin) * share
        value = float(share @ np.logaddexp(0.0, -margin) + RIDGE * np.sum(free[1:] ** 2))
        return value, np.concatenate([[slope.sum()], scaled.T @ slope + 2.0 * RIDGE * free[1:]])

    bounds = [(None, None), *[(0.0, None)] * len(names)]
    found = minimize(loss, np.zeros(1 + len(names)), jac=True, method="L-BFGS-B", bounds=bounds).x
    weights = found[1:] / spread
    return Calibration(float(found[0] - weights @ middle), dict(zip(names, weights.tolist(), strict=True)))


def _told(method: str, kept: Calibration, answers: Mapping[str, list[Answered]]) -> dict[str, Any]:
    """Print what was fitted for a method and what it is worth; the same as a mapping."""
    names = list(kept.weights)
    given = [each for each in answers["fit"] if each.answered]
    evidence = np.array([[each.info[name] for name in names] for each in given]).reshape(-1, len(names))
    right = np.array([each.right for each in given], dtype=bool)
    found = fit(evidence, right, names, CAUTION)
    weights = ", ".join(f'"{name}": {weight:.4g}' for name, weight in found.weights.items())
    print(f"\n## {method}\n\nfitted to {len(given)} answers: Calibration({found.offset:.4g}, {{{weights}}})\n")
    print(f"| {names[0]} at least | right refused, % | wrong refused, % |\n|---|---|---|")
    for limit in np.quantile(evidence[~right, 0], (0.25, 0.5, 0.75, 0.9, 1.0)) if np.any(~right) else ():
        refused = evidence[:, 0] < limit
        print(f"| {limit:.4g} | {_percent(refused[right])} | {_percent(refused[~right])} |")
    worth: dict[str, Any] = {"found": {"offset": found.offset, **found.weights}}
    for role, of_role in answers.items():
        worth[role] = reliability(of_role, kept)
        print(f"\n{role}: {json.dumps({key: value for key, value in worth[role].items() if key != 'bins'})}\n")
        print("| confidence | answers | mean confidence | right, % |\n|---|---|---|---|")
        for row in worth[role]["bins"]:
            cells = f"{row['from']:g} to {row['to']:g}", str(row["answers"]), f"{row['mean']:.2f}"
            print(f"| {' | '.join(cells)} | {100 * row['right']:.0f} |")
    return worth


def _percent(chosen: Mask) -> str:
    return f"{100 * np.mean(chosen):.1f}" if len(chosen) else "-"


def _share(chosen: Mask) -> float | None:
    return float(np.mean(chosen)) if len(chosen) else None


def reliability(answers: Sequence[Answered], calibration: Calibration) -> dict[str, Any]:
    """How often answers of each confidence are right, and what is wrong among those of at least 0.5."""
    confidence = np.array([calibration.confidence(a.info) if a.answered else 0.0 for a in answers])
    answered, right, different, same_drive = (
        np.array([getattr(a, name) for a in answers], dtype=bool)
        for name in ("answered", "right", "different", "same_drive")
    )
    sure = answered & (confidence >= 0.5)
    rows = []
    for low, high in itertools.pairwise(EDGES):
        within = answered & (confidence >= low) & ((confidence < high) | (high == EDGES[-1]))
        if np.any(within):
            mean, share = float(confidence[within].mean()), float(right[within].mean())
            rows.append({"from": low, "to": high, "answers": int(within.sum()), "mean": mean, "right": share})
    return {
        "pairs of one place": int(np.sum(~different)),
        "right": int(right.sum()),
        "sure": int(sure.sum()),
        "precision of sure ones": _share(right[sure]),
        "sure, in one drive": int(np.sum(sure & same_drive)),
        "precision in one drive": _share(right[sure & same_drive]),
        "right ones that are sure": _share(sure[right]),
        "pairs of different places": int(different.sum()),
        "sure of different places": _share(sure[different]),
        "bins": rows,
    }


if __name__ == "__main__":
    main()
