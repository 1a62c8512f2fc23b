"""What feature trackers lose if a keyframe's depth is known on the rings of a lidar alone.

The depth images of a dataset are thinned to every third pixel of every N-th row, which is what a lidar's rings give on
an image; both trackers then run with the default reach of sparse depth and with fixed ones. Printed are the pairs
within 0.25 m and 2 degrees, the median errors and the median number of inliers. Without a dataset the demo town is
rendered.

With ``--recording`` a sequence in KITTI's layout is built twice, with depth by stereo and with depth by its lidar, and
both trackers are asked the pairs that both have. Printed is also how many pairs are right with stereo alone, and with
lidar alone. ``--recording rendered`` renders a drive in that layout; ``tools/kitti_lidar_poses.py`` makes the poses of
KITTI 00.

    python benchmarks/truth/sparse_depth.py [DATASET] [--rings 5,9]
    python benchmarks/truth/sparse_depth.py --recording ROOT --sequence 00 [--steps 1,2,3,4,5]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from baselines.feature_pnp import FeaturePnp, OrbPnp, SiftPnp
from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.metrics import pose_errors
from relocbench.tracking import KeyframePoints, Reference, TrackResult

TRACKERS: dict[str, type[Any]] = {"orb-pnp": OrbPnp, "sift-pnp": SiftPnp}
RELATIVE_SIGMA = 0.01
"""of the points' inverse depths"""
COLUMNS = 3
FIXED_PX = (2.0, 10.0)


class Answer(NamedTuple):
    """How far off an answer is; infinitely where there is none."""

    metres: float
    degrees: float
    inliers: int

    @property
    def right(self) -> bool:
        return self.metres <= 0.25 and self.degrees <= 2.0

    @classmethod
    def of(cls, result: TrackResult, truth: Array) -> Answer:
        """The answer of a tracker to a pair whose T_query_ref is ``truth``."""
        inliers = int(result.info.get("inliers", 0))
        if result.T_query_ref is None:
            return cls(np.inf, np.inf, inliers)
        found = pose_errors(result.T_query_ref[None], truth[None])
        return cls(float(found.translation_error_m[0]), float(found.rotation_error_deg[0]), inliers)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, nargs="?", help="with depth images; default: the demo town")
    parser.add_argument("--rings", default="5,9", help="distances of the rings, pixels")
    parser.add_argument("--recording", help="folder with sequences/ and poses/, or 'rendered'")
    parser.add_argument("--sequence", default="00", help="of the recording")
    parser.add_argument("--steps", default="1,2,3,4,5", help="frames between keyframe and query")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as temporary:
        if options.recording:
            root = Path(options.recording)
            if options.recording == "rendered":
                root = _drive(Path(temporary) / "drive")
            _compare(root, options.sequence, options.steps, Path(temporary))
            return
        dataset = Dataset(options.dataset or _demo(Path(temporary) / "demo"))
        _tell(dataset, [int(part) for part in options.rings.split(",")])


def _demo(out: Path) -> Path:
    _build("synthetic", "--preset", "demo", "--out", out)
    return out


def _drive(out: Path) -> Path:
    """A rendered drive in KITTI's layout, with a stereo camera and a lidar of 64 rings."""
    of_car = "--recording", "kitti", "--recording-cameras", "image_0,image_1", "--steps", 30
    _build("synthetic", *of_car, "--conditions", "Sunny", "--split", "validation", "--seed", 7, "--out", out)
    return out


def _build(*words: object) -> None:
    command = [sys.executable, "-m", "relocbench", "build-dataset", *map(str, words), "-q"]
    ended = subprocess.run(command, check=False, stdout=sys.stderr)
    if ended.returncode:
        sys.exit(ended.returncode)  # what was wrong has been said


