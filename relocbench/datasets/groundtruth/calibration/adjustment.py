"""The joint adjustment of poses and calibration: least squares on a pose graph whose edges depend on calibration.

Poses are eliminated, which leaves normal equations of the calibration alone (Schur complement). With these, any
assumption about what is in error is a matter of small matrices.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from relocbench.arrays import Array, Indices, Mask
from relocbench.datasets.groundtruth.pose_graph.edges import Edges, components
from relocbench.datasets.groundtruth.pose_graph.least_squares import Scales
from relocbench.geometry import adjoint, invert

_GAUGE_WEIGHT = 1e4
"""square root of the information of the pose that is fixed in each connected part"""
_LEAST_INFORMATION = 1e-4
"""information that is added to all directions of a measurement, to make it invertible"""
_RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class CalibrationEdges:
    """Edges by fits of lidars, which depend on the K unknowns of calibration."""

    edges: Edges
    by_calibration: Array
    """(E, 6, K) derivative of the residual ``log(T_measured^-1 T_first_second)``"""

    def __len__(self) -> int:
        return len(self.edges)

    def __getitem__(self, which: Mask) -> CalibrationEdges:
        """The edges that a mask selects."""
        return CalibrationEdges(self.edges[which], self.by_calibration[which])

    def downweighted(self, factor: float) -> CalibrationEdges:
        """The edges with their information divided by a factor."""
        return replace(self, edges=replace(self.edges, information=self.edges.information / factor))

    def chi2(self, T_world_node: Array, change: Array) -> Array:
        """(E,) squared residuals, by their information, at poses (N, 4, 4) and after a change (K,) of calibration."""
        left = self.edges.residuals(T_world_node) + self.by_calibration @ change
        return np.asarray(np.einsum("ei,eij,ej->e", left, self.edges.information, left))


@dataclass(frozen=True, eq=False)
class Reduced:
    """Normal equations of the calibration x: the data's cost is ``x A x / 2 - h x``, with all poses at their best."""

    A: Array
    """(K, K) information"""
    h: Array
    """(K,)"""

    def __add__(self, other: Reduced) -> Reduced:
        """Those of both data."""
        return Reduced(self.A + other.A, self.h + other.h)

    def about(self, origin: Array) -> Reduced:
        """The same for a calibration that is counted from elsewhere, where the present origin is ``origin`` (K,)."""
        return Reduced(self.A, self.h + self.A @ origin)

    def estimate(self, prior: Array) -> tuple[Array, Array]:
        """The estimate (K,) and its covariance (K, K), for a prior of mean 0 and covariance (K, K), maybe singular."""
        root = _root(prior)
        inside = np.linalg.inv(np.eye(root.shape[1]) + root.T @ self.A @ root)
        covariance = root @ inside @ root.T
        return covariance @ self.h, covariance

    def log_evidence(self, prior: Array) -> float:
        """Logarithm of the likelihood of the data, but for a constant, for a prior of mean 0 (MacKay, 1992)."""
        root = _root(prior)
        inside = np.eye(root.shape[1]) + root.T @ self.A @ root
        x = root.T @ self.h
        return float(0.5 * x @ np.linalg.solve(inside, x) - 0.5 * np.linalg.slogdet(inside)[1])


