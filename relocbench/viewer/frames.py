"""Poses, axes and cameras as rerun has them, and where the coordinates of a recording begin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.upright import with_camera_axes
from relocbench.geometry import Camera, transform_to_tq
from relocbench.viewer.pictures import reduced

Colour = tuple[int, int, int]
PLANE_M = 0.6
"""metres from a camera's centre at which its image stands in the world"""


def origin_of(poses: Sequence[Array]) -> Array:
    """A whole-metre point (3,) near poses (4, 4): rerun keeps coordinates in 32 bits, and maps count in 1000 km."""
    if not poses:
        return np.zeros(3)
    return np.asarray(np.rint(poses[0][:3, 3]), dtype=np.float64)


def transform(T_parent_child: Array) -> rr.Transform3D:
    """A pose (4, 4) as rerun has it."""
    translation, quaternion = transform_to_tq(T_parent_child)
    return rr.Transform3D(translation=translation, quaternion=rr.Quaternion(xyzw=quaternion))


def axes(colour: Colour) -> rr.Arrows3D:
    """The axes of a frame without images, in the colour of what it stands for."""
    return rr.Arrows3D(vectors=np.eye(3) * PLANE_M, colors=[colour] * 3)


def pinhole(camera: Camera, colour: Colour) -> rr.Pinhole:
    """The camera without its distortion, as a frustum."""
    camera = reduced(camera)
    # rerun's pixels are counted from the corner of the first one, ours from its centre.
    matrix = camera.matrix
    matrix[:2, 2] += 0.5
    return rr.Pinhole(
        image_from_camera=matrix,
        resolution=[camera.width, camera.height],
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=PLANE_M,
        color=colour,
    )


def view_coordinates(dataset: Dataset, world: str) -> rr.components.ViewCoordinates:
    """Which way is up: against the y axis of the first camera or frame, rounded to an axis of the world."""
    traversal = dataset.traversal(world)
    up = np.array([0.0, 0.0, 1.0])
    if traversal.poses and traversal.cameras:
        first = next(iter(traversal.poses.values())) @ traversal.T_rig_cam(traversal.cameras[0])
        up = -first[:3, 1]
    elif traversal.poses:
        poses = np.array(list(traversal.poses.values())) @ traversal.T_rig_cam(traversal.frames[0])
        up = -with_camera_axes(poses)[0, :3, 1]
    axis = int(np.argmax(np.abs(up)))
    names = {(0, True): "RIGHT_HAND_X_UP", (0, False): "RIGHT_HAND_X_DOWN", (1, True): "RIGHT_HAND_Y_UP"}
    names |= {(1, False): "RIGHT_HAND_Y_DOWN", (2, True): "RIGHT_HAND_Z_UP", (2, False): "RIGHT_HAND_Z_DOWN"}
    found: rr.components.ViewCoordinates = getattr(rr.ViewCoordinates, names[axis, bool(up[axis] > 0)])
    return found
