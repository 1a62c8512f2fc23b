"""How much conditions change the images: the correlation of corresponding patches, and the recall of trackers.

The test district is driven twice in each condition, along one route. A pair across conditions has a frame of the first
drive in one condition and a frame of the second drive in the other. The control is a pair of two drives in one
condition, so that it differs as much in pose, noise, rain and snow, and has the same parked cars. Pairs are selected by
their distance, evenly along the road.

The first table is the zero-mean normalised cross-correlation (ZNCC) of corresponding patches for each pair of
conditions, with frames 0.5 +- 0.15 m apart. A patch is 11 x 11 pixels of the reference, each of which is projected into
the query by its own depth and the true pose, so that neither motion nor perspective lowers the correlation. Patches are
on a grid of 8 pixels; all of their pixels must be visible in the query, and the grey levels of the reference's patch
must have a standard deviation of at least 8. The second table is recall@(0.25m,2deg) of trackers at 0.8 +- 0.2 m and
rotations below 2 degrees, as on a straight road (in bends the image moves beyond the basin of direct alignment in any
weather): within one drive, between two drives in one condition, and from the first condition to each other. The third
table is the same recall within a condition by rotation, over all pairs of the two drives, by which the limit of 2
degrees can be assessed.

``--vary`` adds conditions that differ from a named one in some factors, to find out which of them matter. They are
driven along the same poses as the named one.

    python benchmarks/truth/realistic_change.py [--steps N] [--pairs N] [--split validation] [--seed N]
        [--conditions A,B]
    python benchmarks/truth/realistic_change.py --split train --conditions Night --vary Dark=Night:headlights=false

The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from pydantic import ValidationError

from relocbench.arrays import Array, Floats, Image
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import RuleOptions
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.layout import pair_set_name
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.pairs.posed_frames import PosedFrames, posed_frames, relative_pose
from relocbench.datasets.pairs.visibility import warp
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS, Factors, condition_named
from relocbench.datasets.synthetic.conditions.presets import conditions_of
from relocbench.datasets.synthetic.drives.drive import DriveStyle
from relocbench.datasets.synthetic.drives.rig import rig_named
from relocbench.datasets.synthetic.jobs.plan import AskedDrives, TraversalPlan, make_plans
from relocbench.datasets.synthetic.jobs.rendering import render_all
from relocbench.errors import ConfigError
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.execution import Run, default_workers
from relocbench.geometry import Camera, invert, rotation_angle
from relocbench.progress import Silent

Sets = dict[tuple[str, str], str]
"""pair set by (reference, query) drive"""

CAMERA = "front"
_EXTENT_M = 250.0
_PATCH = 11
_STRIDE = 8
_LEAST_CONTRAST = 8.0
"""smallest standard deviation of a patch in grey levels, well above the noise of all conditions"""
_RECALL = "recall@(0.25m,2deg)"


@dataclass(frozen=True)
class Apart:
    """A range of the rotation between the frames of a pair."""

    metres: float
    give: float
    most_deg: float
    """upper limit of the angle"""
    least_deg: float = 0.0

    @property
    def turned(self) -> str:
        """The range in words, which names the group of pairs."""
        return f"{self.least_deg:g} to {self.most_deg:g} deg"


PATCHES = Apart(0.5, 0.15, 20.0)
TRACKED = Apart(0.8, 0.2, 2.0)
TURNED = (TRACKED, Apart(0.8, 0.2, 5.0, 2.0), Apart(0.8, 0.2, 45.0, 5.0))


@dataclass(frozen=True)
class Variant:
    """A condition that differs from a named one in some factors."""

    name: str
    base: str
    factors: Factors


@dataclass(frozen=True)
class Tracked:
    """The recall of trackers on the pairs of one pair set in one range of rotation."""

    reference: str
    query: str
    """conditions"""
    one_drive: bool
    band: Apart
    pairs: int
    distance_m: float
    angle_deg: float
    recall: dict[str, float]
    """percent by method"""


class Frames:
    """The grey images, depth and poses of one traversal."""

    def __init__(self, traversal: Traversal) -> None:
        self.camera: Camera = traversal.camera(CAMERA)
        self.posed = posed_frames(traversal, CAMERA)
        self.T_world_cam = self.posed.T_world_cam
        self._traversal = traversal

    @lru_cache(maxsize=64)  # noqa: B019  # a few drives, all of them kept to the end
    def read(self, row: int) -> tuple[Image, Floats]:
        """The grey levels and the depth (H, W) of a frame."""
        timestamp = self.posed.timestamps[row]
        depth = self._traversal.depth(CAMERA, timestamp)
        assert depth is not None
        return np.asarray(cv2.cvtColor(self._traversal.image(CAMERA, timestamp), cv2.COLOR_RGB2GRAY)), depth


def matches(
    reference: PosedFrames, query: PosedFrames, apart: Apart, count: int, *, same_drive: bool
) -> list[tuple[int, int]]:
    """Up to ``count`` pairs (reference row, query row) at a distance, evenly along the drive.

    Each query is paired with the frame whose distance is closest to the wanted one, or with none if it is out of range.
    """
    found = []
    for q, T_world_query in enumerate(query.T_world_cam):
        distance = np.linalg.norm(reference.T_world_cam[:, :3, 3] - T_world_query[:3, 3], axis=1)
        off = np.abs(distance - apart.metres)
        if same_drive:
            off[q] = np.inf
        best = int(np.argmin(off))
        turned = np.degrees(rotation_angle(reference.T_world_cam[best, :3, :3].T @ T_world_query[:3, :3]))
        if off[best] <= apart.give and apart.least_deg <= turned < apart.most_deg:
            found.append((best, q))
    rows = np.unique(np.linspace(0, len(found) - 1, min(count, len(found))).round().astype(int))
    return [found[i] for i in rows]


def patch_correlations(reference: Frames, r: int, query: Frames, q: int) -> Array:
    """The ZNCC (N,) of all patches of a reference frame that are entirely visible in the query."""
    camera = reference.camera
    half = _PATCH // 2
    v, u = np.meshgrid(
        np.arange(half, camera.height - half, _STRIDE), np.arange(half, camera.width - half, _STRIDE), indexing="ij"
    )
    dv, du = np.mgrid[-half : half + 1, -half : half + 1].reshape(2, -1)
    v, u = v.reshape(-1, 1) + dv, u.reshape(-1, 1) + du
    (grey_ref, depth_ref), (grey_query, depth_query) = reference.read(r), query.read(q)
    here = grey_ref[v, u].astype(np.float64)
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
        grey_query.astype(np.float32), x.reshape(here.shape), y.reshape(here.shape), cv2.INTER_LINEAR
    ).astype(np.float64)
    a, b = (k[whole] - k[whole].mean(axis=1, keepdims=True) for k in (here, there))
    scale = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    # A patch that is uniform in the query has no correlation.
    return np.asarray(np.where(scale > 0, np.sum(a * b, axis=1) / np.maximum(scale, 1e-12), 0.0))


def drive_name(split: str, condition: str, number: int) -> str:
    """The name of a traversal, as the town gives it."""
    return f"{split}-{condition}-{number}"


def correlate(dataset: Dataset, split: str, names: list[str], count: int) -> dict[str, dict[str, dict[str, float]]]:
    """Median and mean ZNCC and the numbers of patches and frame pairs, by reference and query condition."""
    first, second = (
        {name: Frames(dataset.traversal(drive_name(split, name, number))) for name in names} for number in (0, 1)
    )
    table: dict[str, dict[str, dict[str, float]]] = {}
    for a, reference in first.items():
        for b, query in second.items():
            rows = matches(reference.posed, query.posed, PATCHES, count, same_drive=False)
            values = np.concatenate([patch_correlations(reference, r, query, q) for r, q in rows])
            table.setdefault(a, {})[b] = {
                "median": round(float(np.median(values)), 3),
                "mean": round(float(np.mean(values)), 3),
                "patches": len(values),
                "frame_pairs": len(rows),
            }
    return table


def variant(text: str) -> Variant:
    """The variant described by ``NAME=CONDITION:factor=value,...``.

    Raises:
        ConfigError: the description is not understood.
    """
    name, _, rest = text.partition("=")
    base, _, given = rest.partition(":")
    changed = {key: yaml.safe_load(value) for key, _, value in (item.partition("=") for item in given.split(","))}
    try:
        factors = Factors.model_validate({**condition_named(base).factors.model_dump(), **changed})
    except ValidationError as error:
        raise ConfigError(f"--vary {text}: {error.errors()[0]['loc']}: {error.errors()[0]['msg']}") from None
    return Variant(name, base, factors)


def planned(given: argparse.Namespace, names: list[str], variants: list[Variant]) -> list[TraversalPlan]:
    """Two drives in each condition; variants have the poses of the condition that they vary."""
    width, height = map(int, given.size.split("x"))
    every = [*names, *(v.name for v in variants)]
    conditions = conditions_of(every, {v.name: v.factors for v in variants}, None, 2)
    style = DriveStyle(given.speed, given.lateral, given.heading)
    plans = make_plans(
        AskedDrives((given.split,), conditions, 2, given.seed), given.steps, style,
        extent_m=_EXTENT_M, reporter=Silent(), rig=rig_named(CAMERA), size=(width, height),
    )  # fmt: skip
    found = {plan.name: plan for plan in plans}
    for v in variants:
        if v.base not in names:
            raise ConfigError(f"--vary {v.name}: '{v.base}' is not among --conditions {','.join(names)}")
        for number in (0, 1):
            name, like = (drive_name(given.split, k, number) for k in (v.name, v.base))
            found[name] = replace(found[name], drive=found[like].drive)
    return list(found.values())


def town(given: argparse.Namespace, names: list[str], plans: list[TraversalPlan], out: Path) -> tuple[Dataset, Sets]:
    """Render the drives, and make the pair sets for trackers; ``names`` are the conditions."""
    settings = {k: v if isinstance(v, int | float) else str(v) for k, v in vars(given).items()}
    writer = DatasetWriter(out, "realistic-change", {"kind": "realistic-change", **settings})
    for plan in plans:
        writer.traversal(plan.file(), dict(zip(plan.times, plan.drive.T_world_rig, strict=True)))
    render_all(Build(writer, RuleOptions(seed=given.seed), Silent(), Run(default_workers())), plans, ())
    frames = {plan.name: plan.frames(CAMERA) for plan in plans}
    first, second = ([drive_name(given.split, name, number) for name in names] for number in (0, 1))
    asked = [*zip(first, first, strict=True), *zip(first, second, strict=True)]
    asked += [(first[0], name) for name in second[1:]]
    for a, b in asked:
        bands = TURNED if a.split("-")[1] == b.split("-")[1] else TURNED[:1]
        pairs = [
            _pair(frames[a], frames[b], r, q, band.turned)
            for band in bands
            for r, q in matches(frames[a], frames[b], band, given.pairs, same_drive=a == b)
        ]
        writer.pairs(a, b, CAMERA, pairs)
    sets = {(a, b): pair_set_name(a, b, CAMERA) for a, b in asked}
    return writer.finish({"test": list(sets.values())}), sets


def _pair(reference: PosedFrames, query: PosedFrames, r: int, q: int, group: str) -> Pair:
    T_query_ref = relative_pose(query.T_world_cam[q], reference.T_world_cam[r])
    return Pair(reference.timestamps[r], query.timestamps[q], T_query_ref, group=group, source="rendered poses")


def recall_of(method: str, dataset: Path, sets: tuple[str, ...], out: Path) -> dict[tuple[str, str], float]:
    """Recall in percent by (pair set, group), in this process, since starting workers takes longer for small sets."""
    options = EvaluateOptions(dataset=dataset, methods=(method,), pair_sets=sets, out=out, workers=1)
    scores = evaluate_methods(options, Silent()).folders[0].score_record().pair_sets
    return {(name, g): 100 * float(row[_RECALL] or 0.0) for name in sets for g, row in scores[name].items()}


def track(dataset: Dataset, sets: Sets, methods: list[str], out: Path) -> list[Tracked]:
    """The recall of each method for each pair set and range of rotation."""
    workers = default_workers()
    parts = [part for k in range(workers) if (part := tuple(sets.values())[k::workers])]
    recall: dict[str, dict[tuple[str, str], float]] = {m: {} for m in methods}
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        asked = [(m, k) for m in methods for k in range(len(parts))]
        jobs = [pool.submit(recall_of, m, dataset.root, parts[k], out / f"{m}-{k}") for m, k in asked]
        for (m, _), job in zip(asked, jobs, strict=True):
            recall[m] |= job.result()
    found = []
    for (a, b), name in sets.items():
        everything = dataset.pair_set(name).pairs
        for band in TURNED:
            pairs = [p for p in everything if p.group == band.turned]
            if pairs:
                distance = float(np.mean([p.distance_m for p in pairs if p.distance_m is not None]))
                angle = float(np.mean([p.angle_deg for p in pairs if p.angle_deg is not None]))
                # A pair set of one group is scored as a whole only.
                group = band.turned if len(pairs) < len(everything) else "all"
                of = {m: recall[m][name, group] for m in methods}
                found.append(Tracked(a.split("-")[1], b.split("-")[1], a == b, band, len(pairs), distance, angle, of))
    return found


def by_condition(tracked: list[Tracked]) -> dict[str, dict[str, Any]]:
    """Columns of pairs with small rotations, by label."""
    rows = [t for t in tracked if t.band == TRACKED]
    return {f"{t.reference} -> {t.query}" + (", one drive" if t.one_drive else ""): _columns([t]) for t in rows}


def by_angle(tracked: list[Tracked]) -> dict[str, dict[str, Any]]:
    """Columns of pairs within a condition, over all conditions, by label."""
    table = {}
    for one_drive in (True, False):
        for band in TURNED:
            rows = [t for t in tracked if (t.one_drive, t.band) == (one_drive, band) and t.reference == t.query]
            if rows:
                table[("one drive" if one_drive else "driven again") + f", {band.turned}"] = _columns(rows)
    return table


def _columns(rows: list[Tracked]) -> dict[str, Any]:
    """The means over all pairs of the rows."""
    pairs = np.array([t.pairs for t in rows])
    row: dict[str, Any] = {
        "pairs": int(pairs.sum()),
        "distance_m": round(float(np.average([t.distance_m for t in rows], weights=pairs)), 2),
        "angle_deg": round(float(np.average([t.angle_deg for t in rows], weights=pairs)), 1),
    }
    return row | {m: round(float(np.average([t.recall[m] for t in rows], weights=pairs)), 1) for m in rows[0].recall}


def print_patches(patches: dict[str, dict[str, dict[str, float]]]) -> None:
    """The median ZNCC as a Markdown table."""
    names = list(patches)
    print("median ZNCC, reference (row, first drive) against query (column, second drive)\n")
    print("| | " + " | ".join(names) + " |\n|" + "---|" * (len(names) + 1))
    for a in names:
        print(f"| {a} | " + " | ".join(f"{patches[a][b]['median']:.2f}" for b in names) + " |", flush=True)


def print_tracked(table: dict[str, dict[str, Any]], title: str) -> None:
    """The recall as a Markdown table."""
    columns = list(next(iter(table.values())))
    print(f"\n{_RECALL} in percent, {title}\n")
    print("| | " + " | ".join(columns) + " |\n|" + "---|" * (len(columns) + 1))
    for label, row in table.items():
        print(f"| {label} | " + " | ".join(str(row[c]) for c in columns) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--conditions", default=",".join(dict.fromkeys(("Sunny", *CONDITIONS))))
    parser.add_argument("--methods", default="orb-pnp,dso")
    parser.add_argument("--steps", type=int, default=81, help="frames of each drive, ten per second")
    parser.add_argument("--pairs", type=int, default=40, help="largest number of pairs in each pair set")
    parser.add_argument(
        "--frames", type=int, default=8, help="frame pairs of each pair of conditions whose patches are compared"
    )
    parser.add_argument("--size", default="320x240")
    parser.add_argument("--speed", type=float, default=8.0, help="mean speed in m/s")
    parser.add_argument(
        "--lateral", type=float, default=0.3, help="largest distance from the middle of the lane in metres"
    )
    parser.add_argument(
        "--heading", type=float, default=2.0, help="largest angle to the direction of travel in degrees"
    )
    parser.add_argument("--split", default="test", help="split whose district is driven through")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--vary", action="append", default=[], help="NAME=CONDITION:factor=value,...; may be repeated")
    parser.add_argument("--keep", type=Path, help="folder that keeps the dataset and predictions")
    given = parser.parse_args()
    named, variants = given.conditions.split(","), [variant(text) for text in given.vary]
    names = [*named, *(v.name for v in variants)]
    plans = planned(given, named, variants)
    start = time.perf_counter()

    def say(what: str) -> None:
        print(f"{time.perf_counter() - start:4.0f} s  {what}", file=sys.stderr)

    with tempfile.TemporaryDirectory(prefix="relocbench-change-") as scratch:
        folder = given.keep or Path(scratch)
        say(f"rendering two drives of {given.steps} frames in each of {len(names)} conditions")
        dataset, sets = town(given, names, plans, folder / "dataset")
        say("comparing patches")
        patches = correlate(dataset, given.split, names, given.frames)
        print_patches(patches)
        say(f"tracking {len(sets)} pair sets with {given.methods}")
        tracked = track(dataset, sets, given.methods.split(","), folder / "results")
        say("done")
    conditions, angles = by_condition(tracked), by_angle(tracked)
    print_tracked(conditions, f"turned by less than {TRACKED.most_deg:g} degrees")
    print_tracked(angles, "within a condition, by how far the frames are turned")
    result = {"zncc": patches, "recall_percent": conditions, "recall_percent_by_angle": angles}
    print(json.dumps({"benchmark": "realistic_change", **result}))


if __name__ == "__main__":
    main()
