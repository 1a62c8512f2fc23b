"""Coarse-to-fine direct image alignment, on intensities or on feature maps."""

from baselines.alignment.depth_map import LevelPoints, coarse_points, sample_points
from baselines.alignment.kernel import linearize
from baselines.alignment.pyramid import Level, image_pyramid, level_camera, require_pinhole, with_gradients
from baselines.alignment.selection import select_pixels
from baselines.alignment.solver import Alignment, LevelOutcome, Settings, align, align_best

__all__ = [
    "Alignment",
    "Level",
    "LevelOutcome",
    "LevelPoints",
    "Settings",
    "align",
    "align_best",
    "coarse_points",
    "image_pyramid",
    "level_camera",
    "linearize",
    "require_pinhole",
    "sample_points",
    "select_pixels",
    "with_gradients",
]
