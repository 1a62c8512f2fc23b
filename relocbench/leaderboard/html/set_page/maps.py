"""Maps of a dataset that is available: its routes from above, and where the query of each pair stands.

A map has one world. Queries stand where the truth puts them beside their keyframe, in the world of the keyframe, so
that no fault between the frames of two drives is drawn as if somebody had made it. Where the drive of the queries has
a world of its own, the same pairs are also drawn there, at the poses of that drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.datasets.core.upright import with_camera_axes
from relocbench.datasets.core.worlds import world_of_traversals
from relocbench.geometry import invert
from relocbench.leaderboard.html.data import floats

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


_MOST_OF_A_ROUTE = 1500
"""poses of a traversal that are drawn at most"""
_STEP_M = 25.0
_LONGEST_STEP_M = 50.0
"""a route is broken between poses that are further apart than ten times their usual distance, within these bounds"""


class Maps:
    """The worlds of some pair sets of a dataset."""

    def __init__(self, dataset: Dataset, pair_sets: Sequence[str]) -> None:
        """Find out which traversals share a world.

        Raises:
            DatasetError: a file of poses or pairs is bad.
        """
        self._dataset = dataset
        self._sets = [dataset.pair_set(name) for name in pair_sets]
        self._of = world_of_traversals(dataset, self._sets)
        self._names = list(dict.fromkeys(self._of.values()))
        self._routes = {name: self._poses(name) for name in self._of}
        self._plans = {world: plan_of(self._poses_in(world)) for world in self._names}

    def worlds(self) -> list[dict[str, Any]]:
        """Each world with the names of its axes, what is taken off its coordinates, and the routes of its drives."""
        return [
            {
                "name": world,
                "axes": list(self._plans[world].names),
                "origin": self._plans[world].origin.tolist(),
                "routes": {name: _route(self._routes[name], self._plans[world]) for name in self._drives(world)},
            }
            for world in self._names
        ]

    def places(self, name: str, keys: Sequence[PairKey]) -> dict[str, Any]:
        """Where the queries of pairs of a pair set stand: the world's number and coordinates, NaN where unknown."""
        pair_set = self._dataset.pair_set(name)
        world, own = self._of[pair_set.reference], self._of[pair_set.query]
        out = {**self._placed(world, self._beside_keyframes(pair_set, keys)), "own": None}
        if own != world:
            poses = self._dataset.traversal(pair_set.query).poses
            T_rig_cam = self._dataset.traversal(pair_set.query).T_rig_cam(pair_set.query_camera)
            centre = T_rig_cam[:, 3]
            known = [poses[query] @ centre if query in poses else np.full(4, np.nan) for _, query in keys]
            out["own"] = self._placed(own, np.array(known).reshape(-1, 4)[:, :3])
        return out

    def _placed(self, world: str, positions: Array) -> dict[str, Any]:
        points = self._plans[world].of(positions)
        return {"world": self._names.index(world), "x": floats(points[:, 0]), "y": floats(points[:, 1])}

    def _beside_keyframes(self, pair_set: PairSet, keys: Sequence[PairKey]) -> Array:
        """(N, 3) centres of the queries' cameras in the keyframes' world."""
        reference = self._dataset.traversal(pair_set.reference)
        poses, pairs = reference.poses, pair_set.by_key
        known = [i for i, key in enumerate(keys) if key[0] in poses and key in pairs]
        known = [i for i in known if pairs[keys[i]].T_query_ref is not None]
        T_world_ref = np.array([poses[keys[i][0]] for i in known]).reshape(-1, 4, 4) @ reference.T_rig_cam(
            pair_set.reference_camera
        )
        T_query_ref = np.array([pairs[keys[i]].T_query_ref for i in known], dtype=np.float64).reshape(-1, 4, 4)
        out = np.full((len(keys), 3), np.nan)
        out[known] = (T_world_ref @ invert(T_query_ref))[:, :3, 3]
        return out

    def _drives(self, world: str) -> list[str]:
        return [name for name, of in self._of.items() if of == world]

    def _poses_in(self, world: str) -> Array:
        return np.concatenate([self._routes[name] for name in self._drives(world)])

    def _poses(self, name: str) -> Array:
        """(N, 4, 4) ``T_world_cam`` of a traversal, of the camera or frame of its first pair set, in camera axes."""
        traversal = self._dataset.traversal(name)
        camera = next(
            s.reference_camera if name == s.reference else s.query_camera
            for s in self._sets
            if name in (s.reference, s.query)
        )
        poses = np.array(list(traversal.poses.values())).reshape(-1, 4, 4) @ traversal.T_rig_cam(camera)
        return with_camera_axes(poses) if camera in traversal.frames else np.asarray(poses)


def _route(T_world_cam: Array, plan: Plan) -> dict[str, dict[str, str]]:
    """The line of a drive; NaN where it is broken."""
    step = max(1, -(-len(T_world_cam) // _MOST_OF_A_ROUTE))
    points = plan.of(T_world_cam[::step, :3, 3])
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    usual = float(np.median(lengths)) if len(lengths) else 0.0
    gaps = np.flatnonzero(lengths > max(_STEP_M, min(10.0 * usual, _LONGEST_STEP_M)))
    points = np.insert(points, gaps + 1, np.nan, axis=0)
    return {"x": floats(points[:, 0]), "y": floats(points[:, 1])}
