"""What methods find by tier of difficulty, beside the bound that true matches set.

``python benchmarks/publish/tiers.py E/hard E/medium --results R`` reads districts of an edition (or any datasets) and
the results on them. A row is a method: the share of the pairs of a tier that it finds within 0.25 m and 2 degrees,
across conditions, with its 95 % interval. Districts count alike, and so do the pair sets of a district, as on boards.
Pairs on the street whose houses repeat themselves stand apart. ``true-matches`` is what perfect matching leaves: PnP
on the dataset's own visible correspondences, whose pixels in the query are off by 1 px (one sigma, in each direction)
and whose depths by the error that the map states. With ``--evaluate`` it and the methods are asked first; the rows of
ALIKED need its authors' weights. ``--picture FILE`` shows a pair of each tier, that of median overlap: keyframes above,
queries below. The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from groups import FLOORS, METRICS, Group, run

from baselines.gn_net.tracker import ONE_START
from relocbench.arrays import Array, Image
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.edition_folder import datasets_of
from relocbench.datasets.core.images import jpeg_bytes
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair, PoseLine, write_pose_lines
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.datasets.pairs.visibility import lift
from relocbench.datasets.synthetic.jobs.contact_sheet import labelled, tiled
from relocbench.datasets.synthetic.jobs.selection import REPEATING
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.files import write_bytes
from relocbench.geometry import make_transform, so3_exp
from relocbench.leaderboard.common.text import with_bounds
from relocbench.leaderboard.tracking.load import load_results
from relocbench.metrics import metric_named
from relocbench.metrics.pose.tiers import TIERS, tiers_of
from relocbench.progress import Silent

BOUND = "true-matches"
METHODS = (
    "identity",
    "clock",
    "orb-pnp",
    "sift-pnp",
    "dso",
    "gn-net-one-start=gn-net-from-prior",
    "gn-net-from-prior",
    "gn-net-contrastive",
    "gn-net",
    "aliked-pnp",
    "gn-net-from-aliked-pnp=gn-net-from-prior",
)
SETTINGS = (
    *(f"gn-net-one-start.{name}={json.dumps(value)}" for name, value in ONE_START.items()),
    "gn-net-one-start.cache_size=200",
    "gn-net-from-prior.cache_size=200",
    "gn-net-contrastive.cache_size=200",
    "gn-net.cache_size=200",
    "aliked-pnp.cache_size=200",
    "gn-net-from-aliked-pnp.cache_size=200",
    "gn-net-from-aliked-pnp.start=aliked-pnp",
    "gn-net-from-aliked-pnp.start.cache_size=200",
    "gn-net-from-aliked-pnp.prior_level=2",
    "gn-net-from-aliked-pnp.min_agreement=0",
)
"""``cache_size`` saves the network's passes over images that other pairs showed. No seconds are printed."""
_PIXEL_SIGMA = 1.0
_RANSAC_PX = 4.0
_SHOWN_PX = 320
"""width and height of the images of ``--picture``"""

_STRETCH_M = 5.0
"""metres of a district's street that are one place: queries of all its drives on them are one value of its series"""


def true_matches(dataset: Dataset, pair_set: PairSet, pair: Pair, rng: np.random.Generator) -> Array | None:
    """``T_query_ref`` (4, 4) by PnP on the pair's visible correspondences with errors; None where PnP fails."""
    points = read_correspondences(dataset.layout.correspondence_file(pair_set.name), pair.key)
    seen = np.flatnonzero(points.visible)
    if len(seen) < 6:
        return None
    keyframe = dataset.traversal(pair_set.reference).camera(pair_set.reference_camera, pair.ref_timestamp_ns)
    query = pair_set.query_traversal.camera(pair_set.query_camera, pair.query_timestamp_ns)
    depth = points.depth_ref[seen] * (1 + (pair.depth_error or 0.0) * rng.normal(size=len(seen)))
    world, _ = lift(keyframe, points.uv_ref[seen], depth)
    pixels = points.uv_query[seen] + _PIXEL_SIGMA * rng.normal(size=(len(seen), 2))
    rays, _ = query.unproject(pixels)
    flat = np.ascontiguousarray(rays[:, :2])
    limit = _RANSAC_PX / query.fx
    done, turn, shift, inliers = cv2.solvePnPRansac(
        world, flat, np.eye(3), None, reprojectionError=limit, iterationsCount=1000, confidence=0.9999
    )
    if not done or inliers is None or len(inliers) < 6:
        return None
    rows = inliers.ravel()
    turn, shift = cv2.solvePnPRefineLM(world[rows], flat[rows], np.eye(3), None, turn, shift)
    return make_transform(so3_exp(np.ravel(turn)), np.ravel(shift))


