"""Methods to register two real scans for ``real_clouds.py``: that of this package, and independent ones."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from real_clouds_scans import Pair, Scans

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.icp.icp import IcpOptions, icp_result_at, run_icp
from relocbench.datasets.groundtruth.pose_graph.edges import Edges, Kind
from relocbench.datasets.groundtruth.pose_graph.least_squares import solve
from relocbench.datasets.groundtruth.registration.global_registration import (
    Features,
    GlobalOptions,
    Prior,
    describe,
    guesses,
)
from relocbench.datasets.groundtruth.registration.hypotheses import plausibility
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap
from relocbench.datasets.groundtruth.verification.verification import verification_evidence
from relocbench.geometry import invert, make_transform, rotation_angle, so3_exp

Answers = dict[Pair, Array]
"""``T_ref_query`` of each pair"""
Method = Callable[[Scans, Pair, Array], Array]
"""maps a prediction of a pair's ``T_ref_query`` to its pose"""

OWN = "own"
SEARCHES = GlobalOptions().attempts()
"""the builder's search; coarser ones follow where it fails, as distant single scans are too sparse for fine features"""
PRIOR_SIGMA_M = 12.0
"""uncertainty of the identity as a prediction, since scans are up to 28 m apart"""
_SIGMA_M, _SIGMA_RAD = 0.01, 5e-4
"""standard deviations of each registration in the adjustment of poses"""
_NEIGHBOURS = 15


def apart(T: Array, other: Array) -> tuple[float, float]:
    """The difference of two poses in metres and degrees."""
    E = invert(other) @ T
    return float(np.linalg.norm(E[:3, 3])), float(np.degrees(rotation_angle(E[:3, :3])))


def _refined(scans: Scans, pair: Pair, start: Array) -> Array:
    return run_icp(scans.sides[pair[0]].planes, scans.sides[pair[1]].planes, start).T_ref_query


@lru_cache(maxsize=1)
def _clouds(scans: Scans) -> list[Any]:
    """The scans with normals, for Open3D."""
    import open3d as o3d

    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)) for points in scans.points]
    for cloud in clouds:
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(_NEIGHBOURS))
    return clouds


def _point_to_plane(scans: Scans, pair: Pair, start: Array) -> Array:
    """Open3D's point-to-plane ICP on all points, with a robust kernel of 5 cm."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    target, source = (_clouds(scans)[k] for k in pair)
    estimation = registration.TransformationEstimationPointToPlane(registration.GMLoss(0.05))
    T = start
    for reach in (1.0, 0.5, 0.3):
        criteria = registration.ICPConvergenceCriteria(1e-9, 1e-9, 100)
        T = registration.registration_icp(source, target, reach, T, estimation, criteria).transformation
    return np.array(T, dtype=np.float64)


def _generalised(scans: Scans, pair: Pair, start: Array) -> Array:
    """Open3D's generalised ICP on all points, without a robust kernel."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    target, source = (_clouds(scans)[k] for k in pair)
    estimation = registration.TransformationEstimationForGeneralizedICP()
    T = start
    for reach in (1.0, 0.5):
        criteria = registration.ICPConvergenceCriteria(1e-9, 1e-9, 100)
        T = registration.registration_generalized_icp(source, target, reach, T, estimation, criteria).transformation
    return np.array(T, dtype=np.float64)


def _small_gicp(scans: Scans, pair: Pair, start: Array) -> Array:
    """small_gicp's generalised ICP on all points."""
    small_gicp = importlib.import_module("small_gicp")
    target, source = (small_gicp.PointCloud(scans.points[k]) for k in pair)
    trees = [small_gicp.KdTree(cloud, num_threads=1) for cloud in (target, source)]
    for cloud, tree in zip((target, source), trees, strict=True):
        small_gicp.estimate_covariances(cloud, tree, 20, 1)
    result = small_gicp.align(
        target, source, trees[0], init_T_target_source=start, registration_type="GICP",
        max_correspondence_distance=0.5, num_threads=1, max_iterations=100,
    )  # fmt: skip
    return np.array(result.T_target_source, dtype=np.float64)


def methods() -> dict[str, Method]:
    """The methods by name, ours first; with small_gicp if it is installed."""
    found: dict[str, Method] = {OWN: _refined, "point-to-plane": _point_to_plane, "GICP": _generalised}
    return {**found, "small_gicp": _small_gicp} if importlib.util.find_spec("small_gicp") else found


def spread_m(scans: Scans, pair: Pair, T_ref_query: Array) -> float:
    """The robust standard deviation of the distances between the scans' surfaces at a pose."""
    ref, query = (scans.sides[k].planes for k in pair)
    return icp_result_at(ref, query, T_ref_query, IcpOptions()).sigma_m


def adjusted(scans: Scans, answers: Answers) -> Array:
    """The poses ``T_world_scan`` (5, 4, 4) that best fit all registrations, with equal weights."""
    pairs = list(answers)
    information = np.diag(1 / np.square(np.repeat([_SIGMA_M, _SIGMA_RAD], 3)))
    edges = Edges(
        first=np.array([p[0] for p in pairs]),
        second=np.array([p[1] for p in pairs]),
        T_first_second=np.array([answers[p] for p in pairs]),
        information=np.broadcast_to(information, (len(pairs), 6, 6)),
        kind=np.full(len(pairs), Kind.REGISTRATION),
    )
    return solve(scans.T_graph_scan, edges)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A hypothesis, refined and evaluated."""

    guess: Array
    T_ref_query: Array
    plausibility: float


def judged(scans: Scans, pair: Pair, guess: Array) -> Candidate:
    """Refine a hypothesis, and evaluate it by overlap and free space besides the fit."""
    ref, query = (scans.sides[k] for k in pair)
    options = IcpOptions()
    found = run_icp(ref.planes, query.planes, guess, options)
    if found.count < options.least_matches:
        return Candidate(guess, found.T_ref_query, -1.0)
    evidence = verification_evidence(ref, query, found.T_ref_query, found.information)
    return Candidate(guess, found.T_ref_query, plausibility(evidence))


def best(candidates: Sequence[Candidate]) -> Array | None:
    """The most plausible hypothesis."""
    return max(candidates, key=lambda c: c.plausibility).T_ref_query if candidates else None


class Search:
    """Hypotheses for pairs by features alone."""

    def __init__(self, sides: Sequence[PreparedSubmap], options: Sequence[GlobalOptions] = SEARCHES) -> None:
        self._options = options
        self._features: list[list[Features]] = [[describe(side.submap, o) for side in sides] for o in options]

    def guesses(self, pair: Pair) -> list[list[Array]]:
        """The hypotheses of each search."""
        found = zip(self._features, self._options, strict=True)
        return [guesses(features[pair[0]], features[pair[1]], None, o) for features, o in found]


def turned_identities(count: int, seed: int, most_deg: float = 30.0) -> list[Array]:
    """The identity rotated about random axes by up to ``most_deg``, one of them by exactly this angle."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(count, 3))
    angles = np.radians(most_deg) * np.append(1.0, rng.uniform(size=count - 1))
    axes *= (angles / np.linalg.norm(axes, axis=1))[:, None]
    return [make_transform(so3_exp(axis), [0.0, 0.0, 0.0]) for axis in axes]


def allowed(start: Array, candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidates whose hypotheses agree with a rotated identity as a prediction."""
    prior = Prior(start, PRIOR_SIGMA_M)
    return [c for c in candidates if prior.allows(c.guess)]
