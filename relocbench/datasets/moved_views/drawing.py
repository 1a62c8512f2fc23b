"""What is made up for a photograph, drawn by seed: the part that is the keyframe, the surface behind it, motions.

A query shows nothing but the photograph: a motion after which it would see beyond the photograph's border is drawn
again, smaller. Motions forward or back along the viewing direction, as a car's, have a share of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.moved_views.kinds import SurfaceKind
from relocbench.datasets.moved_views.surfaces import Planes, Relief, Surface, seen_at, shown_at
from relocbench.geometry import Camera, make_transform, so3_exp

LEAST_CROP, MOST_CROP = 0.62, 0.8
"""the keyframe's share of the largest part of the photograph that has its shape, along either side"""
_ASIDE = 0.25
"""the keyframe's distance from the photograph's middle, as a share of the room around it"""
_FIELD_DEG = 50.0, 80.0
"""horizontal field of view of photographs that do not tell it"""
_DISTANCE_M = 4.0, 20.0
"""of a plane or relief, along the photograph's axis"""
_SLANT = 0.65
"""greatest change of a plane's inverse depth from the photograph's middle to its border, relative"""
_EYE_M = 1.2, 2.0
"""height of the camera above a street"""
_FRONT_M = 8.0, 50.0
_SIDE_M = 2.5, 12.0
_LOG_RELIEF = 0.3
"""standard deviation of the logarithm of a relief's numbers"""
_RELIEF_CELLS = 3
"""distances between the numbers of a relief over the photograph's longer side"""
_FARTHEST_M, _NEAREST_M = 150.0, 0.5
_MOST_ZOOM = 2.0
"""between the depths of a point in keyframe and query"""
_FORWARD_CONE_DEG = 8.0
_AHEAD = 0.7
"""share of forward motions after which the query is ahead of the keyframe rather than behind"""
_TRIES = 400
_SHRINK = 0.985
"""of motions from one try to the next"""
_MARGIN = 1.0
"""pixels of the photograph around the last ones that a query may show"""


