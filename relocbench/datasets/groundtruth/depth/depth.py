"""Depth of an image from the submap around it, without surfaces that are hidden from the camera.

Points become surfels (:mod:`.surfels`), which are drawn with a z-buffer (:mod:`.rasteriser`). A pixel has no depth
where no surface was scanned, behind a hole in a surface (a window, a dark door), behind leaves and other points without
a plane, behind the back of a surface, behind space in the shadow of what was scanned (:mod:`.sightlines`), and where
the rim of one surface covers the middle of another, since either may be the visible one.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy.optimize import nnls

from relocbench.arrays import Array, Floats, Mask
from relocbench.datasets.groundtruth.depth.rasteriser import OCCLUSION_STEP, Drawn, View, draw, draw_occlusion
from relocbench.datasets.groundtruth.depth.sightlines import TracedSpace, sight_limits, trace_beams
from relocbench.datasets.groundtruth.depth.surfels import SurfelOptions, Surfels, make_surfels
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.errors import ConfigError
from relocbench.geometry import Camera

_CLOSED = 5
"""width in pixels of the window in which depth must be closed"""


@dataclass(frozen=True)
class DepthNoise:
    """Standard deviations of the errors of depth; the defaults are those of a scanner on a car.

    The plane of a surfel has an error of its own, ``sqrt(range^2 + surface^2)``, and one from the odometry between the
    image and the time when it was scanned: ``along`` for each metre driven in the direction of travel, and ``across``
    in the others. Along a ray that meets the plane at an angle, the error of depth is that over the sine of the angle.
    """

    range_m: float = 0.012
    """of a single range measurement; the data sheet of the LMS-151 states 12 mm"""
    surface_m: float = 0.004
    """of the plane: by thinning to one point a voxel, uneven surfaces, and the error of the normal"""
    rough_m: float = 0.05
    """of the depth of a point without a plane"""
    along_per_m: float = 0.008
    """of odometry along the direction of travel, by its scale error"""
    across_per_m: float = 0.001
    """of odometry sideways and in height"""


@dataclass(frozen=True)
class DepthOptions:
    """Options for drawing depth."""

    surfels: SurfelOptions = field(default_factory=SurfelOptions)
    noise: DepthNoise = field(default_factory=DepthNoise)
    max_depth_m: float = 80.0
    sigmas: float = 3.0
    """surfels are one surface if their depths differ by at most so many standard deviations"""
    slack_m: float = 0.02
    """plus so many metres"""
    least_centre: float = 0.15
    """least centrality of a pixel in its surfels, where a surfel behind them is met more centrally"""
    occlusion_margin_m: float = 0.25
    """surfaces further than this, plus 2 % of their depth, behind something that hides are not shown"""
    cell_m: float = 0.3
    """size of the cells of space that are classified by beams"""
    shadow_m: float = 2.5
    """length of the shadow behind a point"""
    through_m: float = 0.3
    """a sight line ends after so much shadow"""
    start_m: float = 2.0
    """space this near to the camera counts as free, since it is the car's own"""
    least_pixels: int = 12
    """least number of pixels of a connected patch of depth"""


@dataclass(frozen=True, eq=False)
class DepthScene:
    """A submap prepared for drawing the depth of any number of images."""

    surfels: Surfels
    space: TracedSpace


@dataclass(frozen=True, eq=False)
class DepthImage:
    """Depth of an image and its standard deviation."""

    depth: Floats
    """(H, W) metres along z, 0 where it is unknown"""
    sigma: Floats
    """(H, W) metres, 0 where depth is unknown"""

    @property
    def coverage(self) -> float:
        """Share of the pixels with depth."""
        return float(np.mean(self.depth > 0))


def make_scene(submap: Submap, options: DepthOptions | None = None) -> DepthScene:
    """The part of drawing depth that does not depend on the camera."""
    options = options or DepthOptions()
    space = trace_beams(submap, options.cell_m, options.max_depth_m, options.shadow_m)
    return DepthScene(make_surfels(submap, options.surfels), space)


def scene_depth(
    scene: DepthScene, camera: Camera, T_cam_node: Array, options: DepthOptions | None = None
) -> DepthImage:
    """Depth of an image taken near the node of a submap, from its scene made with the same options.

    Args:
        camera: a pinhole camera.
        T_cam_node: (4, 4).

    Raises:
        ConfigError: the camera is not a pinhole camera.
    """
    if camera.model != "pinhole":
        raise ConfigError(f"depth needs a pinhole camera, got '{camera.model}'")
    options = options or DepthOptions()
    view = _seen_by(scene.surfels, camera, np.asarray(T_cam_node, dtype=np.float64), options)
    drawn = draw(view, camera, options.max_depth_m, options.sigmas, options.slack_m)
    limits = options.max_depth_m, options.start_m, options.through_m
    in_sight = sight_limits(scene.space, camera, T_cam_node, OCCLUSION_STEP, *limits)
    occlusion = np.minimum(draw_occlusion(view, camera, options.max_depth_m), in_sight)
    kept = (drawn.depth > 0) & ~_occluded(drawn, occlusion, options)
    kept &= ~((drawn.centre < options.least_centre) & (drawn.behind > drawn.centre))
    # Points without a plane are kept where depth is closed around them: a car's corner is, a leaf before a wall is not.
    known = np.where(kept, drawn.depth, np.float32(0))
    closed = cv2.erode(known, np.ones((_CLOSED, _CLOSED), np.uint8)) > np.float32(0.9) * known
    kept &= (drawn.rough < 0.5) | (closed & (drawn.behind == 0))
    kept = _without_specks(kept, options.least_pixels)
    zero = np.float32(0)
    return DepthImage(np.where(kept, drawn.depth, zero), np.where(kept, drawn.sigma, zero))


def _seen_by(surfels: Surfels, camera: Camera, T_cam_node: Array, options: DepthOptions) -> View:
    """The surfels that may be in the image, in the camera's frame, with their noise."""
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
    # A surface seen from its back is not drawn, but it hides what is behind it.
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


def _occluded(drawn: Drawn, occlusion: Floats, options: DepthOptions) -> Mask:
    """(H, W) whether something hides the surface that was drawn."""
    height, width = drawn.depth.shape
    limit = np.repeat(np.repeat(occlusion, OCCLUSION_STEP, axis=0), OCCLUSION_STEP, axis=1)[:height, :width]
    return np.asarray(drawn.depth - np.float32(options.occlusion_margin_m) - np.float32(0.02) * drawn.depth > limit)


def _without_specks(kept: Mask, least: int) -> Mask:
    """The mask (H, W) without connected patches of fewer than ``least`` pixels."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(kept.astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= least
    out: Mask = kept & large[labels]
    return out


def fit_sigma(images: Iterable[DepthImage], bin_m: float = 1.0) -> tuple[float, float, float]:
    """Fit (a, b, c) >= 0 of ``sigma = a + b z + c z^2``, the ``depth_sigma`` of a camera.

    The fit is to the root mean square of the sigmas in bins of depth, each weighted by the root of its pixel count.
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
