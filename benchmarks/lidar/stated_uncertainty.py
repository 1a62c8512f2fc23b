"""Are the stated uncertainties of ground truth those of its errors? Pose graphs and registrations over many seeds.

Drives of one winding road are simulated without lidar: exact poses, odometry that drifts, and registrations, or fits of
single blocks, with noise of a known size. ``NES`` is the mean of ``e^T C^-1 e / 6`` over all pairs of nodes side by
side, which is 1 if covariances are correct.

- ``gross errors``: 5 % of the registrations are off by metres and must be left out;
- ``too sure``: registrations state a third of their sigma; ``factor`` is by how much their information is divided;
- ``odometry noise``: the largest ratio between the true noise of the odometry and the one that is estimated;
- ``pairs``: the poses of cameras, as a dataset has them;
- ``local, known`` and ``local, estimated``: fits of single blocks, with odometry whose noise is white and known, and
  with odometry that drifts and whose noise is estimated; ``of rigid`` is the median error over that of rigid submaps;
- ``icp``: registrations of two submaps of a street by their points, whose noise is that of single points only.

    python benchmarks/lidar/stated_uncertainty.py [--seeds 8]

The table goes to standard error; the last line of standard output is JSON. Means outside of their limits are named, and
the exit code is 1.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))
import numpy as np
import street_clouds
from limits import Limits
from simulated_blocks import Planes, submap_registrations
from simulated_graph import (
    CAMERA,
    INDEPENDENT,
    WHITE,
    WHITE_SIGMA,
    drive,
    normalised_squares,
    registrations,
    translation_errors,
    two_drives,
    with_gross_errors,
)

from relocbench.datasets.groundtruth.icp.icp import IcpOptions, run_icp
from relocbench.datasets.groundtruth.pairs.outcome import Outcomes
from relocbench.datasets.groundtruth.pose_graph.graph import optimise
from relocbench.datasets.groundtruth.pose_graph.local_edges import LocalOptions, refine_locally
from relocbench.datasets.groundtruth.pose_graph.odometry_noise import OdometryNoise
from relocbench.datasets.groundtruth.pose_graph.selection import GraphOptions
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.datasets.synthetic.drives.odometry import OdometryErrors
from relocbench.geometry import invert, se3_exp, se3_log

Figures = dict[str, float]


def gross_errors(seed: int) -> Figures:
    reference, query, found = two_drives(300.0, seed)
    rng = np.random.default_rng([seed, 1])
    found, wrong = with_gross_errors(found, rng)
    solution = optimise(reference.nodes, query.nodes, found, options=INDEPENDENT)
    used = np.array([not verdict for verdict in solution.verdicts])
    return {
        "NES": float(normalised_squares(solution, reference, query, (-3, 0, 2)).mean()),
        "wrong used": float(used[wrong].sum()),
        "right used": float(used[~wrong].mean()),
        "median m": float(np.median(translation_errors(solution, reference, query))),
    }


def too_sure(seed: int) -> Figures:
    rng = np.random.default_rng(seed)
    reference, query = drive(200.0, rng, WHITE), drive(200.0, rng, WHITE, 0.7)
    found = registrations(reference, query, rng, stated=1 / 3)
    solution = optimise(reference.nodes, query.nodes, found, options=INDEPENDENT)
    return {
        "NES": float(normalised_squares(solution, reference, query).mean()),
        "factor": float(solution.information_factor),
    }


def odometry_noise(seed: int) -> Figures:
    reference, query, found = two_drives(400.0, seed, WHITE)
    noise = optimise(reference.nodes, query.nodes, found, options=INDEPENDENT).noise
    # The way along is held by the scale of the odometry as well.
    return {
        "ratio": float(np.exp(np.abs(np.log(noise.sigma[1:] / WHITE_SIGMA[1:])).max())),
        "along m": float(noise.along_m),
    }


def pairs(seed: int) -> Figures:
    reference, query, found = two_drives(200.0, seed)
    solution = optimise(reference.nodes, query.nodes, found, options=INDEPENDENT)
    sides = [(one.nodes, Trajectory(one.nodes.times_ns, one.nodes.T_odom_node)) for one in (reference, query)]
    outcomes = Outcomes(solution, *sides, found)
    squares, nodes = [], range(5, 95)
    for j in nodes:
        times = int(reference.nodes.times_ns[j - 2]), int(query.nodes.times_ns[j])
        outcome = outcomes.of(*times, CAMERA, CAMERA)
        if outcome.accepted and outcome.T_query_ref is not None and outcome.covariance is not None:
            true = invert(reference.T_world_node[j - 2] @ CAMERA) @ query.T_world_node[j] @ CAMERA
            error = se3_log(outcome.T_query_ref @ true)
            squares.append(error @ np.linalg.solve(outcome.covariance, error) / 6)
    return {"NES": float(np.mean(squares)), "accepted": len(squares) / len(nodes)}


def _local(seed: int, errors: OdometryErrors, noise: OdometryNoise | None) -> Figures:
    rng = np.random.default_rng(seed)
    reference, query = drive(120.0, rng, errors), drive(120.0, rng, errors, 0.7)
    planes = Planes(reference, query, rng)
    rough = submap_registrations(planes, half=15, every=3)
    start = optimise(reference.nodes, query.nodes, rough, noise, GraphOptions(estimate_noise=noise is None))
    options = LocalOptions(correlation=1.0, reach_m=5.0, estimate_noise=noise is None)
    fine = refine_locally(start, planes, options)
    rigid, local = (np.median(translation_errors(solution, reference, query)) for solution in (start, fine))
    return {
        "NES": float(normalised_squares(fine, reference, query).mean()),
        "of rigid": float(local / rigid),
    }


def local_known(seed: int) -> Figures:
    return _local(seed, WHITE, OdometryNoise(*WHITE_SIGMA))


def local_estimated(seed: int) -> Figures:
    return _local(seed, OdometryErrors(), None)


def icp(seed: int) -> Figures:
    street, options = street_clouds.irregular(5), IcpOptions(drift_per_m=0.0, turn_per_m=0.0)
    poses = street_clouds.pose(100.0, 0.3, 1.0), street_clouds.pose(101.2, -0.6, -2.0)
    true = invert(poses[0]) @ poses[1]
    ref, query = (PreparedSubmap(street_clouds.submap(street, 100 * seed + k, T)) for k, T in enumerate(poses))
    found = run_icp(ref.planes, query.planes, true @ se3_exp([0.1, 0.1, 0, 0, 0, 0.01]), options)
    xi = se3_log(invert(true) @ found.T_ref_query)
    return {"NES": float(xi @ found.information @ xi / 6)}


PARTS: dict[str, tuple[Callable[[int], Figures], dict[str, tuple[float, float]]]] = {
    "gross errors": (
        gross_errors,
        {"NES": (0.5, 2.0), "wrong used": (0, 0), "right used": (0.98, 1), "median m": (0, 0.012)},
    ),
    "too sure": (too_sure, {"NES": (0.5, 2.0), "factor": (6.0, 12.0)}),
    "odometry noise": (odometry_noise, {"ratio": (1.0, 1.25), "along m": (0, 0.006)}),
    "pairs": (pairs, {"NES": (0.5, 2.0), "accepted": (1, 1)}),
    "local, known": (local_known, {"NES": (0.75, 1.3)}),
    "local, estimated": (local_estimated, {"NES": (0.5, 2.0), "of rigid": (0, 0.5)}),
    # What the constant allows for beyond the noise of single points is absent here.
    "icp": (icp, {"NES": (0.01, 1.5)}),
}
"""each part with the limits of the means of its figures"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=8, help="simulations of each part")
    seeds = parser.parse_args().seeds
    result: dict[str, object] = {"benchmark": "stated_uncertainty", "seeds": seeds}
    limits = Limits()
    for name, (simulate, expected) in PARTS.items():
        rows = [simulate(seed) for seed in range(seeds)]
        means = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
        cells = [f"{key} {mean:.3g} ({min(r[key] for r in rows):.3g} to {max(r[key] for r in rows):.3g})"
                 for key, mean in means.items()]  # fmt: skip
        print(f"{name:17s} {', '.join(cells)}", file=sys.stderr, flush=True)
        for key, (least, most) in expected.items():
            limits.expect(f"{name}, {key}", means[key], least, most)
        result[name] = {key: round(mean, 4) for key, mean in means.items()}
    print(json.dumps(result))
    limits.end()


if __name__ == "__main__":
    main()
