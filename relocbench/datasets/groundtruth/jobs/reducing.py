"""What drives in enlarged metres say, in metres: outcomes of pairs, and words with lengths in them.

With metres enlarged by s, a translation and its standard deviation are s times as large, and rotations stay. This is
exact, so that a scene's truth does not depend on how it was enlarged but for the reaches of the methods.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.pairs.outcome import PairOutcome
from relocbench.datasets.groundtruth.pairs.pairing import Paired
from relocbench.datasets.groundtruth.pairs.reasons import reduced_words
from relocbench.datasets.groundtruth.registration.scene_scale import scaled
from relocbench.progress import Advance, Reporter


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
