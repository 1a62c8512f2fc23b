"""Motions of one cloud against the other that its surfaces cannot tell: along a corridor, about the axis of a tunnel.

The normals of a corridor are not exactly across it, and the fit takes their noise for surfaces that face along it. The
noise of the normals of two clouds is independent, though. Of a motion xi, ``H = sum w a b^T`` holds what both clouds
say of it, with a from the normals of one and b from those of the other, and ``Q = sum w (a a^T + b b^T) / 2`` what each
says alone. The generalised eigenvalues of H by Q are reliability ratios (Fuller, Measurement error models, 1987): close
to 1 where surfaces tell a motion, and close to 0 where only noise does.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import eigh

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.pose_graph.edge_information import LENGTH_M
from relocbench.geometry import apply, hat

_LEAST_RELIABILITY = 0.5
"""reliability below which a motion is open: at most 0.25 along corridors, planes, tunnels and spheres with points of
1 to 3 cm noise, and at least 0.76 on streets, in rooms and on objects, also from a depth camera"""
_RIDGE = 1e-7
"""share of the trace that is added to Q, so that surfaces without any noise do not make it singular"""
_NO_TURN = 0.1
"""metres, at 10 m, that a motion of unit length turns by at most if it is a translation"""
_TOUCHED = 0.05
"""share of a motion along an axis from which this axis is not known"""
_SCALE = np.repeat([1.0, 1.0 / LENGTH_M], 3)
"""(6,) xi of a motion in metres, at the characteristic length, per metre of it"""


@dataclass(frozen=True, eq=False)
class OpenDirections:
    """The open motions of a fit, in xi = (rho, phi) of ``T_ref_query @ se3_exp(xi)``."""

    basis: Array
    """(6, k) orthonormal, rotations in metres at the characteristic length"""

    def __len__(self) -> int:
        return int(self.basis.shape[1])

    @cached_property
    def closed(self) -> Array:
        """(6, 6 - k) the xi of the motions that are told, orthogonal to the open ones."""
        return np.asarray(_SCALE[:, None] * self._others)

    def lifted(self, information: Array) -> Array:
        """Information (6, 6) of xi, from that (6 - k, 6 - k) of the motions that are told; none of the open ones."""
        told = (self._others / _SCALE[:, None]).T
        return np.asarray(told.T @ information @ told)

    def forgotten(self, information: Array) -> Array:
        """Information (6, 6) of xi without any of the open motions."""
        return self.lifted(self.closed.T @ information @ self.closed)

    def covariance_without(self, information: Array) -> Array:
        """(6, 6) covariance of xi if the open motions were known, by its information."""
        return np.asarray(self.closed @ np.linalg.inv(self.closed.T @ information @ self.closed) @ self.closed.T)

    @cached_property
    def _others(self) -> Array:
        return np.asarray(np.linalg.svd(self.basis, full_matrices=True)[0][:, len(self) :])

    def unknown_axes(self, rotation: Array) -> tuple[Array, bool]:
        """(3,) which axes of a frame the position is open along, and whether the rotation is open.

        Args:
            rotation: (3, 3) of the query in that frame.
        """
        along = np.linalg.norm(rotation @ self.basis[:3], axis=1) > _TOUCHED
        return along, bool(np.any(np.linalg.norm(self.basis[3:], axis=1) > _TOUCHED))

    def named(self, T_frame_query: Array, reduced_by: float = 1.0) -> str:
        """The motions in words, in a frame whose metres are ``reduced_by`` times as long; empty if there are none."""
        R = T_frame_query[:3, :3]
        directions, turns = self._translations_and_rotations()
        told = []
        if len(directions):
            told.append(_translations(directions @ R.T))
        if len(turns) == 3:
            centre = apply(T_frame_query, _fixed_point(turns)[None])[0] / reduced_by
            told.append(f"rotation about any axis through {_vector(centre)}")
        elif len(turns):
            for rho, phi in turns:
                on_axis = np.cross(phi, rho) / max(float(phi @ phi), 1e-12)
                through = apply(T_frame_query, on_axis[None])[0] / reduced_by
                told.append(f"rotation about {_vector(_upright(R @ phi))} through {_vector(through)}")
        return "; ".join(told)

    def _translations_and_rotations(self) -> tuple[Array, list[tuple[Array, Array]]]:
        """(t, 3) unit vectors of the open translations, and (rho, phi) of the rotations, orthogonal to these."""
        if not len(self):
            return np.zeros((0, 3)), []
        turning, right = np.linalg.svd(self.basis[3:])[1:]
        turning = np.concatenate([turning, np.zeros(len(self) - len(turning))])
        moved = (self.basis @ right.T).T
        directions = moved[turning <= _NO_TURN, :3]
        turns = [(m[:3], m[3:] / LENGTH_M) for m in moved[turning > _NO_TURN]]
        return directions, turns


def open_directions(by_planes: Array, by_points: Array, weights: Array) -> OpenDirections:
    """The open motions of a fit.

    Args:
        by_planes, by_points: (M, 6) derivatives of each distance by xi, with the normals of either cloud.
        weights: (M,) of the distances.
    """
    a, b = by_points * _SCALE, by_planes * _SCALE
    H = (weights[:, None] * a).T @ b
    Q = (weights[:, None] * a).T @ a + (weights[:, None] * b).T @ b
    Q = Q + _RIDGE * max(float(np.trace(Q)), 1e-300) * np.eye(6)
    count = int(np.count_nonzero(eigh(H + H.T, Q, eigvals_only=True) < _LEAST_RELIABILITY))
    # Their number is told by the reliability, and they themselves by H, whose noise mixes less of the others into them.
    return OpenDirections(np.linalg.eigh(H + H.T)[1][:, :count])


def _translations(directions: Array) -> str:
    """Open translations, (t, 3) in the frame they are named in."""
    if len(directions) == 3:
        return "translation in every direction"
    if len(directions) == 2:
        return f"translation in the plane across {_vector(_upright(np.cross(*directions)))}"
    return f"translation along {_vector(_upright(directions[0]))}"


def _fixed_point(turns: list[tuple[Array, Array]]) -> Array:
    """(3,) the point that rotations (rho, phi) leave where it is: ``rho + phi x point = 0``."""
    rows = np.concatenate([hat(phi) for _, phi in turns])
    return np.asarray(np.linalg.lstsq(rows, -np.concatenate([rho for rho, _ in turns]), rcond=None)[0])


def _upright(v: Array) -> Array:
    """The unit vector along v whose largest component is positive."""
    return np.asarray(v / np.linalg.norm(v) * np.sign(v[np.argmax(np.abs(v))]))


def _vector(v: Array) -> str:
    return "(" + ", ".join(f"{x + 0.0:.2f}" for x in np.round(v, 2)) + ")"
