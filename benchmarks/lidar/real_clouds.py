"""Registration of real point clouds: our method and others, compared with a pose graph and by closing triangles.

Two sets of five real scans come with poses from a published pose graph: KITTI 07, 3 to 28 m apart and rotated by up to
87 degrees, and Newer College, 1 to 4 m apart. All pairs of a set overlap and are registered. The beams of KITTI's lidar
point too low; its scans are used as they are, and with the beams raised as by ``--elevation`` of the importer.

``precision``: our refinement and others that share no code with it (Open3D's point-to-plane ICP with a robust kernel,
Open3D's generalised ICP, and small_gicp if it is installed) all start from the graph's pose. If they agree with each
other but not with the graph, the graph is inaccurate. No method can close the triangles a-b, b-c, a-c better than the
scans allow, whereas the graph closes them by construction. ``adjusted`` are the poses that best fit all ten
registrations of a method, without the graph.

``starts``: registration from the identity rotated by up to 30 degrees about random axes, by refinement alone and with
feature matches that agree with this prediction; and without a prior, by the builder's search alone and with coarser
searches in addition. A result within 0.3 m and 1 deg of the graph is ``right``.

``kitti00``: along-track distances of odometry from scans against those of scan-to-scan registration, and the depth of
an image from the builder's submap against semi-global matching of the stereo pair, in pixels of disparity.

    python benchmarks/lidar/real_clouds.py [--data DIR] [--starts N] [--seed N] [--parts precision,starts,kitti00]

Recordings are read from --data, by default $RELOCBENCH_REAL_DATA or ../shared/data; missing ones are skipped.
Tables go to standard error; the last line of standard output is JSON. Figures outside of their limits are named,
and the exit code is 1.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"  # so that the order of sums does not depend on the machine

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from limits import Limits
from real_clouds_figures import register_all, say, tell_kitti_00, tell_precision, tell_starts
from real_clouds_methods import OWN
from real_clouds_scans import SOURCES, read_scans

from relocbench.datasets.importers.kitti.recording import REAL_ELEVATION_DEG
from relocbench.errors import RelocbenchError

PARTS = ("precision", "starts", "kitti00")
DATA = Path(os.environ.get("RELOCBENCH_REAL_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))


def expect_precision(limits: Limits, title: str, figures: dict[str, Any]) -> None:
    """Methods that share no code agree with ours, and ours with itself, better than with the graph.

    Scans of Newer College are dense and 1 to 4 m apart, those of KITTI thinner and up to 28 m apart.
    """
    dense, own = title == "Newer College", figures["methods"][OWN]
    limits.expect(f"{title}, two methods off each other, cm", figures["mutual"]["max_cm"], 0, 1.0 if dense else 4.0)
    neighbours = figures["neighbours"]
    limits.expect(f"{title}, neighbours off the graph, cm", neighbours["max_cm"], 0, 2.5 if dense else 3.5)
    limits.expect(f"{title}, neighbours off the graph, deg", neighbours["max_deg"], 0, 0.08 if dense else 0.32)
    limits.expect(f"{title}, our triangles, cm", own["triangles"]["max_cm"], 0, 2.5 if dense else 5.0)
    limits.expect(f"{title}, off our adjusted poses, cm", own["off_adjusted"]["max_cm"], 0, 1.0 if dense else 2.0)
    for name in (OWN, "GICP") if dense else (OWN,):
        limits.expect(
            f"{title}, spread of {name}, cm", figures["methods"][name]["spread_cm"], 0, figures["graph_spread_cm"]
        )
    if dense:
        limits.expect(f"{title}, pairs with the graph outside of all methods", figures["graph_outside_methods"], 8)


def expect_starts(limits: Limits, title: str, figures: dict[str, Any]) -> None:
    """Every pair is found from every start with guesses, and without a prior."""
    limits.expect(f"{title}, starts that lead to the pose", figures["with_guesses"], figures["starts"])
    limits.expect(f"{title}, pairs found without a prior", figures["coarse"], figures["pairs"])


def expect_kitti_00(limits: Limits, found: dict[str, Any]) -> None:
    """Odometry agrees with registrations, depth with stereo; raised beams leave no bias."""
    for name, figures in found.items():
        limits.expect(f"KITTI 00, {name}, odometry off, cm", figures["max_error_cm"], 0, 1.5)
        limits.expect(f"KITTI 00, {name}, depth off in the median, px", figures["median_px"], 0, 0.7)
        limits.expect(f"KITTI 00, {name}, share of depth within 3 px", figures["within_3px"], 0.85)
        limits.expect(f"KITTI 00, {name}, coverage", figures["coverage"], 0.4)
    raised = f"elevation_{REAL_ELEVATION_DEG:.3f}"
    limits.expect("KITTI 00, bias of depth with beams raised, px", found[raised]["bias_px"], -0.15, 0.15)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the real recordings")
    parser.add_argument("--starts", type=int, default=5, help="rotated starts for each pair")
    parser.add_argument("--seed", type=int, default=0, help="seed of the rotations")
    parser.add_argument("--parts", default=",".join(PARTS), help="parts to run")
    arguments = parser.parse_args()
    parts = arguments.parts.split(",")
    if arguments.starts < 1 or not set(parts) <= set(PARTS):
        parser.error(f"--starts is at least 1, --parts are of {', '.join(PARTS)}")
    result: dict[str, Any] = {"benchmark": "real_clouds"}
    limits = Limits()
    clouds, kitti = arguments.data / "lidar_submaps_with_graph", arguments.data / "kitti_odometry"
    try:
        if not clouds.is_dir():
            say(f"skipped: no scans with a graph in {clouds}")
        elif {"precision", "starts"} & set(parts):
            for source in SOURCES:
                scans = read_scans(clouds, source)
                figures = result.setdefault(source.title, {})
                if "precision" in parts:
                    figures["precision"] = tell_precision(register_all(scans))
                    expect_precision(limits, source.title, figures["precision"])
                if "starts" in parts:
                    figures["starts"] = tell_starts(scans, arguments.starts, arguments.seed)
                    expect_starts(limits, source.title, figures["starts"])
        if "kitti00" in parts:
            if kitti.is_dir():
                result["KITTI 00"] = tell_kitti_00(kitti)
                expect_kitti_00(limits, result["KITTI 00"])
            else:
                say(f"skipped: no KITTI sequences in {kitti}")
    except RelocbenchError as error:
        say(str(error))
        sys.exit(2)
    print(json.dumps(result))
    limits.end()


if __name__ == "__main__":
    main()
