"""Coarse-to-fine direct image alignment, on intensities or on feature maps."""

from baselines.alignment.depth_map import LevelPoints, coarse_points, sample_points
from baselines.alignment.feature_pyramid import FeatureLevel, FeaturePyramid
from baselines.alignment.feature_reference import FeaturePoints, ReferenceFeatures
from baselines.alignment.feature_settings import DSO_DAMPING, LM_RELOC_DAMPING, Damping, FeatureSettings
from baselines.alignment.feature_solver import FeatureAlignment, align_features, align_features_best
from baselines.alignment.kernel import linearize
from baselines.alignment.keyframe import choose_points
from baselines.alignment.matching import DSO_PATTERN, SINGLE_PIXEL, MatchSettings, match_pixels, match_pixels_by_level
from baselines.alignment.pyramid import Level, image_pyramid, level_camera, require_pinhole, with_gradients
from baselines.alignment.selection import select_pixels
from baselines.alignment.solver import Alignment, LevelOutcome, Settings, align, align_best
from baselines.alignment.starts import Start, small_rotations

__all__ = [
    "DSO_DAMPING",
    "DSO_PATTERN",
    "LM_RELOC_DAMPING",
    "SINGLE_PIXEL",
    "Alignment",
    "Damping",
    "FeatureAlignment",
    "FeatureLevel",
    "FeaturePoints",
    "FeaturePyramid",
    "FeatureSettings",
    "Level",
    "LevelOutcome",
    "LevelPoints",
    "MatchSettings",
    "ReferenceFeatures",
    "Settings",
    "Start",
    "align",
    "align_best",
    "align_features",
    "align_features_best",
    "choose_points",
    "coarse_points",
    "image_pyramid",
    "level_camera",
    "linearize",
    "match_pixels",
    "match_pixels_by_level",
    "require_pinhole",
    "sample_points",
    "select_pixels",
    "small_rotations",
    "with_gradients",
]
