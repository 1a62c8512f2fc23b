"""Which causes are in error: the smallest set that explains the measurements, and the calibration that follows.

An error that is too small to be certain is not corrected, but part of the covariance: it is the mean over what may be
in error, and over how good the rest is, each with its probability (Hoeting et al., Bayesian model averaging, 1999).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.groundtruth.calibration.adjustment import Reduced
from relocbench.datasets.groundtruth.calibration.unknowns import (
    OBSERVED,
    SIZE,
    Cause,
    Sensors,
    Sigmas,
    unknowns_reduced,
)

_LEAST_GAIN = {"extrinsics": 12.0, "time": 5.0}
"""a cause is in error if it makes the measurements more likely by a factor of exp(this). What surfaces have in common
may look like extrinsics that are off, of which there are six; a clock is late on all surfaces alike"""
_RARE, _SLIGHTLY = -3.0, -2.0
"""logarithm of the odds of a cause before anything is measured, and of a clock that is off by little"""
_CLOSELY = 2 / 3
"""a clock that is off by little has to be observed to this share, 10 ms"""
_BETTER = tuple(Sigmas(mount, mount, clock) for mount, clock in product((1.0, 0.5, 0.25), repeat=2))
"""factors of how good a calibration is that is not in error: where the lidars agree with each other to a millimetre, an
error that they have in common, which only drives in opposite directions show, is of millimetres too"""


@dataclass(frozen=True, eq=False)
class Calibration:
    """The calibration of lidars: what is in error, by how much, and how certainly."""

    sensors: Sensors
    causes: tuple[Cause, ...]
    """what is in error; empty if all agrees with the calibration as it is given"""
    errors: Array
    """(K,) estimated errors, which are the unknowns of :mod:`.unknowns`"""
    covariance: Array
    """(K, K), with the causes that may be in error and are not certain enough"""

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
        surplus = {c: evidence - best - _LEAST_GAIN[c.kind] for c, evidence in likely.items()}
        cause = max(surplus, key=lambda c: (surplus[c], c), default=None)
        if cause is None or surplus[cause] < 0:
            return tuple(causes)
        causes.append(cause)
        best = likely[cause]


def calibrate(reduced: Reduced, sensors: Sensors) -> Calibration:
    """The calibration by the normal equations of all drives, whose origin is the calibration as it is given."""
    causes = find_causes(reduced, sensors)
    evidence = np.array([reduced.log_evidence(sensors.prior(causes, better=better)) for better in _BETTER])
    likely = np.exp(evidence - evidence.max())
    errors, covariance = _mean(reduced, [sensors.prior(causes, better=better) for better in _BETTER], likely)
    most = int(np.argmax(likely))
    total, weights = covariance, 1.0
    for cause in set(sensors.causes()) - set(causes):
        for prior, rare, share in _priors_with(cause, causes, sensors, _BETTER[most]):
            others, spread = reduced.estimate(prior)
            if _is_observed(cause, sensors, spread, share):
                weight = float(np.exp(reduced.log_evidence(prior) - evidence[most] + rare))
                total = total + weight * (spread + np.outer(others - errors, others - errors))
                weights += weight
    return Calibration(sensors, causes, errors, total / weights)


def _mean(reduced: Reduced, priors: Sequence[Array], weights: Array) -> tuple[Array, Array]:
    """The mean (K,) and the covariance (K, K) of estimates with several priors, of which each has a weight."""
    estimates = [reduced.estimate(prior) for prior in priors]
    shares = weights / weights.sum()
    errors = np.einsum("i,ik->k", shares, [e for e, _ in estimates])
    moments = [covariance + np.outer(e - errors, e - errors) for e, covariance in estimates]
    return errors, np.asarray(np.einsum("i,ikl->kl", shares, moments))


def _priors_with(
    cause: Cause, causes: tuple[Cause, ...], sensors: Sensors, better: Sigmas
) -> Iterator[tuple[Array, float, float]]:
    """Priors (K, K) with one more cause, the logarithms of their odds, and the share of what counts as observed up to
    which they take part."""
    yield sensors.prior([*causes, cause], better=better), _RARE, 1.0
    if cause.kind == "time":
        yield sensors.prior(causes, slight=cause, better=better), _SLIGHTLY, _CLOSELY


def _is_observed(cause: Cause, sensors: Sensors, covariance: Array, share: float) -> bool:
    """Whether the measurements tell the unknowns of a cause, whose covariance is part of (K, K), to a share of
    :data:`.unknowns.OBSERVED`. What they do not show is taken as it is given."""
    unknowns = sensors.spread(cause).any(axis=1).reshape(-1, SIZE)
    sigmas = np.where(unknowns, np.sqrt(np.maximum(np.diagonal(covariance), 0.0)).reshape(-1, SIZE), 0.0)
    sigmas *= unknowns_reduced(len(sensors), sensors.enlarged).reshape(-1, SIZE)
    return all(float(sigmas[:, which].max()) <= share * most for which, most in OBSERVED.values())
