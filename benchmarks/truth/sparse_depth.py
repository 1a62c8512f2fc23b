"""What feature trackers lose if a keyframe's depth is known on the rings of a lidar alone.

The depth images of a dataset are thinned to every third pixel of every N-th row, which is what a lidar's rings give on
an image; both trackers then run with the default reach of sparse depth and with fixed ones. Printed are the pairs
within 0.25 m and 2 degrees, the median errors and the median number of inliers. Without a dataset the demo town is
rendered.

    python benchmarks/truth/sparse_depth.py [DATASET] [--rings 5,9]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from baselines.feature_pnp import FeaturePnp, OrbPnp, SiftPnp
from relocbench.datasets.core.dataset import Dataset
from relocbench.metrics import pose_errors
from relocbench.tracking import KeyframePoints, Reference

TRACKERS: dict[str, type[Any]] = {"orb-pnp": OrbPnp, "sift-pnp": SiftPnp}
RELATIVE_SIGMA = 0.01
"""of the points' inverse depths"""
COLUMNS = 3
FIXED_PX = (2.0, 10.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, nargs="?", help="with depth images; default: the demo town")
    parser.add_argument("--rings", default="5,9", help="distances of the rings, pixels")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as temporary:
        dataset = Dataset(options.dataset or _demo(Path(temporary) / "demo"))
        _tell(dataset, [int(part) for part in options.rings.split(",")])


def _demo(out: Path) -> Path:
    words = "build-dataset", "synthetic", "--preset", "demo", "--out", str(out), "-q"
    subprocess.run([sys.executable, "-m", "relocbench", *words], check=True)
    return out


def _tell(dataset: Dataset, spacings: list[int]) -> None:
    rows = []
    print("| tracker | depth | reach, px | pairs | right | median m | median degrees | inliers |")
    print("|---|---|---|---|---|---|---|---|")
    for name, kind in TRACKERS.items():
        for rings in (0, *spacings):
            for reach in (None, *FIXED_PX) if rings else (None,):
                row = _asked(dataset, kind(depth_radius_px=reach), rings)
                rows.append({"tracker": name, "rings": rings, "reach": reach, **row})
                depth, px = (f"every {rings}th row", f"{reach or 'default'}") if rings else ("dense", "")
                cells = row["pairs"], row["right"], f"{row['metres']:.3f}", f"{row['degrees']:.3f}", row["inliers"]
                print(f"| {name} | {depth} | {px} | {' | '.join(map(str, cells))} |", flush=True)
    print(json.dumps({"benchmark": "sparse_depth", "dataset": dataset.name, "rows": rows}))


def _asked(dataset: Dataset, tracker: FeaturePnp, rings: int) -> dict[str, Any]:
    errors, inliers = [], []
    for reference, query, truth in _pairs(dataset):
        result = tracker.track(tracker.prepare(_thinned(reference, rings) if rings else reference), query)
        inliers.append(result.info.get("inliers", 0))
        if result.T_query_ref is None:
            errors.append((np.inf, np.inf))
        else:
            found = pose_errors(result.T_query_ref[None], truth[None])
            errors.append((float(found.translation_error_m[0]), float(found.rotation_error_deg[0])))
    metres, degrees = np.array(errors).T
    return {
        "pairs": len(errors),
        "right": int(np.sum((metres <= 0.25) & (degrees <= 2.0))),
        "metres": float(np.median(metres)),
        "degrees": float(np.median(degrees)),
        "inliers": int(np.median(inliers)),
    }


def _pairs(dataset: Dataset) -> Iterator[tuple[Reference, Any, Any]]:
    for pair_set in dataset.pair_sets():
        for pair in pair_set.pairs:
            yield dataset.reference(pair_set, pair), dataset.query(pair_set, pair), pair.T_query_ref


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
