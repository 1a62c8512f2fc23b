"""Registration from a prediction: robust, symmetric point-to-plane ICP, coarse to fine.

Chen and Medioni, Object modelling by registration of multiple range images (1992); annealed Geman-McClure weights as
in Zhou, Park and Koltun, Fast global registration (2016). Points of each submap are matched to planes of the other, so
that holes and noise of both count.

The odometries of two drives differ in scale. Submaps put together along them differ in length, and without a correction
surfaces 30 m ahead of the node would pull against those 30 m behind it. ICP therefore has a seventh unknown, the
scale error s: the scale of the query's odometry relative to the reference's, minus one. It moves each point by s times
its lever arm, which is the vector from the node to the sensor when it measured the point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap, Planes, Sample, nearest_plane
from relocbench.datasets.groundtruth.voxels.voxels import Grid
from relocbench.geometry import adjoint, invert, project_to_rotation, robust_sigma, se3_exp
from relocbench.kernels import njit

CORRELATION = 20.0
"""The information matrix is divided by this, since residuals are correlated: neighbours share the noise of a plane's
normal, of a scan's pose and of an uneven surface, and each match is counted from both sides. The value was found by
comparing predicted with true errors on simulated drives with exact odometry; drift is added by ``drift_per_m``."""
_RESCALED = 5e-4
"""at the last level, planes are moved and sorted anew when the scale error has changed by so much: 15 mm at 30 m"""
_RESCALED_BEFORE = 2e-3
"""the same at levels before"""
_COARSER = 25.0
"""levels before the last end at steps so many times as large: 5 mm and 0.03 degrees"""
_OPEN = 1e-4
"""information added to every direction, so that unconstrained ones have a sigma of 100 m or 100 rad"""


@dataclass(frozen=True)
class IcpOptions:
    """Options of ICP from a predicted pose."""

    levels: tuple[int, ...] = (0, 1, 2)
    """levels of the plane maps, in the order in which they are used"""
    scales_m: tuple[float, ...] = (0.5, 0.15, 0.05)
    """scale of the robust kernel at the end of each level: a residual as large has a weight of 1/4"""
    iterations: tuple[int, ...] = (12, 10, 14)
    """largest number of iterations on each level"""
    cosine: float = 0.8
    """cosine of the largest angle between the normals of a match"""
    sigma_m: float = 0.02
    """standard deviation of a residual near the nodes"""
    drift_per_m: float = 0.006
    """growth of a residual's standard deviation with the length of the lever arm"""
    scale_error_sigma: float = 0.02
    """standard deviation of the scale error; 0 fixes the scale error at 0"""
    turn_per_m: float = 2e-4
    """growth of the rotation's standard deviation, in radians, with the length of the lever arm"""
    least_matches: int = 100
    """with fewer matches ICP gives up: the submaps have too little in common"""


@dataclass(frozen=True, eq=False)
class Linearised:
    """The normal equations, at 0, in xi = (rho, phi) of ``T_ref_query @ se3_exp(xi)`` and the query's scale error."""

    H: Array
    """(7, 7) sum of w J^T J over the matches"""
    g: Array
    """(7,) sum of w J^T r over the matches; the Gauss-Newton step is -H^-1 g"""
    residuals: Array
    """(M,) metres, one a match, divided by how much larger its sigma is than near the node"""
    lever_length_m: float
    """weighted root mean square length of the lever arms of what was matched"""
    surface_share: Array
    """(M,) in (0, 1]: share of a residual's variance that is not due to odometry"""
    count: int
    """number of matches M"""

    @cached_property
    def sigma_m(self) -> float:
        """Robust standard deviation of the residuals near the nodes."""
        return robust_sigma(self.residuals, self.surface_share)


NOTHING = Linearised(np.zeros((7, 7)), np.zeros(7), np.zeros(0), 0.0, np.zeros(0), 0)
"""the problem without any match"""


@dataclass(frozen=True, eq=False)
class IcpResult:
    """The pose that ICP ended at."""

    T_ref_query: Array
    """(4, 4)"""
    information: Array
    """(6, 6) of xi = (rho, phi), corrected for correlation and drift; zeros if there were too few matches"""
    sigma_m: float
    """robust standard deviation of the residuals"""
    count: int
    """number of matches at the end, of both sides"""
    scale_error: float = 0.0
    """scale of the query's odometry that agrees with the reference's, minus one"""


