"""Depth of an image from the submap around it: what the camera sees of the surfaces, never through them.

Points become surfels (:mod:`.surfels`), surfels are drawn with a z-buffer (:mod:`.rasteriser`). A pixel is left
without depth where no surface was scanned, behind a gap that a surface closes on both sides (a window, a dark door),
behind leaves and whatever else has no plane, behind surfaces seen from their back, behind space in the shadow of what
was scanned (:mod:`.sightlines`), and where the rim of one surface covers the middle of another: either may be seen.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from relocbench.datasets.groundtruth.depth.rasteriser import OCCLUSION_STEP, Drawn, View, draw, draw_occlusion
from relocbench.datasets.groundtruth.depth.sightlines import TracedSpace, sight_limits, trace_beams
from relocbench.datasets.groundtruth.depth.surfels import SurfelOptions, Surfels, make_surfels
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.errors import ConfigError
from relocbench.geometry import Camera

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

_CLOSED = 5
"""pixels across"""


@dataclass(frozen=True)
class DepthNoise:
    """What makes depth uncertain, one standard deviation each; the defaults are those of a scanner on a car.

    A surfel's plane is uncertain by ``sqrt(range^2 + surface^2)`` on its own, and by the odometry between the image
    and the moment when it was scanned: by ``along`` a metre driven in the direction of travel and ``across`` a metre
    in the others. Depth along a ray that meets the plane at an angle is uncertain by that over the sine of the angle.
    """

    range_m: float = 0.012
    """of a single range; 12 mm is the data sheet's for a LMS-151"""
    surface_m: float = 0.004
    """of the plane: thinning to one point a voxel, unevenness, the normal's error over the surfel's size"""
    rough_m: float = 0.05
    """of a point that has no plane, in depth"""
    along_per_m: float = 0.008
    """scale of the odometry"""
    across_per_m: float = 0.001
    """sideways and in height"""

    def __post_init__(self) -> None:
        if self.range_m <= 0 or min(self.surface_m, self.rough_m, self.along_per_m, self.across_per_m) < 0:
            raise ConfigError("noise of depth: range_m is positive, the others are not negative")


@dataclass(frozen=True)
class DepthOptions:
    """How depth is drawn."""

    surfels: SurfelOptions = field(default_factory=SurfelOptions)
    noise: DepthNoise = field(default_factory=DepthNoise)
    max_depth_m: float = 80.0
    sigmas: float = 3.0
    """surfels whose depths differ by no more standard deviations are one surface"""
    slack_m: float = 0.02
    """... and so many metres besides"""
    least_centre: float = 0.15
    """where only the rim of the front surface is met and the middle of another one behind it, neither is certain"""
    occlusion_margin_m: float = 0.25
    """what lies further than this, and 2 % of its depth, behind something that hides is not shown"""
    cell_m: float = 0.3
    """of the space that beams went through; 0: a camera may look through what stands in their shadow"""
    shadow_m: float = 2.5
    """length of the shadow of a point"""
    through_m: float = 0.3
    """a line of sight that runs so far through shadow ends there"""
    start_m: float = 2.0
    """so near to the camera nothing stands in the way: the car's own space"""
    least_pixels: int = 12
    """smaller patches of depth are left out"""

    def __post_init__(self) -> None:
        if self.max_depth_m <= 0 or self.sigmas <= 0 or self.slack_m < 0 or not 0 <= self.least_centre <= 1:
            raise ConfigError("depth needs a positive max_depth_m and sigmas, slack_m >= 0 and least_centre in [0, 1]")


@dataclass(frozen=True, eq=False)
class DepthScene:
    """A submap made ready for any number of images."""

    surfels: Surfels
    space: TracedSpace | None
    """None: not looked at"""


@dataclass(frozen=True, eq=False)
class DepthImage:
    """Depth of an image, and how certain it is."""

    depth: Floats
    """(H, W) metres along z, 0 where none is known"""
    sigma: Floats
    """(H, W) metres, 0 where none is known"""

    @property
    def coverage(self) -> float:
        """Share of the pixels with depth."""
        return float(np.mean(self.depth > 0))


def submap_depth(submap: Submap, camera: Camera, T_cam_node: Array, options: DepthOptions | None = None) -> DepthImage:
    """Depth of an image taken near a submap's node.

    Args:
        camera: pinhole.
        T_cam_node: (4, 4).

    Raises:
        ConfigError: the camera is not a pinhole camera.
    """
    options = options or DepthOptions()
    return scene_depth(make_scene(submap, options), camera, T_cam_node, options)


def make_scene(submap: Submap, options: DepthOptions | None = None) -> DepthScene:
    """What does not depend on the camera."""
    options = options or DepthOptions()
    space = trace_beams(submap, options.cell_m, options.max_depth_m, options.shadow_m) if options.cell_m > 0 else None
    return DepthScene(make_surfels(submap, options.surfels), space)


