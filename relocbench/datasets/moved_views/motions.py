"""Motions of cameras in front of made-up surfaces, drawn by seed.

A query of a photograph shows nothing but the photograph: a motion after which it would see beyond the photograph's
border is drawn again, smaller. Motions forward or back along the viewing direction, as a car's, have a share of their
own. After strong motions, and of cube maps that lack a face, at least three quarters of a query show something.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.moved_views.drawing import LEAST_CONTENT, Keyframe, View, lattice
from relocbench.datasets.moved_views.kinds import Viewpoint
from relocbench.datasets.moved_views.surfaces import shown_at
from relocbench.geometry import Camera, invert, make_transform, so3_exp

_MOST_ZOOM = 2.0
"""between the depths of a point in keyframe and query"""
_FORWARD_CONE_DEG = 8.0
_AHEAD = 0.7
"""share of forward motions after which the query is ahead of the keyframe rather than behind"""
_STRONG_ROUND_DEG, _STRONG_TURN_DEG, _STRONG_UP_DEG, _STRONG_ROLL_DEG = 45.0, 60.0, 15.0, 40.0
_STRONG_SCALE = 2.0
_MOST_BLOWN_UP = 1.5
"""pixels of a query for each of a cube map's, about its middle"""
_WIDEST_DEG = 95.0
"""field of view of a query of a cube map"""
_MOVING = 0.5
"""share of queries of a cube map that do not only turn, among strong motions"""
_LEAST_SHARED = 0.12
"""share of the keyframe's pixels whose points a query shows, after strong motions"""
_TRIES = 400
_SHRINK = 0.985
"""of motions from one try to the next"""


@dataclass(frozen=True)
class Motions:
    """How far cameras move."""

    translation: float
    """largest distance as a share of the keyframe's median depth"""
    most_m: float
    """largest distance in metres"""
    rotation_deg: float
    """largest angle"""
    forward: float
    """share of motions along the viewing direction, whose rotation is at most half of the largest"""
    viewpoint: Viewpoint = "normal"
    """strong: around a photograph's middle, or to another side of a cube map, whatever the angle and share above"""


def drawn_motion(keyframe: Keyframe, motions: Motions, rng: np.random.Generator) -> View:
    """A motion after which the query shows the photograph; none where none was found."""
    camera = keyframe.camera
    rays, _ = camera.unproject(lattice(camera, 24))
    median = float(np.median(1.0 / keyframe.surface.inverse_depth(rays)))
    most = min(motions.translation * median, motions.most_m)
    strong, cube = motions.viewpoint == "strong", len(keyframe.faces) > 1
    forward = not strong and rng.uniform() < motions.forward
    for attempt in range(_TRIES):
        smaller = _SHRINK**attempt
        view = View(camera, np.eye(4))
        if strong and cube:
            view = _turned(keyframe, most, smaller, rng)
        elif strong:
            view = View(camera, _around(median, smaller, rng))
        elif forward:
            view = View(camera, _along(most * smaller, motions.rotation_deg / 2 * smaller, rng))
        else:
            view = View(camera, _anyhow(most * smaller, motions.rotation_deg * smaller, rng))
        if _is_wanted(keyframe, view, LEAST_CONTENT if strong or cube else 1.0, _LEAST_SHARED if strong else 0.0):
            return view
    return View(camera, np.eye(4))


def _along(most_m: float, most_deg: float, rng: np.random.Generator) -> Array:
    """A motion along the viewing direction, with a turn mostly to the side."""
    cone = np.tan(np.radians(_FORWARD_CONE_DEG)) * rng.uniform(-1, 1, size=2)
    direction = np.array([cone[0], 0.5 * cone[1], 1.0]) * (1.0 if rng.uniform() < _AHEAD else -1.0)
    centre = most_m * rng.uniform(0.1, 1.0) * direction / np.linalg.norm(direction)
    turn = np.radians(most_deg) * rng.uniform(-1, 1, size=3) * (0.3, 1.0, 0.2)
    return _moved(centre, turn)