def linearise(
    planes: Planes,
    sample: Sample,
    T_ref_query: Array,
    reach: float,
    scale_m: float,
    options: IcpOptions,
    planes_rescaled: bool = False,
) -> Linearised:
    """Distances of points of the query from planes of the reference, linearised.

    The residual of a point q with the plane (p, n) is ``r = n^T (R q + t - p)``. With m = R^T n its derivative is
    ``J = (m, q x m, m^T c)``, where c is the lever arm of q; if the scale error is that of the planes' drive, the last
    element is ``-n^T c`` with the lever arm c of the plane. A match has the smaller weight of its point and its plane.

    Args:
        planes: of the reference.
        sample: points of the query.
        reach: largest distance of a match, metres; at most the voxel size of the planes.
        scale_m: of Geman-McClure's kernel, ``w = (1 + (r / scale)^2)^-2``.
        planes_rescaled: whether the scale error is that of the planes' drive instead of the points'.
    """
    planes.check_reach(reach)
    of_planes = planes.points, planes.normals, planes.weights, planes.lever_arms
    of_points = sample.points, sample.normals, sample.weights, sample.lever_arms
    growth = (options.drift_per_m / options.sigma_m) ** 2
    H, g, standard, near, away = _linearised(
        *of_planes, planes.grid, *of_points, np.ascontiguousarray(T_ref_query),
        reach, options.cosine, scale_m, growth, planes_rescaled,
    )  # fmt: skip
    return Linearised(H, g, standard, float(np.sqrt(away)), near, len(standard))


@njit(cache=True, nogil=True, error_model="numpy")
def _linearised(
    planes: Array, facing: Array, of_planes: Array, plane_arms: Array, grid: Grid, points: Array, normals: Array,
    of_points: Array, point_arms: Array, T: Array, reach: float, cosine: float, scale: float, growth: float,
    planes_rescaled: bool,
) -> tuple[Array, Array, Array, Array, float]:  # fmt: skip  # pragma: no cover - compiled
    """H, g, the standardised residuals (M,), their shares due to surfaces (M,), and the mean squared lever length.

    Args:
        growth: of a residual's variance with the squared length of the lever arms, as a share of that near the nodes.
    """
    H, g = np.zeros((7, 7)), np.zeros(7)
    standard, near = np.empty(len(points)), np.empty(len(points))
    moved, turned, J = np.empty(3), np.empty(3), np.empty(7)
    count, total, lengths = 0, 0.0, 0.0
    for i in range(len(points)):
        q = points[i]
        for k in range(3):
            moved[k] = T[k, 0] * q[0] + T[k, 1] * q[1] + T[k, 2] * q[2] + T[k, 3]
            turned[k] = T[k, 0] * normals[i, 0] + T[k, 1] * normals[i, 1] + T[k, 2] * normals[i, 2]
        j = nearest_plane(moved, turned, planes, facing, grid, reach, cosine)
        if j < 0:
            continue
        n, c, d = facing[j], point_arms[i], plane_arms[j]
        residual, away, J[6] = 0.0, 0.0, 0.0
        for k in range(3):
            residual += n[k] * (moved[k] - planes[j, k])
            away += c[k] * c[k] + d[k] * d[k]
            J[k] = T[0, k] * n[0] + T[1, k] * n[1] + T[2, k] * n[2]
        for k in range(3):
            J[6] += -n[k] * d[k] if planes_rescaled else J[k] * c[k]
        J[3], J[4], J[5] = q[1] * J[2] - q[2] * J[1], q[2] * J[0] - q[0] * J[2], q[0] * J[1] - q[1] * J[0]
        near[count] = 1 / (1 + growth * away)
        standard[count] = residual * np.sqrt(near[count])
        w = near[count] * min(of_planes[j], of_points[i]) / (1 + (standard[count] / scale) ** 2) ** 2
        for k in range(7):
            g[k] += w * residual * J[k]
            for m in range(k + 1):
                H[k, m] += w * J[k] * J[m]
        total += w
        lengths += w * away
        count += 1
    for k in range(7):
        for m in range(k):
            H[m, k] = H[k, m]
    return H, g, standard[:count], near[:count], lengths / max(total, 1e-12)


def linearise_both(
    ref: tuple[Planes, Sample], query: tuple[Planes, Sample], T_ref_query: Array, reach: float, scale_m: float,
    options: IcpOptions,
) -> Linearised:  # fmt: skip
    """The query's points with the reference's planes and the other way round, in one problem.

    ``T_query_ref`` changes by ``se3_exp(-Ad(T_ref_query) xi)`` when ``T_ref_query`` changes by ``se3_exp(xi)``.
    """
    forward = linearise(ref[0], query[1], T_ref_query, reach, scale_m, options)
    backward = linearise(query[0], ref[1], invert(T_ref_query), reach, scale_m, options, planes_rescaled=True)
    A = np.eye(7)
    A[:6, :6] = -adjoint(T_ref_query)
    return Linearised(
        forward.H + A.T @ backward.H @ A,
        forward.g + A.T @ backward.g,
        np.concatenate([forward.residuals, backward.residuals]),
        float(np.hypot(forward.lever_length_m, backward.lever_length_m) / np.sqrt(2)),
        np.concatenate([forward.surface_share, backward.surface_share]),
        forward.count + backward.count,
    )