def scene_depth(
    scene: DepthScene, camera: Camera, T_cam_node: Array, options: DepthOptions | None = None
) -> DepthImage:
    """As :func:`submap_depth`, for several images of one submap; with the same options."""
    if camera.model != "pinhole":
        raise ConfigError(f"depth is drawn into a pinhole camera, got '{camera.model}'")
    options = options or DepthOptions()
    view = _seen_by(scene.surfels, camera, np.asarray(T_cam_node, dtype=np.float64), options)
    drawn = draw(view, camera, options.max_depth_m, options.sigmas, options.slack_m)
    occlusion = draw_occlusion(view, camera, options.max_depth_m)
    if scene.space is not None:
        limits = options.max_depth_m, options.start_m, options.through_m
        occlusion = np.minimum(occlusion, sight_limits(scene.space, camera, T_cam_node, OCCLUSION_STEP, *limits))
    kept = (drawn.depth > 0) & ~_occluded(drawn, occlusion, options)
    kept &= ~((drawn.centre < options.least_centre) & (drawn.behind > drawn.centre))
    # What has no plane is believed where it is closed all around, as a car's corner is and a leaf before a wall is not.
    known = np.where(kept, drawn.depth, np.float32(0))
    closed = cv2.erode(known, np.ones((_CLOSED, _CLOSED), np.uint8)) > np.float32(0.9) * known
    kept &= (drawn.rough < 0.5) | (closed & (drawn.behind == 0))
    kept = _without_specks(kept, options.least_pixels)
    zero = np.float32(0)
    return DepthImage(np.where(kept, drawn.depth, zero), np.where(kept, drawn.sigma, zero))


def _seen_by(surfels: Surfels, camera: Camera, T_cam_node: Array, options: DepthOptions) -> View:
    """The surfels that may fall on the image, in the camera's frame, with their noise."""
    rotation, translation = T_cam_node[:3, :3], T_cam_node[:3, 3]
    points = surfels.points.astype(np.float64) @ rotation.T + translation
    size = np.max(surfels.occluding_reach, axis=1, initial=0.0)
    x, y, z = points.T
    reach = np.maximum(z + size, 0.0)
    kept = (z > 0.3) & (z - size < options.max_depth_m)
    for value, focal, centre, length in (
        (x, camera.fx, camera.cx, camera.width), (y, camera.fy, camera.cy, camera.height)
    ):  # fmt: skip
        kept &= (value + size > (-0.5 - centre) / focal * reach) & (
            value - size < (length - 0.5 - centre) / focal * reach
        )
    rows = np.flatnonzero(kept)
    points = points[rows]
    normals = surfels.normals[rows].astype(np.float64) @ rotation.T
    axes = surfels.axes[rows].astype(np.float64) @ rotation.T
    reach8 = surfels.reach[rows].copy()
    # From its back a surface hides, but the thing behind it may be nearer than what is drawn.
    reach8[np.einsum("ni,ni->n", normals, points) > 0] = 0
    noise = options.noise
    plane = np.any(normals != 0, axis=1)
    away = np.where(plane[:, None], normals, points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-6))
    lever_arm = surfels.origins[rows].astype(np.float64) @ rotation.T + translation
    driven = np.linalg.norm(lever_arm, axis=1)
    along = np.einsum("ni,ni->n", away, lever_arm)
    drift = np.sqrt(
        np.square(noise.along_per_m * along) + noise.across_per_m**2 * np.maximum(driven**2 - along**2, 0.0)
    )
    own = np.where(plane, np.hypot(noise.range_m, noise.surface_m), noise.rough_m).astype(np.float32)
    p, n, a = (np.ascontiguousarray(array, dtype=np.float32) for array in (points, normals, axes))
    return View(p, n, a, reach8, surfels.occluding_reach[rows], own, drift.astype(np.float32))


def _occluded(drawn: Drawn, occlusion: Floats, options: DepthOptions) -> NDArray[np.bool_]:
    """(H, W) where something that hides stands before the depth drawn."""
    height, width = drawn.depth.shape
    limit = np.repeat(np.repeat(occlusion, OCCLUSION_STEP, axis=0), OCCLUSION_STEP, axis=1)[:height, :width]
    return np.asarray(drawn.depth - np.float32(options.occlusion_margin_m) - np.float32(0.02) * drawn.depth > limit)


def _without_specks(kept: NDArray[np.bool_], least: int) -> NDArray[np.bool_]:
    """The pixels of patches of at least so many."""
    if least <= 1:
        return kept
    _, labels, stats, _ = cv2.connectedComponentsWithStats(kept.astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= least
    return kept & large[labels]


def fit_sigma(images: Iterable[DepthImage], bin_m: float = 1.0) -> tuple[float, float, float]:
    """(a, b, c) >= 0 of ``sigma = a + b z + c z^2``, as a camera's ``depth_sigma`` has it.

    Fitted to the root mean square of the sigmas in bins of depth, each weighing by the root of its pixels.
    """
    count, square, total = np.zeros(256), np.zeros(256), np.zeros(256)
    for image in images:
        known = image.depth > 0
        z, sigma = image.depth[known].astype(np.float64), image.sigma[known].astype(np.float64)
        bins = np.minimum((z / bin_m).astype(np.int64), 255)
        count += np.bincount(bins, minlength=256)
        square += np.bincount(bins, sigma**2, minlength=256)
        total += np.bincount(bins, z, minlength=256)
    filled = count > 0
    if not filled.any():
        return 0.0, 0.0, 0.0
    z, rms, weight = (
        (total / np.maximum(count, 1))[filled],
        np.sqrt(square[filled] / count[filled]),
        np.sqrt(count[filled]),
    )
    solution, _ = nnls(np.stack([np.ones_like(z), z, z * z], axis=1) * weight[:, None], rms * weight)
    a, b, c = solution.tolist()
    return a, b, c
