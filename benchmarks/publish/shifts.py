"""Print which trackers find the known shift between images whose camera motion is not known otherwise.

For a dataset made by ``python tools/real_sets shifted-images``: a true pose there is one of many that shift the image
by the pixels that were measured, so that errors in metres and degrees do not tell whether a tracker is right. The shift
of an answer is the median, over a grid of the keyframe's pixels with depth, of how far to the right its pose draws
them. It is right within 40 pixels of the shift of the true pose (--within). Beside all pairs stand those on which the
keyframe's own pose is wrong.

    python benchmarks/publish/shifts.py DATASET RESULTS [--within 40] [--out leaderboard/real]

--out is a folder, where NAME.md is written after the dataset's name. The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair
from relocbench.evaluation.common.results import dataset_results
from relocbench.evaluation.tables.answers import read_answers
from relocbench.evaluation.tracking.score import read_predictions
from relocbench.geometry import apply

SURE = 0.5
_STEP = 32
"""pixels between the points of the grid"""
_HEAD = """# {name}: shifts

Printed by `python benchmarks/publish/shifts.py`, which says how a shift is judged. Right is an answer whose shift is
within {within:g} pixels of the one that was set by hand; far pairs are those that shift by more, on which the
keyframe's own pose is wrong. The median is over all pairs, and a pair without an answer is infinitely far off. Sure are
answers with a confidence of 0.5 or more, of trackers that state one. gn-net, gn-net-from-prior and gn-net-contrastive
also try starts up to 10 m ahead and behind along the road.
"""


@dataclass(frozen=True)
class Found:
    """What a tracker found of a dataset's pairs."""

    off: Array
    """(N,) pixels between its shift and the true one; inf without an answer"""
    confidence: Array
    """(N,) NaN where none is stated"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("results", type=Path)
    parser.add_argument("--within", type=float, default=40.0, help="pixels within which a shift is right")
    parser.add_argument("--out", type=Path, help="folder for NAME.md")
    options = parser.parse_args()
    dataset = Dataset(options.dataset)
    true, found = shifts(dataset, options.results)
    text = table(true, found, options.within)
    print(text)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        head = _HEAD.format(name=dataset.name, within=options.within)
        (options.out / f"{dataset.name}.md").write_text(f"{head}\n{text}\n")
    right = {label: int(np.sum(each.off <= options.within)) for label, each in found.items()}
    print(json.dumps({"benchmark": "shifts", "pairs": len(true), "right": right}))


def shifts(dataset: Dataset, results: Path) -> tuple[Array, dict[str, Found]]:
    """The true shifts (N,) of all pairs, and what each method of the results found that answered them all."""
    methods, names = dataset_results(results, dataset).methods(), dataset.pair_set_names
    folders = [folder for folder in methods if all(folder.complete(name) for name in names)]
    true: list[float] = []
    found: dict[str, list[tuple[float, float]]] = {folder.label: [] for folder in folders}
    for pair_set in dataset.pair_sets():
        name = pair_set.name
        poses = {each.label: read_predictions(each.predictions(name), pair_set) for each in folders}
        answers = {each.label: read_answers(each.answers(name)) for each in folders}
        for pair in pair_set.pairs:
            assert pair.T_query_ref is not None
            draw = Drawn(dataset, pair_set, pair)
            true.append(draw.shift(pair.T_query_ref))
            for label, rows in found.items():
                pose, confidence = poses[label].get(pair.key), answers[label][pair.key].confidence
                off = np.inf if pose is None else abs(draw.shift(pose) - true[-1])
                rows.append((off, np.nan if confidence is None else confidence))
    return np.array(true), {label: Found(*np.array(rows).T) for label, rows in found.items()}


class Drawn:
    """Where poses draw a grid of a keyframe's pixels."""

    def __init__(self, dataset: Dataset, pair_set: PairSet, pair: Pair) -> None:
        drive = dataset.traversal(pair_set.reference)
        keyframe = drive.reference(pair_set.reference_camera, pair.ref_timestamp_ns)
        self.camera = pair_set.query_traversal.camera(pair_set.query_camera, pair.query_timestamp_ns)
        assert keyframe.depth is not None
        v, u = np.mgrid[: keyframe.camera.height : _STEP, : keyframe.camera.width : _STEP].reshape(2, -1)
        depth = keyframe.depth[v, u]
        self.pixels = np.stack([u, v], axis=-1)[depth > 0]
        self.points = keyframe.camera.unproject(self.pixels)[0] * depth[depth > 0][:, None]

    def shift(self, T_query_ref: Array) -> float:
        """Pixels to the right; inf if the pose draws most points nowhere."""
        drawn, in_front = self.camera.project(apply(T_query_ref, self.points))
        return float(np.median(np.where(in_front, drawn[:, 0] - self.pixels[:, 0], np.inf)))


def table(true: Array, found: dict[str, Found], within: float) -> str:
    """A row for each tracker, best first."""
    far = np.abs(true) > within
    heads = f"right of {len(true)} | right of {far.sum()} far pairs | median px | refused | sure | sure and wrong"
    lines = [f"| tracker | {heads} |", f"|---|{'---:|' * 6}"]
    for label, each in sorted(found.items(), key=lambda item: -np.sum(item[1].off <= within)):
        right, sure = each.off <= within, each.confidence >= SURE
        stated = not np.all(np.isnan(each.confidence))
        cells = [right.sum(), (right & far).sum(), f"{np.median(each.off):.1f}", np.isinf(each.off).sum()]
        cells += [sure.sum(), (sure & ~right).sum()] if stated else ["", ""]
        lines.append(f"| {label} | {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
