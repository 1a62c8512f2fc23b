"""Relocalization by sparse features: keypoints are matched, lifted by the keyframe's depth, and given to PnP."""

from baselines.feature_pnp.tracker import OrbPnp, PreparedReference, SiftPnp

__all__ = ["OrbPnp", "PreparedReference", "SiftPnp"]
