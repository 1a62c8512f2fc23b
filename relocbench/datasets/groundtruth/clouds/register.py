"""The registration of two clouds: scale, search, verification and covariance, in the clouds' own frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.clouds.cloud import Cloud
from relocbench.datasets.groundtruth.clouds.copies import copied_share
from relocbench.datasets.groundtruth.clouds.judging import free_space_known
from relocbench.datasets.groundtruth.clouds.preparing import Preparation, PreparedCloud, prepare
from relocbench.datasets.groundtruth.clouds.search import CloudSearchResult, SearchOptions, search, steps
from relocbench.datasets.groundtruth.clouds.units import HOPELESS, unit_guesses
from relocbench.datasets.groundtruth.icp.backends import Backend
from relocbench.datasets.groundtruth.registration.global_registration import GlobalOptions, Matcher
from relocbench.datasets.groundtruth.registration.scene_scale import (
    SceneScale,
    SceneSize,
    scale_of,
    scene_size,
)
from relocbench.datasets.groundtruth.registration.submap_pair import NOTHING_JUDGED
from relocbench.datasets.groundtruth.verification.evidence import Evidence
from relocbench.errors import DatasetError
from relocbench.geometry import adjoint, invert
from relocbench.progress import Reporter, Silent


@dataclass(frozen=True)
class CloudRegistrationOptions:
    """Options of the registration of two clouds."""

    matcher: Matcher = "ransac"
    icp: Backend = "own"
    seed: int = 0
    factor: float | None = None
    """by how much the scene is enlarged to the size of a street; None: by its size, spacing and noise"""
    initial: Array | None = None
    """(4, 4) ``T_a_b`` to start from instead of a search"""


@dataclass(frozen=True, eq=False)
class CloudRegistration:
    """The pose of cloud B in the frame of cloud A, in metres and radians."""

    T_a_b: Array
    """(4, 4); nan if there was no guess"""
    information: Array
    """(6, 6) of xi = (rho, phi) in ``T_a_b @ se3_exp(xi)``"""
    T_b_middle: Array
    """(4, 4) of the middle of B (its sensor, or its points), at which sigmas are stated"""
    sigma_m: Array
    """(3,) standard deviations of the middle's position along the axes of A; infinite along those that are open"""
    sigma_deg: float
    """standard deviation of the rotation about its least certain axis; infinite if it is open"""
    evidence: Evidence
    reason: str
    """why the pose is not trusted; empty if it is"""
    rests_on: str
    """the kinds of evidence, in words"""
    scale: SceneScale
    guesses: int
    residuals_m: tuple[Array, Array]
    """distances of B's points from A's surfaces, and of A's from B's"""
    sides: tuple[Preparation, ...]
    """A and B as they were registered; empty if it was not tried"""
    unexplained: float = float("nan")
    """what speaks against the pose, see :func:`relocbench.datasets.groundtruth.clouds.search.unexplained`"""
    copied: float = 0.0
    """share of B's points that are points of A, see :mod:`relocbench.datasets.groundtruth.clouds.copies`"""
    unobservable: str = ""
    """the motions of B that the surfaces cannot tell, in words and in the frame of A; empty if there are none"""
    rival: tuple[Array, float] | None = None
    """the most plausible other pose ``T_a_b`` (4, 4) that is trusted, or nearly, and what speaks against it"""

    @property
    def trusted(self) -> bool:
        return not self.reason

    @property
    def covariance(self) -> Array:
        """(6, 6) of the same xi; infinite where nothing is known."""
        if not self.information.any():
            return np.full((6, 6), np.inf)
        return np.asarray(np.linalg.inv(self.information))


def register_clouds(
    a: Cloud, b: Cloud, options: CloudRegistrationOptions | None = None, reporter: Reporter | None = None
) -> CloudRegistration:
    """Register cloud B to cloud A. The same clouds give the same result.

    Raises:
        DatasetError: a cloud has too few points, or all of them in one place.
        ConfigError: the matcher or ICP needs a package that is not installed.
    """
    o, reporter = options or CloudRegistrationOptions(), reporter or Silent()
    sizes = [_size(cloud) for cloud in (a, b)]
    ratio = sizes[0].radius_m / sizes[1].radius_m
    if o.factor is None and o.initial is None and not 1 / HOPELESS < ratio < HOPELESS:
        larger, times = ("A", ratio) if ratio > 1 else ("B", 1 / ratio)
        found = _nothing(
            f"sizes: {larger} is {times:.3g} times as large; they have too little in common", scale_of(sizes)
        )
    else:
        found = _register(a, b, scale_of(sizes, o.factor), o, reporter, "registering")
    if np.isfinite(found.T_a_b).all():
        found = replace(found, copied=copied_share(a.points, b.points, found.T_a_b))
    if found.trusted:
        return found
    for factor, words in unit_guesses(sizes[0].radius_m, sizes[1].radius_m) if o.initial is None else []:
        scaled = _scaled(b, factor)
        scale = scale_of([sizes[0], _size(scaled)], o.factor)
        if _register(a, scaled, scale, o, reporter, f"registering with B times {factor:g}").trusted:
            reason = f"units: B times {factor:.4g} fits A and would be trusted: {words}?"
            return replace(found, reason=reason)
    return found