def columns_of(pairs: list[Pair]) -> Iterator[tuple[Pair, str]]:
    """Each pair with the column that it counts in: its tier, or the repeating street."""

    for pair, tier in zip(pairs, tiers_of(pairs), strict=True):
        if tier >= 0:
            yield pair, REPEATING if pair.group == REPEATING else TIERS[tier]


def bound(folder: Path, results: Path) -> None:
    """Answer the pairs across conditions of a dataset by true matches, and score the answers as any predictions."""
    dataset = Dataset(folder)
    with tempfile.TemporaryDirectory() as temporary:
        source = Path(temporary) / BOUND
        for pair_set in (each for each in dataset.pair_sets() if each.reference != each.query):
            rows = [(p, true_matches(dataset, pair_set, p, np.random.default_rng(p.key))) for p in pair_set.pairs]
            lines = [PoseLine(*pair.key, T) for pair, T in rows if T is not None]
            write_pose_lines(source / f"{pair_set.name}.txt", lines)
        if not source.exists():  # no pair is across conditions
            return
        options = EvaluateOptions(dataset=folder, out=results, methods=(BOUND,), predictions=source)
        evaluate_methods(options, Silent())


def answers(results: Path, folders: Sequence[Path] = ()) -> pd.DataFrame:
    """What a results folder holds of pairs across conditions that have a tier: a row for each method and pair.

    Args:
        folders: datasets by whose truth every error is computed anew, and to which the rows are limited; without any,
            the errors of the results are believed.
    """
    parts = []
    for entry in load_results(results, datasets=DatasetLookup(results, folders)):
        if folders and entry.truth is None:
            continue
        for name, record in entry.pair_sets.items():
            for method in entry.methods if record.reference != record.query else ():
                if (rows := method.errors.get(name)) is None:
                    continue
                values = {metric: metric_named(metric).per_pair for metric in METRICS}
                part = pd.DataFrame(
                    {
                        "method": method.label,
                        "district": entry.record.name,
                        "pair_set": name,
                        "step": np.nan_to_num(rows.column("travelled_m") // _STRETCH_M),
                        "column": [TIERS[tier] if tier >= 0 else "" for tier in rows.scores.tiers],
                        "confidence": rows.column("confidence"),
                        "answered": np.isfinite(rows.errors.translation_error_m),
                        "distance_m": rows.column("distance_m"),
                        **{metric: of(rows.errors) for metric, of in values.items() if of is not None},
                    }
                )
                part.loc[(np.array(rows.groups) == REPEATING) & (part["column"] != ""), "column"] = REPEATING
                parts.append(part[part["column"] != ""])
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=["method", "district", "column"])


def groups(rows: pd.DataFrame) -> list[Group]:
    """The pairs of each tier, and those on the repeating street."""
    return [
        Group(column.replace("_", " "), rows[rows["column"] == column])
        for column in (*TIERS, REPEATING)
        if column in set(rows["column"])
    ]


def evaluate(folder: Path, results: Path, workers: int) -> None:
    """Ask true matches and the methods about the datasets of a folder; what is answered already is kept."""
    for dataset in datasets_of(folder):
        bound(dataset, results)
    words = [word for name in METHODS for word in ("-m", name)]
    words += [word for each in SETTINGS for word in ("--set", each)]
    run("evaluate", "-d", folder, *words, "--out", results, "-j", workers)


