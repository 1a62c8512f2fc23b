"""Exact correspondences of a keyframe and a query of one photograph: nothing is read and nothing is rounded."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.images import DEPTH_SCALE
from relocbench.datasets.moved_views.drawing import Keyframe
from relocbench.datasets.moved_views.surfaces import seen_at, shown_at
from relocbench.datasets.pairs.correspondences import PairCorrespondences, spread_sample
from relocbench.datasets.pairs.visibility import CHECKS

_SAMPLES = 8192
"""pixels that are sampled for a pair's overlap, which is then accurate to 0.006 (one sigma)"""
_SAME_PX = 1e-3
"""between a pixel and the one that the query shows where the pixel's point lies, if nothing hides that"""
_FARTHEST_M = 65535 / DEPTH_SCALE
"""greatest depth that can be stored"""


def exact_correspondences(
    keyframe: Keyframe, T_query_ref: Array, count: int, rng: np.random.Generator
) -> PairCorrespondences:
    """Up to ``count`` correspondences of a pair, spread over the keyframe, and the pair's overlap.

    They are sampled from the pixels whose point projects into the query's image, visible or hidden by another part of
    the surface.
    """
    camera, surface = keyframe.camera, keyframe.surface
    size = camera.width * camera.height
    drawn = np.sort(rng.choice(size, min(size, max(_SAMPLES, 4 * count)), replace=False))
    pixels = np.column_stack([drawn % camera.width, drawn // camera.width]).astype(np.float64)
    uv_query, depth, _ = shown_at(surface, camera, camera, T_query_ref, pixels)
    inside = camera.contains(uv_query) & (depth <= _FARTHEST_M)
    visible = inside.copy()
    seen = seen_at(surface, camera, camera, T_query_ref, uv_query[inside])
    # Not a number, where a ray meets nothing, is not the same either.
    visible[inside] = np.linalg.norm(seen - pixels[inside], axis=1) <= _SAME_PX
    candidates = np.nonzero(inside)[0]
    rows = candidates[spread_sample(pixels[candidates], camera, count, rng)]
    check = np.full(len(rows), CHECKS.index("both"), dtype=np.int8)
    overlap = float(np.mean(visible))
    return PairCorrespondences(pixels[rows], depth[rows], uv_query[rows], visible[rows], check, overlap)