def _size(cloud: Cloud) -> SceneSize:
    try:
        return scene_size(cloud.points)
    except DatasetError as bad:
        raise DatasetError(f"cloud {cloud.name} {bad}") from None


def _scaled(cloud: Cloud, factor: float) -> Cloud:
    """A cloud whose coordinates are multiplied by a factor."""
    sensors = None if cloud.sensors is None else cloud.sensors * factor
    return replace(cloud, points=cloud.points * factor, sensors=sensors)


def _register(
    a: Cloud, b: Cloud, scale: SceneScale, o: CloudRegistrationOptions, reporter: Reporter, title: str
) -> CloudRegistration:
    searched = SearchOptions(
        matching=GlobalOptions(matcher=o.matcher, seeds=tuple(range(3 * o.seed, 3 * o.seed + 3))),
        backend=o.icp,
        initial=o.initial,
        drifts=a.drifts or b.drifts,
    )
    total, done = 2 + steps(searched), 0
    with reporter.stage(title, total) as advance:

        def step(count: int) -> None:
            nonlocal done
            done += count
            advance(count)

        sides = []
        for cloud in (a, b):
            sides.append(prepare(cloud, scale))
            step(1)
        one, other = (side.prepared for side in sides)
        if not (one.sees and other.sees):
            one, other = one.judged_by_points(), other.judged_by_points()
        if o.initial is not None:
            initial = invert(one.T_cloud_node) @ scale.enlarged(o.initial) @ other.T_cloud_node
            searched = replace(searched, initial=initial)
        result = search(one, other, scale, free_space_known(one.sees, other.sees), searched, step)
        step(total - done)
    return _in_clouds_frames(result, one, other, scale, (sides[0], sides[1]))


def _in_clouds_frames(
    result: CloudSearchResult,
    a: PreparedCloud,
    b: PreparedCloud,
    scale: SceneScale,
    sides: tuple[Preparation, Preparation],
) -> CloudRegistration:
    T_b_middle = scale.reduced(b.T_cloud_node)
    best = result.best
    if best is None:
        return replace(_nothing(result.reason, scale), T_b_middle=T_b_middle, guesses=result.guesses, sides=sides)

    def to_clouds(T_nodes: Array) -> Array:
        return scale.reduced(a.T_cloud_node @ T_nodes @ invert(b.T_cloud_node))

    T_a_b = to_clouds(best.T_a_b)
    of_nodes: Array = np.asarray(np.linalg.inv(np.linalg.inv(best.information) + result.spread))
    # With C = T_b_middle, T_a_middle exp(xi) is T_a_b exp(Ad(C) xi) C.
    back = adjoint(invert(T_b_middle))
    information = back.T @ scale.reduced_information(of_nodes) @ back
    # The sigma of what is told does not hold that of open motions, which are named apart.
    told, R = best.open.covariance_without(of_nodes), T_a_b[:3, :3]
    open_along, open_rotation = best.open.unknown_axes(R)
    sigma_m = np.sqrt(np.diag(R @ told[:3, :3] @ R.T)) / scale.factor
    sigma_deg = float(np.degrees(np.sqrt(np.linalg.eigvalsh(told[3:, 3:])[-1])))
    return CloudRegistration(
        T_a_b,
        (information + information.T) / 2,
        T_b_middle,
        np.where(open_along, np.inf, sigma_m),
        float("inf") if open_rotation else sigma_deg,
        scale.reduced_evidence(best.evidence),
        result.reason,
        best.verdict.rests_on,
        scale,
        result.guesses,
        (best.residuals[0] / scale.factor, best.residuals[1] / scale.factor),
        sides,
        best.unexplained,
        0.0,
        best.open.named(a.T_cloud_node @ best.T_a_b, scale.factor),
        None if result.rival is None else (to_clouds(result.rival.T_a_b), result.rival.unexplained),
    )


def _nothing(reason: str, scale: SceneScale) -> CloudRegistration:
    """The result without any pose."""
    empty = np.zeros(0)
    return CloudRegistration(
        np.full((4, 4), np.nan), np.zeros((6, 6)), np.eye(4), np.full(3, np.inf), float("inf"),
        NOTHING_JUDGED, reason, "nothing", scale, 0, (empty, empty), (),
    )  # fmt: skip
