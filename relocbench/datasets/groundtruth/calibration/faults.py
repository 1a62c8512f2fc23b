"""Which causes are in error: the smallest set that explains the measurements, and the calibration that follows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.groundtruth.calibration.adjustment import Reduced
from relocbench.datasets.groundtruth.calibration.unknowns import SIZE, Cause, Sensors, unknowns_reduced

_LEAST_GAIN = 12.0
"""a cause is in error if it makes the measurements more likely by a factor of exp(this)"""


@dataclass(frozen=True, eq=False)
class Calibration:
    """The calibration of lidars: what is in error, by how much, and how certainly."""

    sensors: Sensors
    causes: tuple[Cause, ...]
    """what is in error; empty if all agrees with the calibration as it is given"""
    errors: Array
    """(K,) estimated errors, which are the unknowns of :mod:`.unknowns`"""
    covariance: Array
    """(K, K)"""

    @property
    def in_error(self) -> Mask:
        """(K,) the unknowns of the causes that are in error."""
        out = np.zeros(len(self.errors), dtype=np.bool_)
        for cause in self.causes:
            out |= self.sensors.spread(cause).any(axis=1)
        return out

    @property
    def correction(self) -> Array:
        """(K,) what is to be corrected: the errors of what is in error.

        All else has estimates too, within what it should be good to. Lidars that are corrected by these are measured
        anew, and the next estimates are added to them: the rotation of both lidars, which the drives' poses follow,
        grew from round to round.
        """
        return np.where(self.in_error, self.errors, 0.0)

    def uncorrected(self, corrected: Array) -> Array:
        """(K, K) second moment of the errors that are left after some (K,) were corrected: uncertainty and rest."""
        rest = self.errors - corrected
        return self.covariance + np.outer(rest, rest)

    def reduced(self) -> Calibration:
        """The same in metres, if the drives' metres are enlarged."""
        D = unknowns_reduced(len(self.sensors), self.sensors.enlarged)
        return replace(self, errors=D * self.errors, covariance=D[:, None] * self.covariance * D)

    @property
    def sigmas(self) -> Array:
        """(S, 7) standard deviations: position (3, metres), rotation (3, radians) and time (seconds) of each lidar."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0)).reshape(-1, SIZE)


def find_causes(reduced: Reduced, sensors: Sensors) -> tuple[Cause, ...]:
    """The causes that must be in error to explain the measurements, the most important first."""
    causes: list[Cause] = []
    best = reduced.log_evidence(sensors.prior())
    while True:
        likely = {c: reduced.log_evidence(sensors.prior([*causes, c])) for c in sensors.causes() if c not in causes}
        cause = max(likely, key=lambda c: (likely[c], c), default=None)
        if cause is None or likely[cause] < best + _LEAST_GAIN:
            return tuple(causes)
        causes.append(cause)
        best = likely[cause]


def calibrate(reduced: Reduced, sensors: Sensors) -> Calibration:
    """The calibration by the normal equations of all drives, whose origin is the calibration as it is given."""
    causes = find_causes(reduced, sensors)
    errors, covariance = reduced.estimate(sensors.prior(causes))
    return Calibration(sensors, causes, errors, covariance)
