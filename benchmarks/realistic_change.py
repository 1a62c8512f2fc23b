"""How much conditions change: how alike the same patches look, and how many pairs trackers solve.

One drive in each condition of the town, all along one route. First table: the zero-mean normalised cross-correlation
(ZNCC) of corresponding patches for each pair of conditions, frames about 0.5 m apart. A patch is 11 x 11 pixels of the
reference; each of its pixels is carried to the query by its own depth and the true pose, so that neither motion nor
perspective lowers the figure. Patches are on a grid of 8 pixels; all their pixels must be seen in the query, and the
grey levels of the reference's patch must vary (standard deviation of at least 8). Second table: recall@(0.25m,2deg)
of trackers within each condition and from the first one to each other, at about 0.8 m. JSON on the last line.

    python benchmarks/realistic_change.py [--steps N] [--split validation] [--seed N] [--conditions A,B]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.dataset import Dataset, Traversal
from relocbench.datasets.importers import Run, importer
from relocbench.datasets.layout import pair_set_name
from relocbench.datasets.pairfile import write_pairs
from relocbench.datasets.pairing import PosedFrames
from relocbench.datasets.synthetic.condition import CONDITIONS
from relocbench.datasets.synthetic.pairs import DistanceSpread, drawn_pairs
from relocbench.datasets.visibility import warp
from relocbench.datasets.writer import DatasetWriter
from relocbench.evaluation.evaluate import EvaluateOptions, evaluate_methods
from relocbench.execution import default_workers
from relocbench.geometry import invert
from relocbench.progress import Silent

Array = NDArray[np.float64]

CAMERA = "front"
_PATCH = 11
_STRIDE = 8
_LEAST_CONTRAST = 8.0
"""standard deviation of a patch in grey levels, well above the noise of any condition"""
_APART_M = 0.5
_MEAN_M, _FARTHEST_M = 0.8, 3.0
"""distances of the pairs that trackers are asked"""
_RECALL = "recall@(0.25m,2deg)"


class Frames:
    """Grey images, depth and poses of one traversal; read once."""

    def __init__(self, traversal: Traversal) -> None:
        self.camera = traversal.camera(CAMERA)
        times = traversal.timestamps(CAMERA)
        self.grey = [cv2.cvtColor(traversal.image(CAMERA, t), cv2.COLOR_RGB2GRAY) for t in times]
        self.depth = [traversal.depth(CAMERA, t) for t in times]
        self.T_world_cam = np.array([traversal.T_world_cam(CAMERA, t) for t in times])

    def apart(self, T_world_ref: Array) -> int:
        """The frame whose distance from a pose is nearest to ``_APART_M``."""
        distance = np.linalg.norm(self.T_world_cam[:, :3, 3] - T_world_ref[:3, 3], axis=1)
        return int(np.argmin(np.abs(distance - _APART_M)))


def patch_correlations(reference: Frames, r: int, query: Frames, q: int) -> Array:
    """ZNCC (N,) of all patches of a reference frame that the query sees whole."""
    camera = reference.camera
    half = _PATCH // 2
    v, u = np.meshgrid(
        np.arange(half, camera.height - half, _STRIDE), np.arange(half, camera.width - half, _STRIDE), indexing="ij"
    )
    dv, du = np.mgrid[-half : half + 1, -half : half + 1].reshape(2, -1)
    v, u = v.reshape(-1, 1) + dv, u.reshape(-1, 1) + du
    here = reference.grey[r][v, u].astype(np.float64)
    depth_ref, depth_query = reference.depth[r], query.depth[q]
    assert depth_ref is not None
    assert depth_query is not None
    depth = depth_ref[v, u].astype(np.float64)
    keep = (here.std(axis=1) >= _LEAST_CONTRAST) & (depth > 0).all(axis=1)
    u, v, here, depth = u[keep], v[keep], here[keep], depth[keep]
    T_query_ref = invert(query.T_world_cam[q]) @ reference.T_world_cam[r]
    points = np.column_stack([u.ravel(), v.ravel(), depth.ravel()])
    uv, z, valid = warp(points, camera, query.camera, T_query_ref)
    valid &= query.camera.contains(uv)
    nearest = np.rint(np.where(valid[:, None], uv, 0)).astype(int)
    # Half a pixel on slanted ground changes its depth by some percent.
    seen = valid & (np.abs(depth_query[nearest[:, 1], nearest[:, 0]] - z) < 0.05 + 0.03 * z)
    whole = seen.reshape(here.shape).all(axis=1)
    x, y = np.where(valid[:, None], uv, 0).astype(np.float32).T
    there = cv2.remap(
        query.grey[q].astype(np.float32), x.reshape(here.shape), y.reshape(here.shape), cv2.INTER_LINEAR
    ).astype(np.float64)
    a, b = (k[whole] - k[whole].mean(axis=1, keepdims=True) for k in (here, there))
    scale = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    # A patch that is plain in the query correlates with nothing.
    return np.asarray(np.where(scale > 0, np.sum(a * b, axis=1) / np.maximum(scale, 1e-12), 0.0))


def correlate(dataset: Dataset, names: list[str], frames_a_pair: int) -> dict[str, dict[str, dict[str, float]]]:
    """reference condition -> query condition -> median and mean ZNCC, number of patches."""
    read = {name: Frames(dataset.traversal(traversal_of(dataset, name))) for name in names}
    table: dict[str, dict[str, dict[str, float]]] = {}
    for a, reference in read.items():
        print(f"patches of {a}", file=sys.stderr)
        rows = np.linspace(0, len(reference.grey) - 1, min(frames_a_pair, len(reference.grey))).round().astype(int)
        for b, query in read.items():
            found = [
                patch_correlations(reference, r, query, query.apart(reference.T_world_cam[r])) for r in rows.tolist()
            ]
            values = np.concatenate(found)
            table.setdefault(a, {})[b] = {
                "median": round(float(np.median(values)), 3),
                "mean": round(float(np.mean(values)), 3),
                "patches": len(values),
            }
    return table


def traversal_of(dataset: Dataset, condition: str) -> str:
    """Name of the drive in a condition."""
    return next(name for name in dataset.traversal_names if name.split("-")[1] == condition)


def asked_sets(dataset: Dataset, names: list[str]) -> dict[tuple[str, str], str]:
    """(reference, query) condition -> pair set: each condition with itself, and the first with each other."""
    asked = [(name, name) for name in names] + [(names[0], name) for name in names[1:]]
    return {(a, b): pair_set_name(traversal_of(dataset, a), traversal_of(dataset, b), CAMERA) for a, b in asked}


def with_pairs_within(town: Dataset, names: list[str], seed: int, out: Path) -> Dataset:
    """The frames of ``town``, linked, with pairs within every condition, where it has those of the first alone."""
    writer = DatasetWriter(out, f"{town.name}-within", {"kind": "realistic-change", "seed": seed})
    frames = {}
    for name in names:
        traversal = town.traversal(traversal_of(town, name))
        times = tuple(traversal.timestamps(CAMERA))
        writer.traversal(traversal.file, traversal.poses)
        T_world_cam = np.array([traversal.T_world_cam(CAMERA, t) for t in times])
        frames[name] = PosedFrames(times, T_world_cam, frozenset(times))
        target = writer.layout.traversal(traversal.name)
        for t in times:
            link(traversal.layout.image(CAMERA, t), target.image(CAMERA, t))
            link(traversal.layout.depth(CAMERA, t), target.depth(CAMERA, t))
    sets = asked_sets(town, names)
    for k, ((a, b), name) in enumerate(sets.items()):
        rng = np.random.default_rng([seed, k])
        spread = DistanceSpread(_MEAN_M, _FARTHEST_M)
        pairs = drawn_pairs(frames[a], frames[b], spread, rng, same_traversal=a == b)
        write_pairs(writer.layout.pair_file(name), writer.layout.pair_table(name), sorted(pairs, key=lambda p: p.key))
    return writer.finish({"test": list(sets.values())})


def link(source: Path, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        path.symlink_to(source.resolve())


def track(dataset: Dataset, names: list[str], methods: tuple[str, ...], out: Path) -> dict[str, dict[str, Any]]:
    """pairs of conditions -> recall of each method in percent, number and mean distance of pairs."""
    first = names[0]
    asked = [(name, name) for name in names] + [(first, name) for name in names[1:]]
    sets = {f"{a} -> {b}": pair_set_name(traversal_of(dataset, a), traversal_of(dataset, b), CAMERA) for a, b in asked}
    # Workers start anew for each pair set, which takes longer than sixty pairs.
    options = EvaluateOptions(dataset=dataset.root, methods=methods, pair_sets=tuple(sets.values()), out=out, workers=1)
    print(f"tracking {len(sets)} pair sets with {', '.join(methods)}", file=sys.stderr)
    report = evaluate_methods(options, Silent())
    scores = {folder.label: folder.score_record().pair_sets for folder in report.folders}
    table: dict[str, dict[str, Any]] = {}
    for label, name in sets.items():
        pairs = dataset.pair_set(name).pairs
        recall = {m: round(100 * float(scores[m][name]["all"][_RECALL] or 0.0), 1) for m in methods}
        distance = float(np.mean([p.distance_m for p in pairs if p.distance_m is not None]))
        table[label] = {"pairs": len(pairs), "distance_m": round(distance, 2), **recall}
    return table


def print_patches(patches: dict[str, dict[str, dict[str, float]]]) -> None:
    """Median ZNCC as Markdown."""
    names = list(patches)
    print("median ZNCC, reference (row) against query (column)\n")
    print("| | " + " | ".join(names) + " |\n|" + "---|" * (len(names) + 1))
    for a in names:
        print(f"| {a} | " + " | ".join(f"{patches[a][b]['median']:.2f}" for b in names) + " |", flush=True)


def print_tracked(tracked: dict[str, dict[str, Any]]) -> None:
    """Recall as Markdown."""
    columns = list(next(iter(tracked.values())))
    print(f"\n{_RECALL} in percent\n")
    print("| reference -> query | " + " | ".join(columns) + " |\n|" + "---|" * (len(columns) + 1))
    for label, row in tracked.items():
        print(f"| {label} | " + " | ".join(str(row[c]) for c in columns) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--conditions", default=",".join(dict.fromkeys(("Sunny", *CONDITIONS))))
    parser.add_argument("--methods", default="orb-pnp,dso")
    parser.add_argument("--steps", type=int, default=61, help="of each drive, and pairs of each set")
    parser.add_argument("--frames", type=int, default=8, help="of each pair of conditions, whose patches are compared")
    parser.add_argument("--size", default="320x240")
    parser.add_argument("--split", default="test", help="whose district is driven in; tune on another")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="folder for the dataset and predictions, kept")
    given = parser.parse_args()
    names = given.conditions.split(",")
    town = importer("synthetic")
    options = town.Options.model_validate(
        {
            "conditions": tuple(names),
            "steps": given.steps,
            "size": given.size,
            "split": given.split,
            "seed": given.seed,
            # Frames half a metre apart; drives side by side.
            "speed": 5.0,
            "lateral": 0.3,
            "distance": _MEAN_M,
            "max_distance": _FARTHEST_M,
            "correspondences": 0,
        }
    )
    with tempfile.TemporaryDirectory(prefix="relocbench-change-") as scratch:
        folder = given.keep or Path(scratch)
        print(f"rendering {given.steps} frames in each of {len(names)} conditions", file=sys.stderr)
        dataset = town.build([], options, folder / "dataset", Silent(), Run(default_workers()))
        patches = correlate(dataset, names, given.frames)
        print_patches(patches)
        linked = with_pairs_within(dataset, names, given.seed, folder / "within")
        tracked = track(linked, names, tuple(given.methods.split(",")), folder / "results")
    print_tracked(tracked)
    print(json.dumps({"benchmark": "realistic_change", "zncc": patches, "recall_percent": tracked}))


if __name__ == "__main__":
    main()
