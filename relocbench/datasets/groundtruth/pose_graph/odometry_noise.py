"""The noise of odometry as a function of arc length, and its estimation from a solved graph.

Errors are a random walk: variances grow in proportion to arc length, so that cutting a drive into more nodes changes
nothing. A scale error, which real odometry has, is not a random walk; it looks like one only over the distance between
trusted registrations. The noise is therefore estimated on the graph at hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.errors import ConfigError

_LEAST_REDUNDANCY = 30.0
"""least total redundancy with which a variance is estimated"""
_NARROWEST = 0.05
"""least ratio of an estimated standard deviation to the assumed one"""
_GAUSSIAN = 3.841
"""95 % quantile of a squared standard normal variable; larger squares are cut off here"""
_WINSORISED_MEAN = 0.913
"""mean of a squared standard normal variable that is cut off there"""


@dataclass(frozen=True)
class OdometryNoise:
    """Standard deviations of odometry after one metre; after ``d`` metres they are ``sqrt(d)`` times as large."""

    along_m: float = 0.02
    across_m: float = 0.004
    height_m: float = 0.004
    roll_rad: float = 4e-4
    pitch_rad: float = 4e-4
    yaw_rad: float = 6e-4
    least_arc_length_m: float = 0.1
    """arc length that is assumed at least, so that variances are positive while the car stands"""

    def __post_init__(self) -> None:
        if not all(np.isfinite(v) and v > 0 for v in (*self.sigma, self.least_arc_length_m)):
            raise ConfigError("noise of odometry must be positive on every axis")

    @property
    def sigma(self) -> Array:
        """(6,) standard deviations of the twist ``(rho, phi)`` after one metre: x forward, y to the left, z up."""
        return np.array([self.along_m, self.across_m, self.height_m, self.roll_rad, self.pitch_rad, self.yaw_rad])

    def variance(self, arc_length_m: Array) -> Array:
        """(..., 6) variances after arc lengths (...,) in metres."""
        arc_length = np.maximum(np.asarray(arc_length_m, dtype=np.float64), self.least_arc_length_m)
        return arc_length[..., None] * self.sigma**2

    def information(self, arc_length_m: Array) -> Array:
        """(..., 6, 6) information matrices after arc lengths (...,) in metres."""
        return np.asarray((1.0 / self.variance(arc_length_m))[..., None] * np.eye(6))

    def scaled(self, factors: Array) -> OdometryNoise:
        """The noise with each standard deviation multiplied by a factor (6,)."""
        along, across, height, roll, pitch, yaw = (self.sigma * factors).tolist()
        return OdometryNoise(along, across, height, roll, pitch, yaw, self.least_arc_length_m)

    def at_least(self, other: OdometryNoise) -> OdometryNoise:
        """The noise with the larger of both standard deviations on each axis."""
        return self.scaled(np.maximum(1.0, other.sigma / self.sigma))


def variance_factor(squares: Array, redundancy: Array) -> float | None:
    """The factor by which an assumed variance must be multiplied to agree with the residuals.

    ``sum(v^2 / sigma^2) / sum(redundancy)``: Foerstner's estimate of a variance component (A method for estimating
    weights, 1979). Residuals that are far too large for their redundancy are cut off, since some edges are wrong.

    Args:
        squares: (E,) squared residuals over the assumed variances.
        redundancy: (E,) redundancy numbers in [0, 1]: the share of each measurement that others confirm.

    Returns:
        the factor, or None if the total redundancy is too small.
    """
    checked = redundancy > 1e-3
    squares, redundancy = squares[checked], redundancy[checked]
    if redundancy.sum() < _LEAST_REDUNDANCY:
        return None
    normalised = squares / redundancy
    factor = float(np.median(normalised) / 0.4549)  # median of a squared standard normal variable
    for _ in range(20):
        factor = max(factor, 1e-12)
        kept = np.minimum(normalised / factor, _GAUSSIAN)
        factor *= float((redundancy * kept).sum() / redundancy.sum()) / _WINSORISED_MEAN
    return max(factor, _NARROWEST**2)


def estimate(noise: OdometryNoise, arc_length_m: Array, residuals: Array, posterior: Array) -> OdometryNoise:
    """The noise of odometry by the residuals of a solved graph.

    Both drives have the same noise, since registrations only show the sum of their errors.

    Args:
        noise: the noise that the graph was solved with.
        arc_length_m: (E,) length of each odometry edge.
        residuals: (E, 6) of these edges in the solution.
        posterior: (E, 6) variances of the solution along each edge.

    Returns:
        the noise; axes with too little redundancy keep theirs.
    """
    prior = noise.variance(arc_length_m)
    squares, redundancy = residuals**2 / prior, np.clip(1.0 - posterior / prior, 0.0, 1.0)
    factors = [variance_factor(squares[:, i], redundancy[:, i]) for i in range(6)]
    return noise.scaled(np.sqrt([1.0 if f is None else f for f in factors]))
