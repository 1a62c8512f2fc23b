"""Relocalization by learned local features: the networks come from kornia, the pose from ``feature_pnp``."""

from baselines.learned_pnp.trackers import AlikedPnp

__all__ = ["AlikedPnp"]
