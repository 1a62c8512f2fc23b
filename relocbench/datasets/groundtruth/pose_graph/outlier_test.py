"""Outlier test of each edge against the rest of the graph: Baarda's test of residuals, for twists.

An edge draws the solution towards itself, which makes its residual small. The covariance of the residual is ``R - P``,
with ``R`` of the measurement and ``P`` of the solution along the edge; relative to this, a wrong edge has a large
residual whatever its weight. Baarda, A testing procedure for use in geodetic networks, 1968.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Indices, Mask

_LEAST_CHECKED = 0.02
"""redundancy number below which a direction counts as not confirmed by other edges"""


@dataclass(frozen=True, eq=False)
class OutlierTest:
    """The test of E edges against all others, each along six independent directions."""

    squares: Array
    """(E, 6) squared residuals in units of the measurement's variances"""
    redundancy_numbers: Array
    """(E, 6) expected values of the squares: from 0 to 1 for edges of the graph, above 1 for edges left out"""

    @property
    def checked(self) -> Mask:
        """(E, 6) whether other edges confirm each direction"""
        return self.redundancy_numbers > _LEAST_CHECKED

    @property
    def freedom(self) -> Indices:
        """(E,) number of directions that other edges confirm"""
        return np.asarray(self.checked.sum(axis=1))

    @property
    def chi2(self) -> Array:
        """(E,) test statistic with ``freedom`` degrees of freedom"""
        squares = self.squares / np.maximum(self.redundancy_numbers, _LEAST_CHECKED)
        return np.asarray(np.where(self.checked, squares, 0.0).sum(axis=1))

    @property
    def redundancy(self) -> Array:
        """(E,) total redundancy in [0, 6]: how much of the edge is known from the others"""
        return np.asarray(np.clip(self.redundancy_numbers, 0.0, 1.0).sum(axis=1))

    @property
    def p_value(self) -> Array:
        """(E,) probability that a right edge has at least this chi2; 1 if no direction is confirmed"""
        from scipy.special import chdtrc

        return np.where(self.freedom > 0, chdtrc(np.maximum(self.freedom, 1), self.chi2), 1.0)


def check_used(residuals: Array, information: Array, posterior: Array) -> OutlierTest:
    """Test edges that are part of the graph: their residuals have the covariance ``R - P``.

    Args:
        residuals: (E, 6) in the solution.
        information: (E, 6, 6) of the measurements, the inverse of ``R``.
        posterior: (E, 6, 6) covariances ``P`` of the solution along the edges.
    """
    return _test(residuals, information, -posterior)


def check_left_out(residuals: Array, information: Array, posterior: Array) -> OutlierTest:
    """Test edges that are not part of the graph: their residuals have the covariance ``R + P``."""
    return _test(residuals, information, posterior)


def _test(residuals: Array, information: Array, posterior: Array) -> OutlierTest:
    root = _root(information)
    transposed = np.swapaxes(root, 1, 2)
    u = np.einsum("eij,ej->ei", transposed, residuals)
    redundancy_numbers, basis = np.linalg.eigh(np.eye(6) + transposed @ posterior @ root)
    return OutlierTest(np.einsum("eji,ej->ei", basis, u) ** 2, redundancy_numbers)


def _root(information: Array) -> Array:
    """(E, 6, 6) matrices A with ``A @ A.T = information``, which may be singular."""
    values, vectors = np.linalg.eigh(information)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])
