"""Starts of an alignment."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from relocbench.arrays import Array
from relocbench.geometry import make_transform, rotation_from_quaternion, se3_exp

SMALL_ROTATION = 0.02
"""quaternion component before normalising: 2.3, 3.2 and 4.0 degrees about one, two and three axes"""

ALONG_THE_ROAD = "starts along the road"
"""what trackers assume of how cameras move that try them"""


class Start(NamedTuple):
    """A pose that an alignment starts from."""

    T_query_ref: Array
    """(4, 4)"""
    level: int | None = None
    """first level that is worked on; coarser ones do not improve a pose that is accurate to a pixel of it. None: the
    coarsest level"""


def small_rotations() -> list[Array]:
    """DSO's 26 small rotations (4, 4): quaternions (x, y, z, 1) with components in {-0.02, 0, 0.02}, not all zero."""
    components = product((0.0, -SMALL_ROTATION, SMALL_ROTATION), repeat=3)
    return [
        make_transform(rotation_from_quaternion([*vector, 1.0]), np.zeros(3)) for vector in components if any(vector)
    ]


def moved_along(T_query_ref: Array, metres: Sequence[float], turns: Sequence[float] = (0.0,)) -> list[Array]:
    """Poses of a query camera that has driven on from where it stands, along arcs of circles.

    A camera that drives looks along the road, and a retrieved keyframe lies ahead of it or behind, on a bend at another
    angle. The arc begins in the viewing direction and lies in the image's horizontal plane, so that the camera turns
    about its y axis.

    Args:
        T_query_ref: (4, 4) the pose that is changed.
        metres: lengths of the arcs, positive in the viewing direction.
        turns: radians by which the camera is turned at the end of each, positive to the right; 0 is straight on.

    Returns:
        One T_query_ref (4, 4) for each length and turn, all turns of the first length first.
    """
    twists = (np.array([0.0, 0.0, by, 0.0, turn, 0.0]) for by, turn in product(metres, turns))
    return [se3_exp(-twist) @ T_query_ref for twist in twists]
