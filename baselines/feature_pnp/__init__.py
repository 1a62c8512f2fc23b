"""Relocalization by sparse features: keypoints are matched, lifted by the keyframe's depth, and given to PnP."""

from baselines.feature_pnp.pnp import Pnp, PreparedKeyframe
from baselines.feature_pnp.tracker import FeaturePnp, OrbPnp, PreparedReference, SiftPnp

__all__ = ["FeaturePnp", "OrbPnp", "Pnp", "PreparedKeyframe", "PreparedReference", "SiftPnp"]
