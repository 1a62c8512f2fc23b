"""The registration of two clouds: scale, search, verification and covariance, in the clouds' own frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.clouds.cloud import Cloud
from relocbench.datasets.groundtruth.clouds.judging import free_space_known
from relocbench.datasets.groundtruth.clouds.preparing import Preparation, PreparedCloud, prepare
from relocbench.datasets.groundtruth.clouds.search import CloudSearchResult, SearchOptions, search, steps
from relocbench.datasets.groundtruth.icp.backends import Backend
from relocbench.datasets.groundtruth.registration.global_registration import GlobalOptions, Matcher
from relocbench.datasets.groundtruth.registration.scene_scale import SceneScale, scale_of, scene_size
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
    """(3,) standard deviations of the middle's position along the axes of A"""
    sigma_deg: float
    """standard deviation of the rotation about its least certain axis"""
    evidence: Evidence
    reason: str
    """why the pose is not trusted; empty if it is"""
    rests_on: str
    """the kinds of evidence, in words"""
    scale: SceneScale
    guesses: int
    residuals_m: tuple[Array, Array]
    """distances of B's points from A's surfaces, and of A's from B's"""
    sides: tuple[Preparation, Preparation]
    unexplained: float = float("nan")
    """what speaks against the pose, see :func:`relocbench.datasets.groundtruth.clouds.search.unexplained`"""
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
    o = options or CloudRegistrationOptions()
    sizes = []
    for cloud in (a, b):
        try:
            sizes.append(scene_size(cloud.points))
        except DatasetError as bad:
            raise DatasetError(f"cloud {cloud.name} {bad}") from None
    scale = scale_of(sizes, o.factor)
    searched = SearchOptions(
        matching=GlobalOptions(matcher=o.matcher, seeds=tuple(range(3 * o.seed, 3 * o.seed + 3))),
        backend=o.icp,
        drifts=a.drifts or b.drifts,
    )
    with (reporter or Silent()).stage("registering", 2 + steps(searched)) as advance:
        sides = []
        for cloud in (a, b):
            sides.append(prepare(cloud, scale))
            advance(1)
        one, other = (side.prepared for side in sides)
        if not (one.sees and other.sees):
            one, other = one.judged_by_points(), other.judged_by_points()
        if o.initial is not None:
            initial = invert(one.T_cloud_node) @ scale.enlarged(o.initial) @ other.T_cloud_node
            searched = SearchOptions(searched.matching, searched.backend, initial, searched.drifts)
        result = search(one, other, scale, free_space_known(one.sees, other.sees), searched, advance)
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
        nothing = np.zeros(0)
        return CloudRegistration(
            np.full((4, 4), np.nan), np.zeros((6, 6)), T_b_middle, np.full(3, np.inf), float("inf"),
            NOTHING_JUDGED, result.reason, "nothing", scale, result.guesses, (nothing, nothing), sides,
        )  # fmt: skip

    def to_clouds(T_nodes: Array) -> Array:
        return scale.reduced(a.T_cloud_node @ T_nodes @ invert(b.T_cloud_node))

    T_a_b = to_clouds(best.T_a_b)
    at_middle = scale.reduced_information(best.information)
    # With C = T_b_middle, T_a_middle exp(xi) is T_a_b exp(Ad(C) xi) C.
    back = adjoint(invert(T_b_middle))
    information = back.T @ at_middle @ back
    covariance = np.linalg.inv(at_middle)
    R = T_a_b[:3, :3]
    position, rotation = R @ covariance[:3, :3] @ R.T, covariance[3:, 3:]
    residuals = (np.zeros(0), np.zeros(0)) if best.fit is None else best.fit.residuals
    return CloudRegistration(
        T_a_b,
        (information + information.T) / 2,
        T_b_middle,
        np.sqrt(np.diag(position)),
        float(np.degrees(np.sqrt(np.linalg.eigvalsh(rotation)[-1]))),
        scale.reduced_evidence(best.evidence),
        result.reason,
        best.verdict.rests_on,
        scale,
        result.guesses,
        (residuals[0] / scale.factor, residuals[1] / scale.factor),
        sides,
        best.unexplained,
        None if result.rival is None else (to_clouds(result.rival.T_a_b), result.rival.unexplained),
    )
