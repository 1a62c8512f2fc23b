"""What the rest of the graph says of each edge: Baarda's test of residuals (A testing procedure for use in geodetic
networks, 1968), for twists.

An edge draws the solution towards itself, so that its residual looks small. The residual's covariance is ``R - P``,
``R`` of the measurement and ``P`` of the solution along the edge; in its units a wrong edge shows whatever its weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LEAST_CHECKED = 0.02
"""share of a residual's variance below which others say nothing of it"""


@dataclass(frozen=True, eq=False)
class OutlierTest:
    """E edges against all others, each along six independent directions of its own."""

    squares: Array
    """(E, 6) squared residuals in units of the measurement's variances"""
    redundancy_numbers: Array
    """(E, 6) their expected values: the share of each that others check, from 0 to 1; above 1 for edges left out"""

    @property
    def checked(self) -> NDArray[np.bool_]:
        """(E, 6) directions of which others say anything"""
        return self.redundancy_numbers > _LEAST_CHECKED

    @property
    def freedom(self) -> NDArray[np.int64]:
        """(E,) number of these"""
        return np.asarray(self.checked.sum(axis=1))

    @property
    def chi2(self) -> Array:
        """(E,) of the residual with its own covariance, ``freedom`` degrees of freedom"""
        return np.where(self.checked, self.squares / np.maximum(self.redundancy_numbers, _LEAST_CHECKED), 0.0).sum(
            axis=1
        )

    @property
    def redundancy(self) -> Array:
        """(E,) in [0, 6]: how much of the edge would be known without it"""
        return np.clip(self.redundancy_numbers, 0.0, 1.0).sum(axis=1)

    @property
    def p_value(self) -> Array:
        """(E,) probability that a right edge is at least as far off; 1 where nothing checks it"""
        from scipy.special import chdtrc

        return np.where(self.freedom > 0, chdtrc(np.maximum(self.freedom, 1), self.chi2), 1.0)


def check_used(residuals: Array, information: Array, posterior: Array) -> OutlierTest:
    """Test edges that took part in the solution: ``R - P``.

    Args:
        residuals: (E, 6) in the solution.
        information: (E, 6, 6) of the measurements, the inverse of ``R``.
        posterior: (E, 6, 6) covariances of the solution along the edges, ``P``.
    """
    return _test(residuals, information, -posterior)


def check_left_out(residuals: Array, information: Array, posterior: Array) -> OutlierTest:
    """Test edges that did not take part: their residuals have the covariance ``R + P``."""
    return _test(residuals, information, posterior)


def _test(residuals: Array, information: Array, posterior: Array) -> OutlierTest:
    root = _root(information)
    transposed = np.swapaxes(root, 1, 2)
    u = np.einsum("eij,ej->ei", transposed, residuals)
    redundancy_numbers, basis = np.linalg.eigh(np.eye(6) + transposed @ posterior @ root)
    return OutlierTest(np.einsum("eji,ej->ei", basis, u) ** 2, redundancy_numbers)


def _root(information: Array) -> Array:
    """(E, 6, 6) A with ``A @ A.T = information``, also where that is singular."""
    values, vectors = np.linalg.eigh(information)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])
