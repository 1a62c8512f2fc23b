"""The choice of a keyframe's pixels that are aligned."""

from __future__ import annotations

import numpy as np

from baselines.alignment.shared.pyramid import Level
from baselines.alignment.shared.selection import select_pixels
from relocbench.tracking import KeyframePoints, Reference


def choose_points(reference: Reference, levels: list[Level], count: int, rng: np.random.Generator) -> KeyframePoints:
    """All points of a sparse map, or about ``count`` pixels of large gradient of a dense depth image.

    Args:
        reference: the keyframe.
        levels: its intensity pyramid, finest first.
        count: number of pixels wanted.
        rng: source of the random choices.
    """
    if reference.sparse_points is not None or reference.depth is None:
        return reference.points
    known = np.isfinite(reference.depth) & (reference.depth > 0)
    uv = select_pixels(levels, known, count, rng)
    z = reference.depth[uv[:, 1], uv[:, 0]].astype(np.float64)
    a, b, c = reference.depth_sigma
    return KeyframePoints(uv.astype(np.float64), 1.0 / z, (a + b * z + c * z * z) / (z * z))
