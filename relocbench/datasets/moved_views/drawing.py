"""What is made up for a photograph, drawn by seed: the part that is the keyframe, and the surface behind it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.moved_views.faces import Face, cube_faces, located
from relocbench.datasets.moved_views.kinds import SurfaceKind
from relocbench.datasets.moved_views.surfaces import Planes, Relief, Surface, points_seen
from relocbench.geometry import Camera, so3_exp

LEAST_CROP, MOST_CROP = 0.62, 0.8
"""the keyframe's share of the largest part of the photograph that has its shape, along either side"""
_ASIDE = 0.25
"""the keyframe's distance from the photograph's middle, as a share of the room around it"""
_FIELD_DEG = 50.0, 80.0
"""horizontal field of view of photographs that do not tell it, and of keyframes of cube maps"""
_UP_DEG, _ROLL_DEG = 12.0, 5.0
"""a keyframe of a cube map looks up or down and is rolled by up to so much"""
_DISTANCE_M = 4.0, 20.0
"""of a plane or relief, along the photograph's axis"""
_SLANT = 0.65
"""greatest change of a plane's inverse depth from the photograph's middle to its border, relative"""
_EYE_M = 1.2, 2.0
"""height of the camera above a street"""
_FRONT_M = 8.0, 50.0
_SIDE_M = 2.5, 12.0
_SKY_M = 60.0
"""above the camera, the upper end of a room around it"""
_LOG_RELIEF = 0.3
"""standard deviation of the logarithm of a relief's numbers"""
_RELIEF_CELLS = 3
"""distances between the numbers of a relief over the photograph's longer side"""
_FARTHEST_M, _NEAREST_M = 150.0, 0.5
_TRIES = 400
_MARGIN = 1.0
"""pixels of the photograph around the last ones that are shown"""
LEAST_CONTENT = 0.75
"""share of the pixels of a view that show something, where not all do"""


@dataclass(frozen=True, eq=False)
class View:
    """A camera that moved."""

    camera: Camera
    T_query_ref: Array
    """(4, 4)"""


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A part of a photograph, or of a cube map, with a camera and a surface."""

    faces: tuple[Face, ...]
    """what it is part of, in its frame; the first one is level"""
    camera: Camera
    surface: Surface

    @property
    def down(self) -> Array:
        """(3,) the direction of gravity."""
        return np.asarray(self.faces[0].R_face_ref[1])

    def content(self, pixels: Array, view: View | None = None) -> Mask:
        """(...,) bool: whether the keyframe, or a view of it, shows something at pixels (..., 2)."""
        if view is None:
            directions, _ = self.camera.unproject(pixels)
        else:
            directions = points_seen(self.surface, view.camera, view.T_query_ref, pixels)
        return np.asarray(located(self.faces, directions)[0] >= 0)

    def depth(self) -> Array:
        """(H, W) metres along z; 0 where the keyframe shows nothing."""
        rays, _ = self.camera.unproject(grid(self.camera))
        return np.where(self.content(grid(self.camera)), 1.0 / self.surface.inverse_depth(rays), 0.0)


def least_size(size: tuple[int, int]) -> tuple[int, int]:
    """Width and height in pixels that a photograph needs at least for keyframes of a size."""
    return int(np.ceil(size[0] / MOST_CROP)), int(np.ceil(size[1] / MOST_CROP))


def least_side(size: tuple[int, int]) -> int:
    """Side in pixels that the faces of a cube map need at least for keyframes of a size."""
    return int(np.ceil(max(size) / np.tan(np.radians(_FIELD_DEG[1]) / 2)))


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
    corner = room * (0.5 + _ASIDE * rng.uniform(-1, 1, size=2))
    cx, cy = ((np.array(size) / 2 - corner) * scale - 0.5).tolist()
    camera = Camera("pinhole", *wanted, focal * scale, focal * scale, cx, cy)
    whole = Camera("pinhole", width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    faces = (Face(whole, np.eye(3), _MARGIN),)
    rays, _ = whole.unproject(lattice(whole, 24))
    for _ in range(_TRIES):
        surface = _DRAWN[kind](rays, rng)
        inverse = surface.inverse_depth(rays)
        if inverse.min() >= 1 / _FARTHEST_M and inverse.max() <= 1 / _NEAREST_M:
            return Keyframe(faces, camera, surface)
    return Keyframe(faces, camera, Planes(np.array([[0.0, 0.0, 1 / _DISTANCE_M[0]]])))


def drawn_cube_keyframe(names: Sequence[str], side: int, wanted: tuple[int, int], rng: np.random.Generator) -> Keyframe:
    """Draw a view of a cube map that is a keyframe, and a room around it.

    Args:
        names: of the faces, the sides first.
        side: of the faces in pixels, at least :func:`least_side`.
        wanted: (width, height) of the keyframe.
    """
    largest, smallest = np.tan(np.radians(_FIELD_DEG[1]) / 2), np.tan(np.radians(_FIELD_DEG[0]) / 2)
    field = np.exp(rng.uniform(np.log(max(smallest, max(wanted) / side)), np.log(largest)))
    focal = max(wanted) / 2 / field
    camera = Camera("pinhole", *wanted, focal, focal, (wanted[0] - 1) / 2, (wanted[1] - 1) / 2)
    room = _room(rng)
    for _ in range(_TRIES):
        yaw, up, roll = rng.uniform(-1, 1, size=3) * np.radians([180.0, _UP_DEG, _ROLL_DEG])
        R_cube_ref = so3_exp([0, yaw, 0]) @ so3_exp([up, 0, 0]) @ so3_exp([0, 0, roll])
        keyframe = Keyframe(cube_faces(names, side, R_cube_ref), camera, Planes(room @ R_cube_ref))
        if keyframe.content(lattice(camera, 24)).mean() >= LEAST_CONTENT:
            break
    return keyframe


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


def _room(rng: np.random.Generator) -> Array:
    """(6, 3) n / d, for each plane of a room around the camera: a road, walls on four sides, a sky."""
    turn = so3_exp([0, np.radians(rng.uniform(-45, 45)), 0])
    ahead, beside = ([_log_uniform(bounds, rng) for _ in range(2)] for bounds in (_FRONT_M, _SIDE_M))
    walls = [[0, 0, 1 / ahead[0]], [0, 0, -1 / ahead[1]], [1 / beside[0], 0, 0], [-1 / beside[1], 0, 0]]
    return np.array([[0, 1 / rng.uniform(*_EYE_M), 0], [0, -1 / _SKY_M, 0], *walls]) @ turn


_DRAWN: dict[SurfaceKind, Callable[[Array, np.random.Generator], Surface]] = {
    "plane": _plane,
    "street": _street,
    "relief": _relief,
}


def _log_uniform(bounds: tuple[float, float], rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(*np.log(bounds))))


def grid(camera: Camera) -> Array:
    """(H, W, 2) all pixels."""
    return np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).astype(np.float64)


def lattice(camera: Camera, count: int | None) -> Array:
    """(N, 2) pixels evenly over an image, to the outer edges of the border's pixels; None: the corners of all."""
    x, y = (np.linspace(-0.5, side - 0.5, (count or side) + 1) for side in camera.size)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
