"""Recordings in enlarged metres, in which a small scene has the size of a street, and what comes of them, in metres.

Enlarged are the points, the lidars' poses on the rig, the odometry and the prior. Cameras are left out: images are
asked of the recording as it is, and their poses on the rig are enlarged where they meet the drives. Reduced are the
outcomes of pairs, and words with lengths in them.

With metres enlarged by s, a translation and its standard deviation are s times as large, and rotations stay. This is
exact, so that a scene's truth does not depend on how it was enlarged but for the reaches of the methods. See
:mod:`relocbench.datasets.groundtruth.registration.scene_scale`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.odometry.deferred import Pending
from relocbench.datasets.groundtruth.pairs.outcome import PairOutcome
from relocbench.datasets.groundtruth.pairs.pairing import Paired
from relocbench.datasets.groundtruth.pairs.reasons import reduced_words
from relocbench.datasets.groundtruth.registration.scene_scale import scaled
from relocbench.datasets.sensors.derived_lidar import DerivedLidar
from relocbench.datasets.sensors.recording import FieldRecording, Scan, Trajectory
from relocbench.progress import Advance, Reporter

PriorOf = Callable[[Trajectory], Trajectory | None]


@dataclass(frozen=True, eq=False)
class EnlargedLidar(DerivedLidar):
    """A lidar whose metres are enlarged."""

    factor: float

    @property
    def T_rig_lidar(self) -> Array:
        return scaled(self.stream.T_rig_lidar, self.factor)

    @property
    def max_range_m(self) -> float:
        return self.stream.max_range_m * self.factor

    @property
    def sigma_m(self) -> float:
        return self.stream.sigma_m * self.factor

    def read(self, index: int) -> Scan:
        scan = self.stream.read(index)
        return Scan(scan.points * self.factor, scan.times_ns)


def enlarged(recording: FieldRecording, factor: float) -> FieldRecording:
    """The recording in enlarged metres, without cameras; itself if the factor is 1."""
    if factor == 1.0:
        return recording
    odometry = scaled_trajectory(recording.odometry, factor)
    if isinstance(odometry, Pending) and odometry.prior_of is not None:
        odometry = replace(odometry, prior_of=_of_enlarged(odometry.prior_of, factor))
    return replace(
        recording,
        odometry=odometry,
        lidars=tuple(EnlargedLidar(lidar, factor) for lidar in recording.lidars),
        cameras={},
        prior=None if recording.prior is None else scaled_trajectory(recording.prior, factor),
        prior_sigma_m=recording.prior_sigma_m * factor,
    )


def in_metres(recording: FieldRecording, large: FieldRecording, factor: float) -> FieldRecording:
    """The recording with odometry and prior of the same one in enlarged metres, which were computed from its scans."""
    if factor == 1.0:
        return large
    prior = None if large.prior is None else scaled_trajectory(large.prior, 1 / factor)
    return replace(recording, odometry=scaled_trajectory(large.odometry, 1 / factor), prior=prior)


def _of_enlarged(prior_of: PriorOf, factor: float) -> PriorOf:
    """The enlarged prior that is fitted to enlarged odometry."""

    def fitted(motion: Trajectory) -> Trajectory | None:
        prior = prior_of(scaled_trajectory(motion, 1 / factor))
        return None if prior is None else scaled_trajectory(prior, factor)

    return fitted


def scaled_trajectory(trajectory: Trajectory, factor: float) -> Trajectory:
    """A trajectory whose positions are multiplied by a factor; it stays of its class."""
    return replace(trajectory, T_odom_rig=scaled(trajectory.T_odom_rig, factor))


def reduced_paired(paired: Paired, factor: float) -> Paired:
    """The pairs of a query drive in metres; the solved drives stay enlarged, as their blocks on disk are."""
    if factor == 1.0:
        return paired
    outcomes = {camera: [reduced_outcome(o, factor) for o in some] for camera, some in paired.outcomes.items()}
    return replace(paired, outcomes=outcomes)


def reduced_outcome(outcome: PairOutcome, factor: float) -> PairOutcome:
    """The outcome of a pair of enlarged drives, in metres."""

    def length(sigma: float | None) -> float | None:
        return None if sigma is None else sigma / factor

    return replace(
        outcome,
        T_query_ref=None if outcome.T_query_ref is None else scaled(outcome.T_query_ref, 1 / factor),
        covariance=None if outcome.covariance is None else reduced_covariance(outcome.covariance, factor),
        sigma_along_m=length(outcome.sigma_along_m),
        sigma_across_m=length(outcome.sigma_across_m),
        sigma_height_m=length(outcome.sigma_height_m),
        reason=reduced_words(outcome.reason, factor),
    )


def reduced_covariance(covariance: Array, factor: float) -> Array:
    """Covariance (6, 6) of ``xi = (rho, phi)`` of an enlarged pose, in metres."""
    D = np.repeat([1 / factor, 1.0], 3)
    return np.asarray(D[:, None] * covariance * D)


class ReducedReporter:
    """Tells another reporter, with the lengths in notes reduced."""

    def __init__(self, reporter: Reporter, factor: float) -> None:
        self._reporter, self._factor = reporter, factor

    def stage(self, description: str, total: int) -> AbstractContextManager[Advance]:
        """See :class:`relocbench.progress.Reporter`."""
        return self._reporter.stage(description, total)

    def note(self, message: str) -> None:
        """See :class:`relocbench.progress.Reporter`."""
        self._reporter.note(reduced_words(message, self._factor))