def picture(folders: list[Path]) -> Image:
    """A pair of each tier (H, W, 3), RGB."""
    of_tier: dict[str, list[tuple[Dataset, PairSet, Pair]]] = defaultdict(list)
    for dataset in map(Dataset, folders):
        for pair_set in dataset.pair_sets():
            for pair, column in columns_of(pair_set.pairs):
                of_tier[column].append((dataset, pair_set, pair))
    above, below = [], []
    for tier in (name for name in TIERS if name in of_tier):
        pairs = sorted(of_tier[tier], key=lambda each: (each[2].overlap, each[2].key))
        dataset, pair_set, pair = pairs[len(pairs) // 2]
        map_drive = dataset.traversal(pair_set.reference)
        keyframe = map_drive.image(pair_set.reference_camera, pair.ref_timestamp_ns)
        query = pair_set.query_traversal.image(pair_set.query_camera, pair.query_timestamp_ns)
        shown = [cv2.resize(image, (_SHOWN_PX, _SHOWN_PX), interpolation=cv2.INTER_AREA) for image in (keyframe, query)]
        above.append(labelled(shown[0], tier))
        below.append(labelled(shown[1], f"{pair.distance_m:.1f} m, {pair.angle_deg:.0f} deg, {pair.overlap:.0%}"))
    return tiled([*above, *below])


def in_order(columns: Sequence[Group]) -> list[str]:
    """All methods: true matches, then those of the largest shares over all groups, trivial baselines last."""
    shares = {method: 0.0 for group in columns for method in sorted(set(group.rows["method"]))}
    for group in columns:
        for method in group.methods:
            shares[method] += group.mean(method, METRICS[0])
    return sorted(shares, key=lambda method: (method != BOUND, method in FLOORS, -shares[method], method))


def table(columns: Sequence[Group], metric: str = METRICS[0]) -> list[str]:
    """What each method reaches, with its intervals; empty where a method was not asked of all pairs."""
    lines = [f"| method | {' | '.join(group.name for group in columns)} |", f"|---|{'---:|' * len(columns)}"]
    for what in ("pairs", "districts"):
        lines.append(f"| *{what}* | {' | '.join(f'*{getattr(group, what)}*' for group in columns)} |")
    for method in in_order(columns):
        cells = [
            with_bounds(group.mean(method, metric), group.interval(method, metric), "share")
            if method in group.methods
            else ""
            for group in columns
        ]
        lines.append(f"| {method} | {' | '.join(cells)} |")
    return lines


def _found(group: Group, method: str) -> list[float]:
    """The share in percent, and the ends of its interval if it has one."""
    interval = group.interval(method, METRICS[0])
    ends = [] if interval is None else [interval.low, interval.high]
    return [round(100 * value, 1) for value in (group.mean(method, METRICS[0]), *ends)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="tiers of an edition, or datasets")
    parser.add_argument("--results", type=Path, help="folder of `relocbench evaluate`")
    parser.add_argument("--evaluate", action="store_true", help="ask the methods first; needs --results")
    parser.add_argument("--picture", type=Path, help="write a picture of a pair of each tier")
    parser.add_argument("--workers", "-j", type=int, default=2)
    options = parser.parse_args()
    if options.evaluate and options.results is None:
        parser.error("--evaluate needs --results FOLDER")
    for folder in options.folders if options.evaluate else ():
        evaluate(folder, options.results, options.workers)
    folders = [dataset for folder in options.folders for dataset in datasets_of(folder)]
    if options.picture:
        write_bytes(options.picture, jpeg_bytes(picture(folders)))
    parts = [] if options.results is None else [answers(options.results, folders)]
    if not any(BOUND in set(part["method"]) for part in parts):
        with tempfile.TemporaryDirectory() as temporary:
            for folder in folders:
                bound(folder, Path(temporary) / "results")
            parts.append(answers(Path(temporary) / "results", folders))
    columns = groups(pd.concat(parts, ignore_index=True))
    print("\n".join(table(columns)), file=sys.stderr)
    found = {
        method: {group.name: _found(group, method) for group in columns if method in group.methods}
        for method in in_order(columns)
    }
    pairs = {group.name: group.pairs for group in columns}
    print(json.dumps({"benchmark": "tiers", "districts": len(folders), "pairs": pairs, "found": found}))


if __name__ == "__main__":
    main()
