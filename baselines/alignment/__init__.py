"""Coarse-to-fine image alignment: the pose of a query relative to a reference whose depth is known at some pixels.

``direct`` aligns intensities together with affine brightness parameters (DSO); ``features`` aligns maps of D channels
(GN-Net). Neither imports the other; both use the warp, the normal equations and the Levenberg-Marquardt loop of
``shared``. ``matching`` finds single pixels instead of a pose.
"""

from baselines.alignment.direct.kernel import linearize
from baselines.alignment.direct.settings import Settings
from baselines.alignment.direct.solver import Alignment, align, align_best
from baselines.alignment.features.pyramid import FeaturePyramid
from baselines.alignment.features.reference import ReferenceFeatures
from baselines.alignment.features.settings import LM_RELOC_DAMPING, FeatureSettings
from baselines.alignment.features.solver import FeatureAlignment, align_features, align_features_best, coarsest_level
from baselines.alignment.matching import DSO_PATTERN, SINGLE_PIXEL, MatchSettings, match_pixels, match_pixels_by_level
from baselines.alignment.shared.damping import DSO_DAMPING
from baselines.alignment.shared.depth_map import LevelPoints, coarse_points, sample_points
from baselines.alignment.shared.levels import ABANDON_FACTOR
from baselines.alignment.shared.pyramid import Level, image_pyramid, level_camera, require_pinhole, with_gradients
from baselines.alignment.shared.selection import choose_points, select_pixels
from baselines.alignment.shared.starts import Start, moved_along, small_rotations

__all__ = [
    "ABANDON_FACTOR",
    "DSO_DAMPING",
    "DSO_PATTERN",
    "LM_RELOC_DAMPING",
    "SINGLE_PIXEL",
    "Alignment",
    "FeatureAlignment",
    "FeaturePyramid",
    "FeatureSettings",
    "Level",
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
    "coarsest_level",
    "image_pyramid",
    "level_camera",
    "linearize",
    "match_pixels",
    "match_pixels_by_level",
    "moved_along",
    "require_pinhole",
    "sample_points",
    "select_pixels",
    "small_rotations",
    "with_gradients",
]
