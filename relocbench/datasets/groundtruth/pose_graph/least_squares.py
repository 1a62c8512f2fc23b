"""Least squares on a pose graph: poses and covariances by gtsam, with arrays in and out.

A twist is (rotation, translation) in gtsam, but ``(rho, phi)``, translation first, everywhere outside this module.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from relocbench.arrays import Array, Indices, Mask
from relocbench.datasets.groundtruth.pose_graph.edges import Edges, components
from relocbench.geometry import adjoint, invert, project_to_rotation

_SWAP = [3, 4, 5, 0, 1, 2]
_GAUGE_SIGMA = 1e-4
"""standard deviation of the fixed pose, metres and radians; relative poses do not depend on it"""
_LEAST_INFORMATION = 1e-4
"""information that is added to all directions of a measurement (a sigma of 100 m or rad), to make it invertible"""


def _graph(edges: Edges, T_world_node: Array, kernel: float | None, robust: Mask | None) -> Any:
    """gtsam's factor graph, with one pose of each connected part fixed."""
    import gtsam

    graph = gtsam.NonlinearFactorGraph()
    information = edges.information[:, _SWAP][:, :, _SWAP] + _LEAST_INFORMATION * np.eye(6)
    for e in range(len(edges)):
        noise: Any = gtsam.noiseModel.Gaussian.Information(information[e])
        if kernel is not None and robust is not None and robust[e]:
            noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.GemanMcClure.Create(kernel), noise)
        measured = gtsam.Pose3(edges.T_first_second[e])
        graph.add(gtsam.BetweenFactorPose3(int(edges.first[e]), int(edges.second[e]), measured, noise))
    gauge = gtsam.noiseModel.Isotropic.Sigma(6, _GAUGE_SIGMA)
    for node in np.unique(components(len(T_world_node), edges.first, edges.second)).tolist():
        graph.add(gtsam.PriorFactorPose3(node, gtsam.Pose3(T_world_node[node]), gauge))
    return graph


def _values(T_world_node: Array) -> Any:
    import gtsam

    values = gtsam.Values()
    for i, pose in enumerate(T_world_node):
        values.insert(i, gtsam.Pose3(pose))
    return values


def solve(T_world_node: Array, edges: Edges, kernel: float | None = None, robust: Mask | None = None) -> Array:
    """Poses (N, 4, 4) that minimise the squared residuals, by the Levenberg-Marquardt method.

    Args:
        T_world_node: (N, 4, 4) initial poses. The first pose of each connected part is kept fixed.
        kernel: scale of Geman-McClure's kernel in standard deviations: a residual as large has a weight of 1/4. None:
            no kernel.
        robust: (E,) the edges that the kernel applies to.
    """
    import gtsam

    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(60)
    parameters.setRelativeErrorTol(1e-7)
    parameters.setAbsoluteErrorTol(1e-7)
    graph = _graph(edges, T_world_node, kernel, robust)
    result = gtsam.LevenbergMarquardtOptimizer(graph, _values(T_world_node), parameters).optimize()
    out = np.stack([result.atPose3(i).matrix() for i in range(len(T_world_node))])
    out[:, :3, :3] = project_to_rotation(out[:, :3, :3])
    return out


@dataclass(frozen=True, eq=False)
class Scales:
    """Unknown scale errors of odometry edges."""

    number: Indices
    """(E,) number of each edge's scale; -1 if it has none"""
    begins: Indices
    """(B,) scales, one a segment, for which there is a prior of standard deviation ``sigma``"""
    sigma: float
    """standard deviation of these scales about 1"""
    neighbours: Indices
    """(M, 2) neighbouring scales"""
    neighbour_sigma: float
    """standard deviation of the difference of neighbouring scales"""


class Covariances:
    """Covariances of relative poses. Calls in the order of the road are fastest."""

    def __init__(self, T_world_node: Array, edges: Edges, scales: Scales | None = None) -> None:
        """
        Args:
            scales: unknown scales of odometry edges, which are marginalised; the information of edges is that for known
                scales. None: all scales are known.
        """
        import gtsam

        self._T_world_node = T_world_node
        graph, values = _graph(edges, T_world_node, None, None), _values(T_world_node)
        if scales is None:
            self._marginals = gtsam.Marginals(graph, values)
        else:
            linear = _with_scales(graph.linearize(values), edges, scales, len(T_world_node))
            self._marginals = gtsam.Marginals(linear, linear.optimize())

    def relative(self, first: Indices, second: Indices) -> Array:
        """(M, 6, 6) covariances of ``xi`` in ``T_first_second @ se3_exp(xi)``, for M connected pairs of nodes.

        In terms of the twists of both poses, ``xi = xi_second - adjoint(T_second_first) @ xi_first``.
        """
        joint = np.empty((len(first), 12, 12))
        for m in np.lexsort((second, first)).tolist():
            joint[m] = self._joint(int(first[m]), int(second[m]))
        A = np.zeros((len(first), 6, 12))
        A[:, :, :6] = -adjoint(invert(self._T_world_node[second]) @ self._T_world_node[first])
        A[:, :, 6:] = np.eye(6)
        out = A @ joint @ np.swapaxes(A, 1, 2)
        return np.asarray((out + np.swapaxes(out, 1, 2)) / 2)

    def _joint(self, first: int, second: int) -> Array:
        """(12, 12) joint covariance of the twists of two poses."""
        joint = self._marginals.jointMarginalCovariance([first, second])
        out = np.empty((12, 12))
        out[:6, :6] = joint.at(first, first)[_SWAP][:, _SWAP]
        out[:6, 6:] = joint.at(first, second)[_SWAP][:, _SWAP]
        out[6:, :6] = out[:6, 6:].T
        out[6:, 6:] = joint.at(second, second)[_SWAP][:, _SWAP]
        return out


def _with_scales(linear: Any, edges: Edges, scales: Scales, nodes: int) -> Any:
    """The linear graph with a scale as third unknown of each edge that has one; scales are numbered after the nodes.

    A scale error s changes the residual of ``T_first_second = (R, t)`` by ``-s R^T t``, in the second node's frame.
    """
    import gtsam

    unit = gtsam.noiseModel.Unit
    out = gtsam.GaussianFactorGraph()
    for e in range(linear.size()):
        factor = linear.at(e)
        if e >= len(edges) or scales.number[e] < 0:
            out.push_back(factor)
            continue
        information = edges.information[e][_SWAP][:, _SWAP] + _LEAST_INFORMATION * np.eye(6)
        T = edges.T_first_second[e]
        moves = np.concatenate([np.zeros(3), -T[:3, :3].T @ T[:3, 3]])
        by_scale = np.linalg.cholesky(information).T @ moves
        A, b = factor.jacobian()
        first, second = int(edges.first[e]), int(edges.second[e])
        scale = nodes + int(scales.number[e])
        out.add(gtsam.JacobianFactor(
            first, A[:, :6], second, A[:, 6:], scale, by_scale[:, None], b, unit.Create(6)
        ))  # fmt: skip
    one, none = np.ones((1, 1)), np.zeros(1)
    for begin in scales.begins.tolist():
        out.add(gtsam.JacobianFactor(nodes + begin, one / scales.sigma, none, unit.Create(1)))
    for a, b in scales.neighbours.tolist():
        weight = one / scales.neighbour_sigma
        out.add(gtsam.JacobianFactor(nodes + a, -weight, nodes + b, weight, none, unit.Create(1)))
    return out