def _compare(root: Path, sequence: str, steps: str, temporary: Path) -> None:
    datasets = {}
    for depth in ("stereo", "velodyne"):
        of_pairs = "--sequence", sequence, "--depth", depth, "--pair-step", steps, "--correspondences", 0
        _build("kitti", root, *of_pairs, "--out", temporary / depth)
        datasets[depth] = Dataset(temporary / depth)
    rows = []
    print("| tracker | depth | pairs | right | with this depth alone | median m | median degrees | inliers |")
    print("|---|---|---|---|---|---|---|---|")
    for name, kind in TRACKERS.items():
        stereo, lidar = (_asked(dataset, kind(), 0) for dataset in datasets.values())
        both = stereo.keys() & lidar.keys()
        if not both:
            sys.exit(f"{root}: no pair has depth of both kinds; expected keyframes with right image and scan")
        for depth, answers, other in (("stereo", stereo, lidar), ("lidar", lidar, stereo)):
            row = _summary([answers[pair] for pair in both])
            row["alone"] = sum(answers[pair].right and not other[pair].right for pair in both)
            rows.append({"tracker": name, "depth": depth, **row})
            errors = f"{row['metres']:.3f}", f"{row['degrees']:.3f}"
            cells = row["pairs"], row["right"], row["alone"], *errors, row["inliers"]
            print(f"| {name} | {depth} | {' | '.join(map(str, cells))} |", flush=True)
    print(json.dumps({"benchmark": "sparse_depth", "sequence": sequence, "rows": rows}))


def _tell(dataset: Dataset, spacings: list[int]) -> None:
    rows = []
    print("| tracker | depth | reach, px | pairs | right | median m | median degrees | inliers |")
    print("|---|---|---|---|---|---|---|---|")
    for name, kind in TRACKERS.items():
        for rings in (0, *spacings):
            for reach in (None, *FIXED_PX) if rings else (None,):
                row = _summary(_asked(dataset, kind(depth_radius_px=reach), rings).values())
                rows.append({"tracker": name, "rings": rings, "reach": reach, **row})
                depth, px = (f"every {rings}th row", f"{reach or 'default'}") if rings else ("dense", "")
                cells = row["pairs"], row["right"], f"{row['metres']:.3f}", f"{row['degrees']:.3f}", row["inliers"]
                print(f"| {name} | {depth} | {px} | {' | '.join(map(str, cells))} |", flush=True)
    print(json.dumps({"benchmark": "sparse_depth", "dataset": dataset.name, "rows": rows}))


def _asked(dataset: Dataset, tracker: FeaturePnp, rings: int) -> dict[tuple[int, int], Answer]:
    """The answers by the times of keyframe and query."""
    answers = {}
    for pair_set in dataset.pair_sets():
        for pair in pair_set.pairs:
            assert pair.T_query_ref is not None
            reference, query = dataset.reference(pair_set, pair), dataset.query(pair_set, pair)
            result = tracker.track(tracker.prepare(_thinned(reference, rings) if rings else reference), query)
            answers[pair.ref_timestamp_ns, pair.query_timestamp_ns] = Answer.of(result, pair.T_query_ref)
    return answers


def _summary(answers: Collection[Answer]) -> dict[str, Any]:
    return {
        "pairs": len(answers),
        "right": sum(answer.right for answer in answers),
        "metres": float(np.median([answer.metres for answer in answers])),
        "degrees": float(np.median([answer.degrees for answer in answers])),
        "inliers": int(np.median([answer.inliers for answer in answers])),
    }


def _thinned(reference: Reference, rings: int) -> Reference:
    """The keyframe with the points of a few rows in place of its depth image."""
    assert reference.depth is not None
    known = np.isfinite(reference.depth) & (reference.depth > 0)
    v, u = np.nonzero(known)
    kept = (v % rings == 0) & (u % COLUMNS == 0)
    v, u = v[kept], u[kept]
    inverse = 1.0 / reference.depth[v, u].astype(np.float64)
    points = KeyframePoints(np.stack([u, v], axis=-1).astype(np.float64), inverse, RELATIVE_SIGMA * inverse)
    return Reference(reference.key, reference.timestamp_ns, reference.image, reference.camera, sparse_points=points)


if __name__ == "__main__":
    main()
