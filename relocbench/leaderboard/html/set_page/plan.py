"""A world seen from above: which of its axes lie in the plane of a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array

_UPRIGHT = 0.5
"""length of the mean of the cameras' down directions from which on cameras count as upright"""
_ALONG_AN_AXIS = 0.8
"""share of the down direction along an axis of the world from which on that axis counts as the vertical"""
_FAR_M = 1e5
"""coordinates from here on are told from a whole number of kilometres, since pages keep them in 32 bits"""
_PLANES = {
    (2, 1): ("x", "y"),
    (2, -1): ("y", "x"),
    (1, 1): ("x", "-z"),
    (1, -1): ("x", "z"),
    (0, 1): ("y", "z"),
    (0, -1): ("z", "y"),
}
"""vertical axis and the sign of up along it -> the axes to the right and to the top of a map, which is not mirrored"""


@dataclass(frozen=True, eq=False)
class Plan:
    """The plane of a map."""

    axes: Array
    """(2, 3) unit vectors in the world: to the right of the map, and to its top"""
    names: tuple[str, str]
    """of the axes, such as ``x`` and ``-z``; empty where they are no axes of the world"""
    origin: Array
    """(2,) metres, which is taken off both coordinates"""

    def of(self, positions: Array) -> Array:
        """(N, 2) coordinates in metres of positions (N, 3)."""
        out: Array = positions @ self.axes.T - self.origin
        return out


def plan_of(T_world_cam: Array) -> Plan:
    """The plan view of a world from the poses (N, 4, 4) of cameras in it.

    Most cameras are held upright, so that up is where the tops of their images point; where they are not, up is the
    direction in which their positions vary least.
    """
    up = _up(T_world_cam)
    axis = int(np.argmax(np.abs(up)))
    if abs(up[axis]) >= _ALONG_AN_AXIS:
        names = _PLANES[axis, 1 if up[axis] > 0 else -1]
        axes = np.array([_unit(name) for name in names])
    else:
        names = ("", "")
        right = np.eye(3)[int(np.argmin(np.abs(up)))]
        right = right - (right @ up) * up
        right /= np.linalg.norm(right)
        axes = np.array([right, np.cross(up, right)])
    points = T_world_cam[:, :3, 3] @ axes.T
    far = points.size > 0 and float(np.abs(points).max()) >= _FAR_M
    origin = np.rint(np.median(points, axis=0) / 1000.0) * 1000.0 if far else np.zeros(2)
    return Plan(axes, names, origin)


def _up(T_world_cam: Array) -> Array:
    if len(T_world_cam):
        up = -T_world_cam[:, :3, 1].mean(axis=0)
        length = float(np.linalg.norm(up))
        if length >= _UPRIGHT:
            return np.asarray(up / length)
        positions = T_world_cam[:, :3, 3]
        least = np.linalg.svd(positions - positions.mean(axis=0), full_matrices=True)[2][-1]
        return np.asarray(least * (1.0 if least[np.argmax(np.abs(least))] > 0 else -1.0))
    return np.array([0.0, 0.0, 1.0])


def _unit(name: str) -> Array:
    out = np.zeros(3)
    out["xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    return out