def _anyhow(most_m: float, most_deg: float, rng: np.random.Generator) -> Array:
    """A motion in any direction, with a turn about any axis."""
    direction, axis = rng.normal(size=3), rng.normal(size=3)
    centre = most_m * rng.uniform(0.1, 1.0) * direction / np.linalg.norm(direction)
    return _moved(centre, np.radians(most_deg) * rng.uniform() * axis / np.linalg.norm(axis))


def _around(median: float, smaller: float, rng: np.random.Generator) -> Array:
    """A motion around the point in the middle, which is then nearer or farther, with a roll."""
    turn, side, roll, log_scale = rng.uniform(-1, 1, size=4) * smaller
    # Mostly to the side, as viewpoints on a street differ.
    axis = np.array([np.sin(0.6 * side), np.cos(0.6 * side), 0.0])
    R_ref_query = so3_exp(np.radians(_STRONG_ROUND_DEG) * turn * axis)
    centre = np.array([0.0, 0.0, median]) - R_ref_query @ [0.0, 0.0, median * _STRONG_SCALE**log_scale]
    R_ref_query = R_ref_query @ so3_exp([0.0, 0.0, np.radians(_STRONG_ROLL_DEG) * roll])
    return invert(make_transform(R_ref_query, centre))


def _turned(keyframe: Keyframe, most_m: float, smaller: float, rng: np.random.Generator) -> View:
    """A turn to the side, a roll and another focal length; half of the time a motion too."""
    camera, face = keyframe.camera, keyframe.faces[0].camera
    up, aside, roll, log_scale = rng.uniform(-1, 1, size=4) * smaller
    angles = np.radians([_STRONG_UP_DEG * up, np.sqrt(_STRONG_TURN_DEG**2 - _STRONG_UP_DEG**2) * aside, 0.0])
    R_ref_query = so3_exp(angles) @ so3_exp([0.0, 0.0, np.radians(_STRONG_ROLL_DEG) * roll])
    direction = rng.normal(size=3)
    moved = most_m * smaller * rng.uniform(0.1, 1.0) * (rng.uniform() < _MOVING)
    widest = camera.width / 2 / np.tan(np.radians(_WIDEST_DEG) / 2)
    focal = float(np.clip(camera.fx * _STRONG_SCALE**log_scale, widest, _MOST_BLOWN_UP * face.fx))
    zoomed = replace(camera, fx=focal, fy=focal)
    return View(zoomed, invert(make_transform(R_ref_query, moved * direction / np.linalg.norm(direction))))


def _moved(centre: Array, turn: Array) -> Array:
    """``T_query_ref`` of a query's centre (3,) and rotation vector (3,) in the keyframe's frame."""
    rotation = so3_exp(turn)
    return make_transform(rotation, -rotation @ centre)


def _is_wanted(keyframe: Keyframe, view: View, content: float, shared: float) -> bool:
    """Whether so many of the query's pixels show something, and of the keyframe's points, at no very other scale."""
    if np.mean(keyframe.content(lattice(view.camera, 16), view)) < content:
        return False
    pixels = lattice(keyframe.camera, 24)
    uv, depth, moved = shown_at(keyframe.surface, keyframe.camera, view.camera, view.T_query_ref, pixels)
    inside = view.camera.contains(uv) & keyframe.content(pixels)
    ratio = moved[inside] / depth[inside]
    if not np.any(inside) or np.mean(inside) < shared or np.any((ratio <= 1 / _MOST_ZOOM) | (ratio >= _MOST_ZOOM)):
        return False
    # The border is looked at pixel by pixel only after all that is quickly refused.
    return content < 1.0 or bool(np.all(keyframe.content(_border(view.camera), view)))


def _border(camera: Camera) -> Array:
    """(N, 2) the outer corners of an image's outermost pixels."""
    pixels = lattice(camera, None)
    return pixels[~camera.contains(pixels)]
