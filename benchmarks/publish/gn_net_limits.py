"""What limits ``gn-net``, its search or its features, and what ``gn-net-from-prior`` makes of priors beside the truth.

The pairs are those of one place in a dataset, in a tier of an edition or in a whole edition. Of the poses of ``gn-net``
that are not within 0.25 m and 2 degrees, declined or not, are counted those whose truth fits better: alignment from
there on the finest level stays within the thresholds and has a smaller misfit, so that the search has missed it. Where
it stays and fits worse, or leaves, the features are at fault. ``nearest`` are pairs of which one pose is right among
all those to which a start was aligned on the finest level, without and with alignment from the truth. The priors of
``gn-net-from-prior`` are the truth, moved in a random direction and turned about a random axis by a distance and an
angle that are drawn evenly up to the largest; answers with a confidence of 0.5 or more are sure.

    python benchmarks/publish/gn_net_limits.py DATASET [DATASET ...] [--set KEY=VALUE ...]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from answers import ANGLE_DEG, POSITION_M
from keyframe_start import beside

from baselines.alignment.features.solver import FeatureAlignment, align_features
from baselines.alignment.shared.starts import Start
from baselines.gn_net.method import GnNetReference
from baselines.gn_net.tracker import GnNet
from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.edition_folder import datasets_of
from relocbench.errors import RelocbenchError
from relocbench.methods import parse_method
from relocbench.metrics import pose_errors
from relocbench.tracking import Query

IMAGES, SURE = 20, 0.5
"""whose feature maps are kept; the confidence of sure answers"""


class Watched(GnNet):
    """``gn-net`` that keeps what its last alignment found."""

    found: FeatureAlignment | None = None

    def _info(self, found: FeatureAlignment) -> dict[str, Any]:
        self.found = found
        return super()._info(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="+", type=Path, metavar="DATASET", help="dataset, edition or tier of one")
    parser.add_argument("--metres", type=float, default=0.4, help="largest distance of a prior to the truth")
    parser.add_argument("--degrees", type=float, default=8.0, help="largest angle of a prior to the truth")
    parser.add_argument("--seed", type=int, default=0, help="of the priors")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="parameter of both trackers")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    try:
        search, prior = measured(options)
    except RelocbenchError as bad:
        parser.exit(2, f"{bad}\n")
    told = {"gn-net": table("gn-net", search)}
    near_by = f"priors at most {options.metres:g} m and {options.degrees:g} degrees beside the truth"
    told["gn-net-from-prior"] = table(f"gn-net-from-prior, {near_by}", prior)
    print(json.dumps({"benchmark": "gn_net_limits", **told}))


def measured(options: argparse.Namespace) -> tuple[dict[str, Counter[str]], dict[str, Counter[str]]]:
    """What the pairs of each dataset count for, of ``gn-net`` and of ``gn-net-from-prior``."""
    watched = Watched(**{**parse_method("gn-net", options.set).parameters, "cache_size": IMAGES})
    from_prior = parse_method("gn-net-from-prior", options.set).create()
    from_prior._cache = watched._cache
    search: dict[str, Counter[str]] = defaultdict(Counter)
    prior: dict[str, Counter[str]] = defaultdict(Counter)
    for folder in (each for given in options.datasets for each in datasets_of(given)):
        dataset, rng = Dataset(folder), np.random.default_rng(options.seed)
        for reference, query, truth in questions(watched, dataset):
            near = beside(truth, rng.uniform(0, options.metres), rng.uniform(0, options.degrees), rng)
            search[dataset.name].update(limits(watched, reference, query, truth))
            prior[dataset.name].update(from_near(from_prior, reference, query, truth, near))
    return search, prior


def questions(tracker: GnNet, dataset: Dataset) -> Iterator[tuple[GnNetReference, Query, Array]]:
    """The prepared keyframe, the query and the true T_query_ref of each pair."""
    for pair_set in dataset.pair_sets():
        for pair in pair_set.pairs:
            if pair.T_query_ref is not None:
                reference = tracker.prepare(dataset.reference(pair_set, pair))
                yield reference, dataset.query(pair_set, pair), pair.T_query_ref


def limits(tracker: Watched, reference: GnNetReference, query: Query, truth: Array) -> dict[str, int]:
    """What a pair counts for, by column."""
    tracker.found = None
    answered, found = tracker.track(reference, query).answered, tracker.found
    there = align_features(
        reference.features, tracker.features(query.image, query.camera), [Start(truth, 0)], tracker.settings
    )
    right = found is not None and not found.failure and is_right(found.T_query_ref, truth)
    stays = not there.failure and is_right(there.T_query_ref, truth)
    fits = found is None or there.misfit < found.misfit
    nearest = found is not None and any(is_right(pose, truth) for pose in found.reached)
    wrong = not right
    counted = {
        "pairs": True,
        "right": right,
        "wrong": wrong,
        "of these declined": wrong and not answered,
        "truth fits better": wrong and stays and fits,
        "truth fits worse": wrong and stays and not fits,
        "truth is left": wrong and not stays,
        "nearest": nearest,
        "nearest, with the truth": nearest or stays,
    }
    return {column: int(counts) for column, counts in counted.items()}


def from_near(tracker: GnNet, reference: GnNetReference, query: Query, truth: Array, near: Array) -> dict[str, int]:
    """What a pair counts for, by column."""
    answer = tracker.track(reference, query, near)
    right = answer.T_query_ref is not None and is_right(answer.T_query_ref, truth)
    sure, wrong = (answer.confidence or 0.0) >= SURE, answer.answered and not right
    counted = {
        "pairs": True,
        "right": right,
        "wrong": wrong,
        "declined": not answer.answered,
        "sure and right": right and sure,
        "sure and wrong": wrong and sure,
    }
    return {column: int(counts) for column, counts in counted.items()}


def is_right(pose: Array, truth: Array) -> bool:
    errors = pose_errors(pose[None], truth[None])
    return bool(errors.translation_error_m[0] <= POSITION_M and errors.rotation_error_deg[0] <= ANGLE_DEG)


def table(title: str, rows: Mapping[str, Counter[str]]) -> dict[str, int]:
    """Print the counts of each dataset and of all of them, also in percent of the pairs; those of all."""
    columns = next(iter(rows.values()), {})
    total = {column: sum(row[column] for row in rows.values()) for column in columns}
    print(f"\n## {title}\n\n| dataset | {' | '.join(columns)} |\n|---{'|---' * len(columns)}|")
    for name, row in [*rows.items(), ("all", total)]:
        print(f"| {name} | {' | '.join(str(row[column]) for column in columns)} |")
    shares = (100 * total[column] / total["pairs"] for column in columns)
    print(f"| all, % | {' | '.join(f'{share:.1f}' for share in shares)} |")
    return total


if __name__ == "__main__":
    main()
