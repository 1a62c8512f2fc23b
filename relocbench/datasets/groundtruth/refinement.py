"""Registration from a prediction: robust, symmetric point-to-plane ICP, coarse to fine.

Chen and Medioni, Object modelling by registration of multiple range images (1992); annealed Geman-McClure weights as
in Zhou, Park and Koltun, Fast global registration (2016); plane to plane as in Segal, Haehnel and Thrun, Generalized
ICP (2009). Both submaps look for planes in the other, so that neither's holes and noise decide alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.planes import PlaneMap, Planes, Sample
from relocbench.errors import ConfigError
from relocbench.geometry import adjoint, hat, invert, project_to_rotation, se3_exp, se3_log

Array = NDArray[np.float64]
Metric = Literal["plane", "generalised"]

CORRELATION = 20.0
"""Information is divided by this: neighbouring residuals share the noise of a plane's normal, of a scan's pose and of
the surface's unevenness, and each contact is counted from both sides. Found by comparing predicted with true errors on
simulated drives with exact odometry; odometry's own drift comes on top through ``drift_per_m``."""
_THIN = 0.02
"""how thick a plane is over how far it reaches, squared, in the generalised metric"""


@dataclass(frozen=True)
class RefinementOptions:
    """Of the way from a prediction to the pose."""

    metric: Metric = "plane"
    levels: tuple[int, ...] = (0, 1, 2)
    """which levels of the plane maps are used, one after the other"""
    scales_m: tuple[float, ...] = (0.5, 0.15, 0.05)
    """of the robust kernel at the end of each level: a residual of so much counts a quarter"""
    iterations: tuple[int, ...] = (12, 10, 14)
    """at most, each level"""
    cosine: float = 0.8
    """of the largest angle between normals that may meet"""
    sigma_m: float = 0.02
    """of a residual close to the nodes"""
    drift_per_m: float = 0.01
    """by which residuals grow with the way along odometry between the node and where a point was measured"""
    turn_per_m: float = 2e-4
    """radians by which odometry may have turned on that way"""
    least_matches: int = 100
    """with fewer, the submaps have too little in common"""

    def __post_init__(self) -> None:
        if not len(self.levels) == len(self.scales_m) == len(self.iterations) > 0:
            raise ConfigError("levels, scales_m and iterations of the refinement need one value a level each")
        if min(self.scales_m) <= 0 or self.sigma_m <= 0 or self.drift_per_m < 0:
            raise ConfigError("scales and sigma of the refinement are positive, drift is not negative")


@dataclass(frozen=True, eq=False)
class Linearised:
    """A least-squares problem in xi = (rho, phi) of ``T_ref_query @ se3_exp(xi)``, at xi = 0."""

    H: Array
    """(6, 6) sum of w J J^T"""
    g: Array
    """(6,) sum of w J r; the step is -H^-1 g"""
    residuals: Array
    """(M,) metres, of the points that found a plane, scaled to the sigma of near ones"""
    away_m: float
    """root mean square distance along odometry from the nodes of what was matched, as it counts"""
    closeness: Array
    """(M,) in (0, 1]: how much of a residual's variance is the surface's and not the odometry's"""
    count: int

    @property
    def sigma_m(self) -> float:
        """Robust standard deviation of the residuals near the nodes: 1.4826 times their median without sign."""
        return 1.4826 * weighted_median(np.abs(self.residuals), self.closeness)

    @property
    def information(self) -> Array:
        """(6, 6) for independent residuals: H / sigma^2."""
        return np.asarray(self.H / max(self.sigma_m, 1e-3) ** 2)


NOTHING = Linearised(np.zeros((6, 6)), np.zeros(6), np.zeros(0), 0.0, np.zeros(0), 0)
"""no point found a plane"""


@dataclass(frozen=True, eq=False)
class Refined:
    """Where a refinement ended."""

    T_ref_query: Array
    """(4, 4)"""
    information: Array
    """(6, 6) of xi = (rho, phi), correlation allowed for; zeros where nothing met"""
    sigma_m: float
    count: int
    """points that found a plane at the end, of both sides"""
    iterations: int
    converged: bool


