"""Relocalization by sparse features: match keypoints, lift the keyframe's by its depth, solve perspective-n-point."""

from baselines.feature_pnp.tracker import OrbPnp, PreparedReference, SiftPnp

__all__ = ["OrbPnp", "PreparedReference", "SiftPnp"]
