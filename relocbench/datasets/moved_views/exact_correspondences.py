"""Exact correspondences of a keyframe and a query of one photograph: nothing is read and nothing is rounded."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Image, Mask
from relocbench.datasets.core.images import MOST_DEPTH_M
from relocbench.datasets.moved_views.drawing import Keyframe, View
from relocbench.datasets.moved_views.surfaces import seen_at, shown_at
from relocbench.datasets.pairs.correspondences import PairCorrespondences, exact_pair, sampled_pixels
from relocbench.tracking import Reference

_SAME_PX = 1e-3
"""between a pixel and the one that the query shows where the pixel's point lies, if nothing hides that"""


def exact_correspondences(
    keyframe: Keyframe,
    reference: Reference,
    query_image: Image,
    view: View,
    count: int,
    rng: np.random.Generator,
    without: Mask | None = None,
) -> PairCorrespondences:
    """Up to ``count`` correspondences of a pair, spread over the keyframe, and the pair's measures.

    They are sampled from the pixels that show something and whose point projects into the query's image, visible or
    hidden by another part of the surface.

    Args:
        without: (H, W) pixels of the keyframe that have no correspondences either.
    """
    surface, cameras = keyframe.surface, (keyframe.camera, view.camera)
    pixels = sampled_pixels(keyframe.camera, count, rng)
    if without is not None:
        pixels = pixels[~without[*pixels[:, ::-1].astype(int).T]]
    pixels = pixels[keyframe.content(pixels)]
    uv_query, depth, _ = shown_at(surface, *cameras, view.T_query_ref, pixels)
    inside = view.camera.contains(uv_query) & (depth <= MOST_DEPTH_M)
    visible = inside.copy()
    seen = seen_at(surface, *cameras, view.T_query_ref, uv_query[inside])
    # Not a number, where a ray meets nothing, is not the same either.
    visible[inside] = np.linalg.norm(seen - pixels[inside], axis=1) <= _SAME_PX
    # What the query shows is always a surface that the photograph shows, within the keyframe or around it.
    sampled = sampled_pixels(view.camera, 0, np.random.default_rng(0))
    sampled = sampled[keyframe.content(sampled, view)]
    shown = seen_at(surface, *cameras, view.T_query_ref, sampled)
    back = float(np.mean(keyframe.camera.contains(np.nan_to_num(shown, nan=-1.0)))) if len(shown) else None
    found = pixels, depth, uv_query, inside, visible
    return exact_pair(reference, *found, count, rng, view.camera, view.T_query_ref, back, query_image)