def linearise(
    reference_planes: Planes,
    points: Array,
    normals: Array,
    T_ref_query: Array,
    reach: float,
    *,
    weights: Array | None = None,
    away_m: Array | None = None,
    scale_m: float = 0.05,
    sigma_m: float = 0.02,
    drift_per_m: float = 0.0,
    cosine: float = 0.8,
    metric: Metric = "plane",
) -> Linearised:
    """Distances from points of the query to planes of the reference, and their derivatives.

    The residual of a point q with the plane (p, n) is ``r = n^T (R q + t - p)``; with m = R^T n its derivative is
    ``J = (m, q x m)``.

    Args:
        points: (M, 3) query's frame.
        normals: (M, 3) theirs, query's frame.
        reach: metres, at most the planes' cell.
        weights: (M,) of the points; ones by default. The planes' own weights come on top.
        away_m: (M,) how far along the odometry from the node; used with ``drift_per_m``.
        scale_m: of Geman-McClure's kernel: ``w = (1 + (r / scale)^2)^-2``.
    """
    rotation, translation = T_ref_query[:3, :3], T_ref_query[:3, 3]
    moved, turned = points @ rotation.T + translation, normals @ rotation.T
    match = reference_planes.nearest(moved, turned, reach, cosine)
    rows = np.flatnonzero(match >= 0)
    if not len(rows):
        return NOTHING
    match = match[rows]
    n, q = reference_planes.normals[match], points[rows]
    offset = moved[rows] - reference_planes.points[match]
    residual = np.einsum("ni,ni->n", n, offset)
    away = np.square(reference_planes.away_m[match])
    if away_m is not None:
        away = away + np.square(away_m[rows])
    near = 1 / (1 + np.square(drift_per_m / sigma_m) * away)
    standard = residual * np.sqrt(near)
    w = near * np.minimum(reference_planes.weights[match], 1.0 if weights is None else weights[rows])
    w = w / np.square(1 + np.square(standard / scale_m))
    if metric == "generalised":
        H, g = _plane_to_plane(n, turned[rows], offset, q, rotation, w)
    else:
        m = n @ rotation
        J = np.hstack([m, np.cross(q, m)])
        H, g = J.T @ (w[:, None] * J), J.T @ (w * residual)
    return Linearised(H, g, standard, float(np.sqrt(w @ away / max(w.sum(), 1e-12))), near, len(rows))


def _plane_to_plane(n: Array, turned: Array, offset: Array, q: Array, rotation: Array, w: Array) -> tuple[Array, Array]:
    """H and g with both covariances: each point is uncertain along its plane and certain across it.

    The metric ``M = thin (C_ref + R C_query R^T)^-1 / 2``, so that two equal planes weigh as one plane does.
    """
    spread = 2 * np.eye(3) - (1 - _THIN) * (n[:, :, None] * n[:, None, :] + turned[:, :, None] * turned[:, None, :])
    M = 2 * _THIN * np.linalg.inv(spread) * w[:, None, None]
    J = np.concatenate([np.broadcast_to(rotation, (len(q), 3, 3)), -rotation @ hat(q)], axis=2)
    MJ = M @ J
    return np.einsum("nki,nkj->ij", J, MJ), np.einsum("nki,nk->i", MJ, offset)


def linearise_both(
    ref: PlaneMap, query: PlaneMap, T_ref_query: Array, level: int, reach: float, scale_m: float,
    options: RefinementOptions,
) -> Linearised:  # fmt: skip
    """The query's points against the reference's planes and the other way round, in one problem.

    ``T_query_ref`` moves by ``se3_exp(-Ad(T_ref_query) xi)`` when ``T_ref_query`` moves by ``se3_exp(xi)``.
    """

    def one_way(planes: Planes, sample: Sample, T: Array) -> Linearised:
        return linearise(
            planes, sample.points, sample.normals, T, reach, weights=sample.weights, away_m=sample.away_m,
            scale_m=scale_m, sigma_m=options.sigma_m, drift_per_m=options.drift_per_m, cosine=options.cosine,
            metric=options.metric,
        )  # fmt: skip

    there = one_way(ref.level(level), query.sample(level), T_ref_query)
    back = one_way(query.level(level), ref.sample(level), invert(T_ref_query))
    A = adjoint(T_ref_query)
    return Linearised(
        there.H + A.T @ back.H @ A,
        there.g - A.T @ back.g,
        np.concatenate([there.residuals, back.residuals]),
        float(np.hypot(there.away_m, back.away_m) / np.sqrt(2)),
        np.concatenate([there.closeness, back.closeness]),
        there.count + back.count,
    )


