"""Relocalization by learned local features: most networks come from kornia, the pose from ``feature_pnp``."""

from baselines.learned_pnp.lightglue import AlikedLightGluePnp, DiskLightGluePnp, SuperPointLightGluePnp
from baselines.learned_pnp.loftr import LoftrPnp
from baselines.learned_pnp.trackers import AlikedPnp, DiskPnp, SuperPointPnp, XFeatPnp

__all__ = [
    "AlikedLightGluePnp",
    "AlikedPnp",
    "DiskLightGluePnp",
    "DiskPnp",
    "LoftrPnp",
    "SuperPointLightGluePnp",
    "SuperPointPnp",
    "XFeatPnp",
]
