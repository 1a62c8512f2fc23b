"""From which starts the alignment of ``gn-net`` converges, on validation pairs.

For every pair the alignment starts at the identity, at the truth (which bounds what any start can achieve), and at the
poses found with several ``StartSettings``: with and without the windows that refine matches to the finest level, with
fewer points, with fewer RANSAC samples or others, and by OpenCV's MAGSAC in place of PoseLib. For each it prints how
close the start is to the truth, how many pairs end within 0.25 m and 2 degrees, how many do so if the identity is also
tried and the lower energy wins, and the processor time of matching and PnP.

    python benchmarks/publish/gn_net_starts.py [-d DATASET] [--pairs N] [--weights FILE]

``-d`` must have a validation split; without it a district is rendered. The last line is JSON.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"  # one core; read when numpy is imported

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from baselines.alignment.features.solver import FeatureAlignment, align_features
from baselines.alignment.shared.starts import Start
from baselines.feature_pnp.solve import Matches2D3D, ransac_pose
from baselines.gn_net.correspondence import Landmarks
from baselines.gn_net.start import MatchedLandmarks, StartSettings, find_landmarks
from baselines.gn_net.tracker import ONE_START, GnNet
from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair
from relocbench.geometry import rotation_angle

USUAL = StartSettings()


def evenly(matched: MatchedLandmarks) -> Array | None:
    """The pose from samples that are drawn evenly."""
    return matched.pose(0)


def best_first(matched: MatchedLandmarks) -> Array | None:
    """The pose from samples among the nearest features first."""
    return matched.pose(0, best_first=True)


def magsac(matched: MatchedLandmarks) -> Array | None:
    """The pose that OpenCV finds, from samples among the nearest features first."""
    count, limits = len(matched), matched.settings
    matches = Matches2D3D(matched.points, matched.pixels, np.ones(count), np.zeros_like(matched.points))
    return ransac_pose(
        matches, matched.camera, limits.threshold, limits.iterations, limits.confidence, 0, best_first=True
    )


KINDS: Mapping[str, tuple[StartSettings, Callable[[MatchedLandmarks], Array | None]]] = {
    "search level alone": (replace(USUAL, windows=(), threshold=8.0), evenly),
    "one level finer": (replace(USUAL, windows=USUAL.windows[:1], threshold=4.0), evenly),
    "to the finest level": (USUAL, evenly),
    "200 points": (replace(USUAL, points=200), evenly),
    "800 points": (replace(USUAL, points=800), evenly),
    "500 samples": (replace(USUAL, iterations=500), evenly),
    "threshold 1.5 px": (replace(USUAL, threshold=1.5), evenly),
    "threshold 3 px": (replace(USUAL, threshold=3.0), evenly),
    "nearest features first": (USUAL, best_first),
    "OpenCV's MAGSAC": (replace(USUAL, iterations=2000), magsac),
}


@dataclass
class Tally:
    """The results of one kind of start."""

    near: list[bool] = field(default_factory=list)
    """pairs whose start is within 0.5 m and 2 degrees"""
    found: list[bool] = field(default_factory=list)
    with_identity: list[bool] = field(default_factory=list)
    milliseconds: list[float] = field(default_factory=list)


def off(T_query_ref: Array, truth: Array) -> tuple[float, float]:
    """Translation error in metres and rotation error in degrees."""
    difference = np.linalg.inv(T_query_ref) @ truth
    return float(np.linalg.norm(difference[:3, 3])), float(np.degrees(rotation_angle(difference[:3, :3])))


def right(found: FeatureAlignment, truth: Array) -> bool:
    metres, degrees = off(found.T_query_ref, truth)
    return not found.failure and metres <= 0.25 and degrees <= 2.0


def better(one: FeatureAlignment, other: FeatureAlignment) -> FeatureAlignment:
    if one.failure or other.failure:
        return other if one.failure else one
    return one if one.final.energy <= other.final.energy else other


def some(landmarks: Landmarks, count: int) -> Landmarks:
    """At most ``count`` of them, drawn with seed 0."""
    rows = np.sort(np.random.default_rng(0).permutation(len(landmarks))[:count])
    return Landmarks(landmarks.points[rows], tuple(values[rows] for values in landmarks.values))


def tally_pairs(dataset: Dataset, pairs: list[tuple[PairSet, Pair]], weights: Path | None) -> dict[str, Tally]:
    """Align every pair from every start."""
    tallies = {name: Tally() for name in ("identity", "truth", *KINDS)}
    tracker = GnNet(weights, **ONE_START)
    tracker.start = replace(USUAL, points=max(kind.points for kind, _ in KINDS.values()))
    for pair_set, pair in pairs:
        truth = pair.T_query_ref
        query = dataset.query(pair_set, pair)
        reference = tracker.prepare(dataset.reference(pair_set, pair))
        features = tracker.features(query.image, query.camera)
        assert truth is not None
        align = partial(align_features, reference.features, features, settings=tracker.settings)
        from_identity = align(starts=[Start(np.eye(4))])
        tallies["identity"].found.append(right(from_identity, truth))
        tallies["truth"].found.append(right(align(starts=[Start(truth)]), truth))
        for name, (kind, solve) in KINDS.items():
            landmarks, tally = some(reference.landmarks, kind.points), tallies[name]
            since = time.process_time()
            start = solve(find_landmarks(landmarks, features, kind))
            tally.milliseconds.append(1e3 * (time.process_time() - since))
            if start is None:
                tally.near.append(False)
                tally.found.append(False)
                tally.with_identity.append(right(from_identity, truth))
                continue
            metres, degrees = off(start, truth)
            end = align(starts=[Start(start, kind.level)])
            tally.near.append(metres <= 0.5 and degrees <= 2.0)
            tally.found.append(right(end, truth))
            tally.with_identity.append(right(better(end, from_identity), truth))
    return tallies


def chosen(dataset: Dataset, count: int) -> list[tuple[PairSet, Pair]]:
    """``count`` pairs of the validation split, drawn with seed 0."""
    known = [(s, p) for s in dataset.pair_sets("validation") for p in s.pairs if p.T_query_ref is not None]
    return [known[i] for i in sorted(np.random.default_rng(0).permutation(len(known))[:count])]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-d", "--dataset", type=Path)
    parser.add_argument("--pairs", type=int, default=100)
    parser.add_argument("--weights", type=Path, help="weights file; default: the weights that come with the package")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        root = options.dataset or Path(folder) / "d"
        if options.dataset is None:
            subprocess.run(
                [sys.executable, "-m", "relocbench", "build-dataset", "synthetic", "--conditions",
                 "Sunny,Rain,Snow,Night,WetNoon", "--size", "512x512", "--cameras", "six", "--steps", "4",
                 "--speed", "14", "--split", "validation", "--seed", "51", "--reference", "all", "--correspondences",
                 "0", "--out", str(root), "-q"],
                check=True, stdout=sys.stderr,
            )  # fmt: skip
        dataset = Dataset(root)
        tallies = tally_pairs(dataset, chosen(dataset, options.pairs), options.weights)
    pairs = len(tallies["truth"].found)
    print(f"{pairs} pairs, %\n\n| start | near | found | found with identity | ms |\n|---|---|---|---|---|")
    told: dict[str, dict[str, float]] = {}
    for name, tally in tallies.items():
        row = {"found": 100 * float(np.mean(tally.found))}
        if tally.near:
            row |= {
                "near": 100 * float(np.mean(tally.near)),
                "with identity": 100 * float(np.mean(tally.with_identity)),
                "ms": float(np.median(tally.milliseconds)),
            }
        told[name] = row
        cells = [f"{row[key]:.1f}" if key in row else "" for key in ("near", "found", "with identity", "ms")]
        print(f"| {name} | {' | '.join(cells)} |")
    print(json.dumps({"benchmark": "gn_net_starts", "pairs": pairs, **told}))


if __name__ == "__main__":
    main()
