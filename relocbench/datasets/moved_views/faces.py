"""The stored images of what surrounds a camera: one photograph, or the sides of a cube map, all taken from one place.

A face of a cube map is a pinhole image of 90 degrees. Their frame is that of OpenGL's cube maps with the axes of a
camera that looks along posz: x right towards posx, y down towards negy, z forward. Turning right, the sides are posx,
negz, negx, posz; posy is what a camera that faces posz sees when it looks up, negy when it looks down.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.geometry import Camera

R_FACE_CUBE = {
    name: np.array(axes, dtype=np.float64)
    for name, axes in {
        "posx": [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        "negz": [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
        "negx": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        "posz": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "posy": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        "negy": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    }.items()
}
"""face -> (3, 3): its right, down and forward in the frame of the cube map"""
SIDES = "posx", "negz", "negx", "posz"
_BEYOND = 0.5 + 1e-6
"""pixels beyond its outermost pixel centres at which a cube's face ends, and more than rounding takes from it"""


@dataclass(frozen=True, eq=False)
class Face:
    """One stored image."""

    camera: Camera
    """of the whole image"""
    R_face_ref: Array
    """(3, 3) from the frame of the keyframe"""
    border: float
    """pixels inside its outermost pixel centres beyond which nothing is taken from it"""


def cube_faces(names: Sequence[str], side: int, R_cube_ref: Array) -> tuple[Face, ...]:
    """The faces of a cube map, each of ``side`` x ``side`` pixels, around a keyframe that looks along R_cube_ref."""
    middle = (side - 1) / 2
    camera = Camera("pinhole", side, side, side / 2, side / 2, middle, middle)
    return tuple(Face(camera, R_FACE_CUBE[name] @ R_cube_ref, -_BEYOND) for name in names)


def located(faces: Sequence[Face], directions: Array) -> tuple[Indices, Array]:
    """The face that shows each direction (..., 3) of the keyframe's frame, of any length, and the pixel there.

    Returns:
        the number (...) of the face whose middle is nearest; -1 where none shows it, or the direction is NaN
        pixels (..., 2) of that face; NaN where there is none
    """
    number = np.full(directions.shape[:-1], -1, dtype=np.int64)
    pixels = np.full((*directions.shape[:-1], 2), np.nan)
    nearest = np.zeros(directions.shape[:-1])
    for k, face in enumerate(faces):
        turned = directions @ face.R_face_ref.T
        at, _ = face.camera.project(turned)
        better = face.camera.contains(at, face.border) & (turned[..., 2] > nearest)
        number[better], pixels[better], nearest[better] = k, at[better], turned[better][..., 2]
    return number, pixels