def run_icp(
    ref: PlaneMap,
    query: PlaneMap,
    T_ref_query: Array,
    options: IcpOptions | None = None,
    levels: Sequence[int] | None = None,
) -> IcpResult:
    """ICP: the pose near a prediction at which the planes of both submaps agree.

    The pose stays as predicted along directions that the planes leave open.

    Args:
        T_ref_query: (4, 4) the prediction.
        levels: indices into ``options.levels``, all by default. The last one alone suffices for a prediction that is
            good to decimetres.
    """
    options = options or IcpOptions()
    T, scale_error = np.array(T_ref_query, dtype=np.float64), 0.0
    problem = NOTHING
    order = list(range(len(options.levels)) if levels is None else levels)
    last = order[-1]
    for k in order:
        level = options.levels[k]
        reach = min(ref.options.reach_m[level], query.options.reach_m[level])
        applied_scale_error = scale_error
        ref_sides, query_sides = _sides(ref, level, 0.0), _sides(query, level, scale_error)
        rescaled = _RESCALED if k == last else _RESCALED_BEFORE
        for iteration in range(options.iterations[k]):
            if abs(scale_error - applied_scale_error) >= rescaled:
                query_sides, applied_scale_error = _sides(query, level, scale_error), scale_error
            # The kernel narrows over a level's first iterations, so that large residuals have weight at its start.
            scale = options.scales_m[k] * max(1.0, 2.0 * 0.6**iteration)
            problem = linearise_both(ref_sides, query_sides, T, reach, scale, options)
            if problem.count < options.least_matches:
                return IcpResult(T, np.zeros((6, 6)), problem.sigma_m, problem.count, scale_error)
            xi, longer = _step(problem, applied_scale_error, options)
            T, scale_error = T @ se3_exp(xi), applied_scale_error + longer
            # A coarser level only has to lead to where the last one converges.
            least = 1.0 if k == last else _COARSER
            still = (
                np.linalg.norm(xi[:3]) < 2e-4 * least
                and np.linalg.norm(xi[3:]) < 2e-5 * least
                and abs(scale_error - applied_scale_error) < rescaled
            )
            if iteration >= 2 and still:
                break
    T[:3, :3] = project_to_rotation(T[:3, :3])
    return IcpResult(T, _information(problem, options), problem.sigma_m, problem.count, scale_error)


def _sides(planes: PlaneMap, level: int, scale_error: float) -> tuple[Planes, Sample]:
    return planes.level(level).rescaled(scale_error), planes.sample(level).rescaled(scale_error)


def icp_result_at(ref: PlaneMap, query: PlaneMap, T_ref_query: Array, options: IcpOptions) -> IcpResult:
    """A pose that was found by another method, with the information matrix that ICP gives it."""
    level = options.levels[-1]
    reach = min(ref.options.reach_m[level], query.options.reach_m[level])
    sides = _sides(ref, level, 0.0), _sides(query, level, 0.0)
    problem = linearise_both(*sides, T_ref_query, reach, options.scales_m[-1], options)
    information = _information(problem, options) if problem.count >= options.least_matches else np.zeros((6, 6))
    return IcpResult(T_ref_query, information, problem.sigma_m, problem.count)


def _variance(problem: Linearised) -> float:
    """The variance of a residual in m^2, enlarged because residuals are correlated."""
    return float(max(problem.sigma_m, 1e-3) ** 2 * CORRELATION)


def _information(problem: Linearised, options: IcpOptions) -> Array:
    """(6, 6) information of the pose: from the residuals, with the scale error marginalised, less the drift of odometry
    over the lever arms."""
    H = problem.H[:6, :6] / _variance(problem)
    if options.scale_error_sigma > 0:
        with_scale_error = problem.H[6, :6] / _variance(problem)
        own = problem.H[6, 6] / _variance(problem) + options.scale_error_sigma**-2
        H = H - np.outer(with_scale_error, with_scale_error) / own
    noise = np.linalg.inv(H + _OPEN * np.eye(6))
    drift = problem.lever_length_m * np.repeat([options.drift_per_m, options.turn_per_m], 3)
    return np.asarray(np.linalg.inv(noise + np.diag(np.square(drift))))


def _step(problem: Linearised, scale_error: float, options: IcpOptions) -> tuple[Array, float]:
    """The Gauss-Newton step (6,) and the scale error's change; directions that nothing constrains do not change."""
    H, g = problem.H.copy(), problem.g.copy()
    count = 6
    if options.scale_error_sigma > 0:
        H[6, 6] += _variance(problem) / options.scale_error_sigma**2
        g[6] += _variance(problem) / options.scale_error_sigma**2 * scale_error
        count = 7
    H, g = H[:count, :count], g[:count]
    size = np.sqrt(np.maximum(np.diag(H), 1e-12))
    values, vectors = np.linalg.eigh(H / np.outer(size, size))
    held = values > 1e-6 * values[-1]
    along = vectors[:, held]
    step = -(along @ ((along.T @ (g / size)) / values[held])) / size
    return step[:6], float(step[6]) if count == 7 else 0.0
