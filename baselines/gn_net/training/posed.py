"""What the pose loss needs to know of a pair besides its correspondences: points, the query's camera, the true pose."""

from __future__ import annotations

from typing import NamedTuple, TypeGuard

import numpy as np

from baselines.gn_net.training.crops import Cut, Pixels
from relocbench.arrays import Array, Mask
from relocbench.errors import MethodError
from relocbench.geometry import invert
from relocbench.tracking import KeyframePoints
from relocbench.training import PosedTrainingData, TrainingData

_PINHOLE = "pinhole"
_MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


class Posed(NamedTuple):
    """A pair's M correspondences as points, with the pose between its images."""

    X_ref: Array
    """(M, 3) metres in the keyframe's camera; where the depth is not known, ones"""
    known: Mask
    """(M,) bool"""
    intrinsics: Array
    """(4,) fx, fy, cx, cy of the query"""
    T_query_ref: Array
    """(4, 4)"""


def posed_pair(data: TrainingData, index: int, u_ref: Pixels, swapped: bool) -> Posed:
    """Depth, camera and pose of a pair.

    Args:
        data: must tell poses.
        index: of the pair.
        u_ref: (M, 2) pixels of the image that serves as the keyframe.
        swapped: whether that is the pair's query. No depth is known then unless it is a keyframe of its own.

    Raises:
        MethodError: the data tells no poses.
        DatasetError: poses are withheld, or an image cannot be read.
    """
    if not is_posed(data):
        raise MethodError("the pose loss (loss.pose.weight) needs data with true poses and cameras")
    pair = data.posed(index)
    names = (pair.image_query, pair.image_ref) if swapped else (pair.image_ref, pair.image_query)
    keyframe, query = data.view(names[0], depth=True), data.view(names[1], depth=False)
    T_query_ref = invert(pair.T_query_ref) if swapped else pair.T_query_ref
    if keyframe.camera.model != _PINHOLE or query.camera.model != _PINHOLE:
        return not_posed(len(u_ref))
    inverse_depth = inverse_depth_at(keyframe.points, u_ref, keyframe.image.shape[:2])
    known = inverse_depth > 0
    depth = 1.0 / np.where(known, inverse_depth, 1.0)
    camera = keyframe.camera
    rays = np.column_stack([(u_ref - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(u_ref))])
    of_query = np.array([query.camera.fx, query.camera.fy, query.camera.cx, query.camera.cy])
    return Posed(rays * depth[:, None], known, of_query, T_query_ref)


def not_posed(count: int) -> Posed:
    """Points (M = count) of which nothing is known."""
    return Posed(np.ones((count, 3)), np.zeros(count, dtype=bool), np.ones(4), np.eye(4))


def is_posed(data: TrainingData) -> TypeGuard[PosedTrainingData]:
    """Whether the data tells poses."""
    return hasattr(data, "posed") and hasattr(data, "view")


def inverse_depth_at(points: KeyframePoints, u: Pixels, size: tuple[int, int]) -> Array:
    """The inverse depth (M,), 1/m, of the point whose pixel is that of u (M, 2), rounded; 0 where there is none.

    ``size`` is the height and width of the keyframe's image.
    """
    height, width = size
    grid = np.zeros((height, width))
    at = np.rint(points.uv).astype(int)
    inside = np.all((at >= 0) & (at < [width, height]), axis=1)
    grid[at[inside, 1], at[inside, 0]] = points.inverse_depth[inside]
    columns, rows = np.clip(np.rint(u).astype(int), 0, [width - 1, height - 1]).T
    return np.asarray(grid[rows, columns])


def mirrored_pose(posed: Posed, width: int) -> Posed:
    """The same of both images mirrored left to right; ``width`` is the query's."""
    fx, fy, cx, cy = posed.intrinsics
    return Posed(
        posed.X_ref * [-1.0, 1.0, 1.0],
        posed.known,
        np.array([fx, fy, width - 1 - cx, cy]),
        _MIRROR @ posed.T_query_ref @ _MIRROR,
    )


def cut_posed(posed: Posed, cut: Cut) -> Posed:
    """The same of the crops, with the correspondences that they hold."""
    focal, middle = posed.intrinsics[:2], posed.intrinsics[2:]
    intrinsics = np.concatenate([focal * cut.scale_query, (middle + 0.5) * cut.scale_query - 0.5 - cut.corner_query])
    return Posed(posed.X_ref[cut.kept], posed.known[cut.kept], intrinsics, posed.T_query_ref)
