"""Coarse-to-fine direct image alignment, on intensities or on feature maps."""

from baselines.alignment.depth_map import LevelPoints, coarse_points, sample_points
from baselines.alignment.kernel import linearize
from baselines.alignment.matching import DSO_PATTERN, SINGLE_PIXEL, MatchSettings, match_pixels
from baselines.alignment.pyramid import Level, image_pyramid, level_camera, require_pinhole, with_gradients
from baselines.alignment.selection import select_pixels
from baselines.alignment.solver import Alignment, LevelOutcome, Settings, align, align_best

__all__ = [
    "DSO_PATTERN",
    "SINGLE_PIXEL",
    "Alignment",
    "Level",
    "LevelOutcome",
    "LevelPoints",
    "MatchSettings",
    "Settings",
    "align",
    "align_best",
    "coarse_points",
    "image_pyramid",
    "level_camera",
    "linearize",
    "match_pixels",
    "require_pinhole",
    "sample_points",
    "select_pixels",
    "with_gradients",
]