def weighted_median(values: Array, weights: Array) -> float:
    """The value (N,) with half of the weight (N,) below it; nan of none."""
    if not len(values):
        return float("nan")
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[min(np.searchsorted(total, total[-1] / 2), len(order) - 1)]])


def refine(
    ref: PlaneMap,
    query: PlaneMap,
    T_ref_query: Array,
    options: RefinementOptions | None = None,
    prior_information: Array | None = None,
    levels: Sequence[int] | None = None,
) -> Refined:
    """The pose near a prediction where both submaps' planes agree.

    Args:
        T_ref_query: (4, 4) the prediction.
        prior_information: (6, 6) of the prediction: holds what the planes do not, weighs nothing in the result's
            information. None: a direction that nothing holds stays as predicted.
        levels: indices into ``options.levels``; all by default. The last alone is for a prediction that is good to
            decimetres.
    """
    options = options or RefinementOptions()
    T, steps, converged = np.array(T_ref_query, dtype=np.float64), 0, False
    problem = NOTHING
    for k in range(len(options.levels)) if levels is None else levels:
        level = options.levels[k]
        reach = min(ref.options.reach_m[level], query.options.reach_m[level])
        converged = False
        for iteration in range(options.iterations[k]):
            # The kernel narrows over a level's first iterations, so that far residuals can still pull at its start.
            scale = options.scales_m[k] * max(1.0, 2.0 * 0.6**iteration)
            problem = linearise_both(ref, query, T, level, reach, scale, options)
            if problem.count < options.least_matches:
                return Refined(T, np.zeros((6, 6)), problem.sigma_m, problem.count, steps, False)
            xi = _step(problem, T, T_ref_query, prior_information)
            T = T @ se3_exp(xi)
            steps += 1
            if iteration >= 2 and np.linalg.norm(xi[:3]) < 2e-4 and np.linalg.norm(xi[3:]) < 2e-5:
                converged = True
                break
    T[:3, :3] = project_to_rotation(T[:3, :3])
    return Refined(T, _information(problem, options), problem.sigma_m, problem.count, steps, converged)


def assess(ref: PlaneMap, query: PlaneMap, T_ref_query: Array, options: RefinementOptions, iterations: int) -> Refined:
    """A pose found otherwise, with the information that it would have had it been found here."""
    level = options.levels[-1]
    reach = min(ref.options.reach_m[level], query.options.reach_m[level])
    problem = linearise_both(ref, query, T_ref_query, level, reach, options.scales_m[-1], options)
    enough = problem.count >= options.least_matches
    information = _information(problem, options) if enough else np.zeros((6, 6))
    return Refined(T_ref_query, information, problem.sigma_m, problem.count, iterations, enough)


def _information(problem: Linearised, options: RefinementOptions) -> Array:
    """(6, 6) of the residuals' noise, and of odometry's drift between the nodes and what was matched."""
    noise = np.linalg.pinv(problem.information / CORRELATION, hermitian=True)
    drift = problem.away_m * np.repeat([options.drift_per_m, options.turn_per_m], 3)
    return np.asarray(np.linalg.inv(noise + np.diag(np.square(drift))))


def _step(problem: Linearised, T: Array, T_start: Array, prior: Array | None) -> Array:
    """(6,) Gauss-Newton, held where nothing else does."""
    H, g = problem.H, problem.g
    if prior is not None:
        variance = max(problem.sigma_m, 1e-3) ** 2 * CORRELATION
        H, g = H + variance * prior, g + variance * prior @ se3_log(invert(T_start) @ T)
    size = np.sqrt(np.maximum(np.diag(H), 1e-12))
    values, vectors = np.linalg.eigh(H / np.outer(size, size))
    held = values > 1e-6 * values[-1]
    along = vectors[:, held]
    return np.asarray(-(along @ ((along.T @ (g / size)) / values[held])) / size)
