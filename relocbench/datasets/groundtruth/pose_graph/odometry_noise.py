"""How far odometry may be wrong from one node to the next, as a function of the way driven; and from data.

Errors wander: variances grow in proportion to the way, so that cutting a drive into more nodes changes nothing. Real
odometry errs by a scale that persists, which is a wandering of the same size only over the distance between trusted
registrations. :func:`estimate` therefore measures it on the graph at hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relocbench.errors import ConfigError

Array = NDArray[np.float64]

AXES = ("along", "across", "height", "roll", "pitch", "yaw")
_LEAST_REDUNDANCY = 30.0
"""with fewer surplus measurements a variance is not estimated"""
_NARROWEST = 0.05
"""a standard deviation is never estimated to less than this part of what was assumed"""
_GAUSSIAN = 3.841
"""95 % of a squared normal variable lies below; what is above counts as this much"""
_WINSORISED_MEAN = 0.913
"""mean of a squared normal variable that is cut off there"""


@dataclass(frozen=True)
class OdometryNoise:
    """Standard deviations after one metre; after ``d`` metres they are ``sqrt(d)`` times as large."""

    along_m: float = 0.02
    across_m: float = 0.004
    height_m: float = 0.004
    roll_rad: float = 4e-4
    pitch_rad: float = 4e-4
    yaw_rad: float = 6e-4
    least_arc_length_m: float = 0.1
    """nothing is more certain than after so much, standing still included"""

    def __post_init__(self) -> None:
        if not all(np.isfinite(v) and v > 0 for v in (*self.sigma, self.least_arc_length_m)):
            raise ConfigError("noise of odometry must be positive on every axis")

    @property
    def sigma(self) -> Array:
        """(6,) after one metre, in the order of :data:`AXES`: that of a twist ``(rho, phi)``, x forward, z up."""
        return np.array([self.along_m, self.across_m, self.height_m, self.roll_rad, self.pitch_rad, self.yaw_rad])

    def variance(self, arc_length_m: Array) -> Array:
        """(..., 6) after ways (...,) in metres."""
        arc_length = np.maximum(np.asarray(arc_length_m, dtype=np.float64), self.least_arc_length_m)
        return arc_length[..., None] * self.sigma**2

    def information(self, arc_length_m: Array) -> Array:
        """(..., 6, 6)"""
        return np.asarray((1.0 / self.variance(arc_length_m))[..., None] * np.eye(6))

    def scaled(self, factors: Array) -> OdometryNoise:
        """With each standard deviation times a factor (6,)."""
        along, across, height, roll, pitch, yaw = (self.sigma * factors).tolist()
        return OdometryNoise(along, across, height, roll, pitch, yaw, self.least_arc_length_m)

    def at_least(self, other: OdometryNoise) -> OdometryNoise:
        """The larger of both on each axis."""
        return self.scaled(np.maximum(1.0, other.sigma / self.sigma))


def variance_factor(squares: Array, redundancy: Array) -> float | None:
    """By what a variance has to be multiplied so that residuals are as large as expected.

    ``sum(v^2 / sigma^2) / sum(redundancy)``: Foerstner's estimate of a variance component (A method for estimating
    weights, 1979). A residual that is far too large for its own redundancy is cut off, since some edges are wrong.

    Args:
        squares: (E,) squared residuals over the assumed variances.
        redundancy: (E,) share in [0, 1] of each residual's variance that other measurements check.

    Returns:
        None where too little is redundant.
    """
    checked = redundancy > 1e-3
    squares, redundancy = squares[checked], redundancy[checked]
    if redundancy.sum() < _LEAST_REDUNDANCY:
        return None
    normalised = squares / redundancy
    factor = float(np.median(normalised) / 0.4549)  # median of a squared normal variable
    for _ in range(20):
        factor = max(factor, 1e-12)
        kept = np.minimum(normalised / factor, _GAUSSIAN)
        factor *= float((redundancy * kept).sum() / redundancy.sum()) / _WINSORISED_MEAN
    return max(factor, _NARROWEST**2)


def estimate(noise: OdometryNoise, arc_length_m: Array, residuals: Array, posterior: Array) -> OdometryNoise:
    """The noise that the residuals of a solved graph speak for.

    Reference and query drive the same road side by side: only the sum of their errors shows, so they share one noise.

    Args:
        noise: what the graph was solved with.
        way_m: (E,) of each odometry edge.
        residuals: (E, 6) of these edges in the solution.
        posterior: (E, 6) variances of the solution along each edge's axes.

    Returns:
        The noise; axes on which too little is redundant are as before.
    """
    prior = noise.variance(arc_length_m)
    squares, redundancy = residuals**2 / prior, np.clip(1.0 - posterior / prior, 0.0, 1.0)
    factors = [variance_factor(squares[:, i], redundancy[:, i]) for i in range(6)]
    return noise.scaled(np.sqrt([1.0 if f is None else f for f in factors]))
