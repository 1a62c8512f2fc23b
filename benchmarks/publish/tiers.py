"""What methods find by tier of difficulty, beside the bound that true matches set.

``python benchmarks/publish/tiers.py E/hard E/medium --results R`` reads districts of an edition (or any datasets) and
the results on them. A row is a method: the share of the pairs of a tier that it finds within 0.25 m and 2 degrees,
across conditions, the mean over districts with its 95 % interval over them (Student's t, from three districts on).
Pairs on the street whose houses repeat themselves stand apart. ``true matches`` is what perfect matching leaves: PnP
on the dataset's own visible correspondences, whose pixels in the query are off by 1 px (one sigma, in each direction)
and whose depths by the error that the map states. With ``--evaluate`` the methods are asked first; their settings are
those of ``cross_weather.py``, and rows of ALIKED need its authors' weights. ``--picture FILE`` shows a pair of each
tier, that of median overlap: keyframes above, queries below. The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from cross_weather import SETTINGS, run
from scipy.stats import t as student

from relocbench.arrays import Array, Image
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.edition_folder import datasets_of
from relocbench.datasets.core.images import jpeg_bytes
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.datasets.pairs.visibility import lift
from relocbench.datasets.synthetic.jobs.contact_sheet import labelled, tiled
from relocbench.datasets.synthetic.jobs.selection import REPEATING
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.files import write_bytes
from relocbench.geometry import make_transform, so3_exp
from relocbench.leaderboard.tracking.load import load_results
from relocbench.metrics import CORRECT, pose_errors, within
from relocbench.metrics.pose.tiers import TIERS, tiers_of

BOUND = "true matches"
METHODS = (
    "identity",
    "clock",
    "orb-pnp",
    "sift-pnp",
    "dso",
    "gn-net-one-start=gn-net-from-prior",
    "gn-net-from-prior",
    "gn-net",
    "aliked-pnp",
    "gn-net-from-aliked-pnp=gn-net-from-prior",
)
_PIXEL_SIGMA = 1.0
_RANSAC_PX = 4.0
_SHOWN_PX = 320
"""width and height of the images of ``--picture``"""

Found = dict[tuple[str, str], dict[str, list[bool]]]
"""(method, column) -> district -> whether each pair is found"""


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


def bound(dataset: Dataset, name: str, found: Found) -> None:
    """Add what true matches find of a dataset's pairs across conditions."""
    for set_name in dataset.pair_set_names:
        pair_set = dataset.pair_set(set_name)
        if pair_set.reference == pair_set.query:
            continue
        for pair, column in columns_of(pair_set.pairs):
            T = true_matches(dataset, pair_set, pair, np.random.default_rng(pair.key))
            assert pair.T_query_ref is not None
            right = False
            if T is not None:
                right = bool(within(pose_errors(T[None], pair.T_query_ref[None]), *CORRECT)[0])
            found[BOUND, column].setdefault(name, []).append(right)


def methods(folders: list[Path], results: Path, found: Found) -> None:
    """Add what the methods of a results folder found of the datasets' pairs across conditions."""
    for entry in load_results(results, datasets=DatasetLookup(results, folders)):
        for set_name, record in entry.pair_sets.items():
            if record.reference == record.query:
                continue
            for method in entry.methods:
                rows = method.errors[set_name]
                for row, tier, right in zip(rows, rows.scores.tiers, within(rows.errors, *CORRECT), strict=True):
                    if tier >= 0:
                        column = REPEATING if row.group == REPEATING else TIERS[tier]
                        found[method.label, column].setdefault(entry.record.name, []).append(bool(right))


def evaluate(folder: Path, results: Path, workers: int) -> None:
    """Ask the methods about the datasets of a folder; what is answered already is kept."""
    labels = [name.split("=")[0] for name in METHODS]
    words = [word for name in METHODS for word in ("-m", name)]
    words += [word for each in SETTINGS if each.split(".")[0] in labels for word in ("--set", each)]
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


def share(by_district: dict[str, list[bool]]) -> list[float]:
    """The mean over districts in percent; from three districts on also the ends of its interval."""
    means = 100 * np.array([np.mean(rights) for rights in by_district.values()])
    values = [float(means.mean())]
    if len(means) > 2:
        half = student.ppf(0.975, len(means) - 1) * means.std(ddof=1) / np.sqrt(len(means))
        values += np.clip([values[0] - half, values[0] + half], 0, 100).tolist()
    return [round(value, 1) for value in values]


def text(values: list[float]) -> str:
    """A cell of the table."""
    return " ".join([*map(str, values[:1]), *([str(values[1:])] if values[1:] else [])])


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
    found: Found = defaultdict(dict)
    for folder in folders:
        dataset = Dataset(folder)
        bound(dataset, dataset.name, found)
    if options.results is not None:
        methods(folders, options.results, found)
    columns = [name for name in (*TIERS, REPEATING) if (BOUND, name) in found]
    pairs = {name: sum(map(len, found[BOUND, name].values())) for name in columns}
    heads = " | ".join(f"{name.replace('_', ' ')}, {pairs[name]} pairs" for name in columns)
    print(f"| method | {heads} |\n|---|{'---|' * len(columns)}", file=sys.stderr)
    table: dict[str, dict[str, list[float]]] = {}
    for method in dict.fromkeys(method for method, _ in found):
        table[method] = {name: share(found[method, name]) for name in columns if found.get((method, name))}
        cells = [text(table[method].get(name, [])) for name in columns]
        print(f"| {method} | {' | '.join(cells)} |", file=sys.stderr)
    print(json.dumps({"benchmark": "tiers", "districts": len(folders), "pairs": pairs, "found": table}))


if __name__ == "__main__":
    main()
