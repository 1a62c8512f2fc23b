"""Relocalization by sparse features: keypoints are matched, lifted by the keyframe's depth, and given to PnP."""

from baselines.feature_pnp.tracker import FeaturePnp, OrbPnp, SiftPnp

__all__ = ["FeaturePnp", "OrbPnp", "SiftPnp"]