def _root(covariance: Array) -> Array:
    """(K, R) with ``root @ root.T = covariance``."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 1e-12 * max(float(values[-1]), 1e-300)
    return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))


class Adjustment:
    """The linear system of poses, scales of odometry and calibration, at given poses."""

    def __init__(self, T_world_node: Array, odometry: Edges, scales: Scales, measured: CalibrationEdges) -> None:
        """
        Args:
            T_world_node: (N, 4, 4).
            odometry: edges of the odometry, with unknown ``scales``.
            measured: edges by lidars.
        """
        from scipy.sparse import eye_array
        from scipy.sparse.linalg import splu

        self._poses = 6 * len(T_world_node)
        edges = Edges.join([odometry, measured.edges])
        roots = np.swapaxes(np.linalg.cholesky(edges.information + _LEAST_INFORMATION * np.eye(6)), 1, 2)
        of_odometry, of_lidars = roots[: len(odometry)], roots[len(odometry) :]
        rows = _Rows()
        at = rows.add(6 * len(edges))
        T = edges.relative_poses(T_world_node)
        rows.put(at[::6], 6 * edges.first, -roots @ adjoint(invert(T)))
        rows.put(at[::6], 6 * edges.second, roots)
        t = odometry.T_first_second
        by_scale = np.zeros((len(odometry), 6, 1))
        by_scale[:, :3, 0] = -np.einsum("eji,ej->ei", t[:, :3, :3], t[:, :3, 3])
        rows.put(at[::6][: len(odometry)], self._poses + scales.number[: len(odometry)], of_odometry @ by_scale)
        _put_scales(rows, scales, self._poses)
        for node in np.unique(components(len(T_world_node), edges.first, edges.second)).tolist():
            rows.put(rows.add(6)[:1], np.array([6 * node]), _GAUGE_WEIGHT * np.eye(6)[None])
        highest = max(int(n.max(initial=-1)) for n in (scales.number, scales.begins, scales.neighbours))
        J = rows.matrix(self._poses + highest + 1)
        by_calibration = np.zeros((rows.count, measured.by_calibration.shape[2]))
        lidar_rows = slice(6 * len(odometry), 6 * len(edges))
        by_calibration[lidar_rows] = (of_lidars @ measured.by_calibration).reshape(-1, by_calibration.shape[1])
        residuals = np.zeros(rows.count)
        residuals[: 6 * len(edges)] = np.einsum("eij,ej->ei", roots, edges.residuals(T_world_node)).ravel()
        solver = splu((J.T @ J + _RIDGE * eye_array(J.shape[1], format="csc")).tocsc())
        mixed = np.ascontiguousarray(J.T @ by_calibration)
        self._by_calibration = -solver.solve(mixed)
        self._step = -solver.solve(J.T @ residuals)
        A = by_calibration.T @ by_calibration + mixed.T @ self._by_calibration
        h = -(by_calibration.T @ residuals + mixed.T @ self._step)
        self.reduced = Reduced((A + A.T) / 2, h)

    def step(self, change: Array) -> Array:
        """(N, 6) twists of the poses, ``T_world_node @ se3_exp(twist)``, for a change (K,) of the calibration."""
        return np.asarray((self._step + self._by_calibration @ change)[: self._poses].reshape(-1, 6))

    @property
    def by_calibration(self) -> Array:
        """(N, 6, K) derivative of the poses' twists by the calibration."""
        return np.asarray(self._by_calibration[: self._poses].reshape(-1, 6, self._by_calibration.shape[1]))


def _put_scales(rows: _Rows, scales: Scales, columns: int) -> None:
    """Put the priors of the scales, whose columns follow the given number of others."""
    one = np.ones((1, 1, 1))
    for begin in scales.begins.tolist():
        rows.put(rows.add(1), np.array([columns + begin]), one / scales.sigma)
    for a, b in scales.neighbours.tolist():
        row = rows.add(1)
        rows.put(row, np.array([columns + a]), -one / scales.neighbour_sigma)
        rows.put(row, np.array([columns + b]), one / scales.neighbour_sigma)


class _Rows:
    """The rows of a sparse matrix, put together from small dense blocks."""

    def __init__(self) -> None:
        self.count = 0
        self._parts: list[tuple[Array, Indices, Indices]] = []

    def add(self, count: int) -> Indices:
        """Numbers (count,) of new rows."""
        self.count += count
        return np.arange(self.count - count, self.count)

    def put(self, first_row: Indices, first_column: Indices, blocks: Array) -> None:
        """Put M blocks (M, R, C) at their first rows (M,) and columns (M,)."""
        i, j = np.meshgrid(np.arange(blocks.shape[1]), np.arange(blocks.shape[2]), indexing="ij")
        rows = (first_row[:, None, None] + i).ravel()
        self._parts.append((blocks.ravel(), rows, (first_column[:, None, None] + j).ravel()))

    def matrix(self, columns: int) -> Any:
        """The matrix in compressed columns."""
        from scipy.sparse import coo_array

        values, row, column = (np.concatenate(arrays) for arrays in zip(*self._parts, strict=True))
        return coo_array((values, (row, column)), shape=(self.count, columns)).tocsc()