@dataclass(frozen=True)
class Crop:
    """The part of a photograph that is the keyframe, in pixels of the photograph."""

    left: float
    """of the outer edge of its first column; that of the photograph is 0"""
    top: float
    scale: float
    """pixels of the keyframe for each of the photograph, at most 1"""

    def to_photograph(self, pixels: Array) -> Array:
        """Pixels (N, 2) of the photograph at pixels of the keyframe; centres are at integers in both."""
        return np.asarray((pixels + 0.5) / self.scale + (self.left, self.top) - 0.5)

    def to_keyframe(self, pixels: Array) -> Array:
        """The opposite."""
        return np.asarray((pixels + 0.5 - (self.left, self.top)) * self.scale - 0.5)


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


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A part of a photograph with a camera and a surface."""

    size: tuple[int, int]
    """(width, height) of the photograph"""
    crop: Crop
    camera: Camera
    surface: Surface

    def depth(self) -> Array:
        """(H, W) metres along z."""
        rays, _ = self.camera.unproject(grid(self.camera))
        return np.asarray(1.0 / self.surface.inverse_depth(rays))


def least_size(size: tuple[int, int]) -> tuple[int, int]:
    """Width and height in pixels that a photograph needs at least for keyframes of a size."""
    return int(np.ceil(size[0] / MOST_CROP)), int(np.ceil(size[1] / MOST_CROP))


def drawn_keyframe(
    size: tuple[int, int], focal_px: float | None, wanted: tuple[int, int], kind: SurfaceKind, rng: np.random.Generator
) -> Keyframe:
    """Draw the part of a photograph that is a keyframe, and its surface.

    Args:
        size: (width, height) of the photograph, at least :func:`least_size`.
        focal_px: its focal length in its own pixels; None: drawn.
        wanted: (width, height) of the keyframe.
    """
    width, height = size
    field = np.exp(rng.uniform(*np.log(np.tan(np.radians(_FIELD_DEG) / 2))))
    focal = width / 2 / field if focal_px is None else focal_px
    largest = min(width / wanted[0], height / wanted[1])
    share = rng.uniform(max(LEAST_CROP, 1 / largest), MOST_CROP)
    scale = 1 / (share * largest)
    room = np.array([width - wanted[0] / scale, height - wanted[1] / scale])
    left, top = room * (0.5 + _ASIDE * rng.uniform(-1, 1, size=2))
    crop = Crop(float(left), float(top), float(scale))
    cx, cy = crop.to_keyframe(np.array([width - 1, height - 1]) / 2)
    camera = Camera("pinhole", *wanted, focal * scale, focal * scale, float(cx), float(cy))
    rays, _ = camera.unproject(crop.to_keyframe(_lattice(width, height, 24)))
    for _ in range(_TRIES):
        surface = _DRAWN[kind](rays, rng)
        inverse = surface.inverse_depth(rays)
        if inverse.min() >= 1 / _FARTHEST_M and inverse.max() <= 1 / _NEAREST_M:
            return Keyframe(size, crop, camera, surface)
    return Keyframe(size, crop, camera, Planes(np.array([[0.0, 0.0, 1 / _DISTANCE_M[0]]])))


def drawn_motion(keyframe: Keyframe, motions: Motions, rng: np.random.Generator) -> Array:
    """A motion ``T_query_ref`` (4, 4) after which the query shows nothing but the photograph."""
    camera = keyframe.camera
    coarse = _lattice(camera.width, camera.height, 16)
    rays, _ = camera.unproject(_lattice(camera.width, camera.height, 24))
    median = float(np.median(1.0 / keyframe.surface.inverse_depth(rays)))
    forward = rng.uniform() < motions.forward
    most = min(motions.translation * median, motions.most_m)
    for attempt in range(_TRIES):
        smaller = _SHRINK**attempt
        T_query_ref = (
            _along(most * smaller, motions.rotation_deg / 2 * smaller, rng)
            if forward
            else _anyhow(most * smaller, motions.rotation_deg * smaller, rng)
        )
        if not _shows_photograph(keyframe, T_query_ref, coarse) or not _keeps_scale(keyframe, T_query_ref):
            continue
        if _shows_photograph(keyframe, T_query_ref, _lattice(camera.width, camera.height, None)):
            return T_query_ref
    return np.eye(4)


def _plane(rays: Array, rng: np.random.Generator) -> Planes:
    """One plane, slanted in any direction."""
    towards = rng.uniform(0, 2 * np.pi)
    slant = np.array([np.cos(towards), np.sin(towards), 0.0])
    slant *= rng.uniform(0, _SLANT) / np.max(np.abs(rays @ slant))
    return Planes((slant + np.array([0.0, 0.0, 1.0]))[None] / _log_uniform(_DISTANCE_M, rng))


def _street(rays: Array, rng: np.random.Generator) -> Planes:
    """A road, a house across it, and houses on neither, one or both sides."""
    yaw = np.radians(rng.uniform(-40, 40))
    walls = [
        np.array([0.0, 1.0, 0.0]) / rng.uniform(*_EYE_M),
        np.array([np.sin(yaw), 0.0, np.cos(yaw)]) / _log_uniform(_FRONT_M, rng),
    ]
    walls += [np.array([side, 0.0, 0.0]) / _log_uniform(_SIDE_M, rng) for side in (-1.0, 1.0) if rng.uniform() < 0.6]
    turn = np.radians([rng.uniform(-6, 6), rng.uniform(-15, 15), rng.uniform(-2, 2)])
    return Planes(np.array(walls) @ so3_exp(turn))


def _relief(rays: Array, rng: np.random.Generator) -> Relief:
    """A slanted plane with smooth hills and hollows."""
    low, high = rays[:, :2].min(axis=0), rays[:, :2].max(axis=0)
    spacing = float(np.max(high - low)) / _RELIEF_CELLS
    counts = np.ceil((high - low) / spacing).astype(int) + 3
    origin = (low + high) / 2 - spacing * (counts - 1) / 2
    x, y = np.meshgrid(*(origin[i] + spacing * np.arange(counts[i]) for i in range(2)))
    plane = _plane(rays, rng).inverse_depth(np.stack([x, y, np.ones_like(x)], axis=-1))
    hills = np.exp(np.clip(_LOG_RELIEF * rng.standard_normal(plane.shape), -2 * _LOG_RELIEF, 2 * _LOG_RELIEF))
    # Beyond the photograph, a plane may pass its horizon; the surface does not.
    return Relief(np.maximum(plane, 1 / _FARTHEST_M) * hills, (float(origin[0]), float(origin[1])), spacing)


_DRAWN: dict[SurfaceKind, Callable[[Array, np.random.Generator], Surface]] = {
    "plane": _plane,
    "street": _street,
    "relief": _relief,
}


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


def _moved(centre: Array, turn: Array) -> Array:
    """``T_query_ref`` of a query's centre (3,) and rotation vector (3,) in the keyframe's frame."""
    rotation = so3_exp(turn)
    return make_transform(rotation, -rotation @ centre)


def _log_uniform(bounds: tuple[float, float], rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(*np.log(bounds))))


def _shows_photograph(keyframe: Keyframe, T_query_ref: Array, pixels: Array) -> bool:
    """Whether the query shows the photograph at all of its pixels (N, 2)."""
    camera = keyframe.camera
    at = keyframe.crop.to_photograph(seen_at(keyframe.surface, camera, camera, T_query_ref, pixels))
    last = np.array(keyframe.size) - 1 - _MARGIN
    return bool(np.all((at >= _MARGIN) & (at <= last)))  # also false for NaN


def _keeps_scale(keyframe: Keyframe, T_query_ref: Array) -> bool:
    """Whether no point of the keyframe that the query shows comes much nearer or goes much farther away."""
    camera = keyframe.camera
    uv, depth, moved = shown_at(
        keyframe.surface, camera, camera, T_query_ref, _lattice(camera.width, camera.height, 24)
    )
    ratio = moved[camera.contains(uv)] / depth[camera.contains(uv)]
    return bool(len(ratio) and np.all((ratio > 1 / _MOST_ZOOM) & (ratio < _MOST_ZOOM)))


def grid(camera: Camera) -> Array:
    """(H, W, 2) all pixels."""
    return np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).astype(np.float64)


def _lattice(width: int, height: int, count: int | None) -> Array:
    """(N, 2) pixels evenly over an image, to the outer edges of the border's pixels; None: the corners of all."""
    x = np.linspace(-0.5, width - 0.5, width + 1 if count is None else count + 1)
    y = np.linspace(-0.5, height - 0.5, height + 1 if count is None else count + 1)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
