"""Matches that methods tell of a pair, as the page of the pair draws them.

A method may tell some of its matches in ``info["shown_matches"]``: a list of ``[u, v of the keyframe, u, v of the
query, 1 if it agrees with the answer, else 0]``, in pixels of the images that it was given.
"""

from __future__ import annotations

import json

import numpy as np

from relocbench.arrays import Array
from relocbench.geometry import Camera
from relocbench.leaderboard.html.pair_page.pictures import small_camera

KEY = "shown_matches"
MOST = 500
"""matches at most that are drawn of one answer"""


def shown_matches(info: str, reference: Camera, query: Camera) -> list[list[float]]:
    """The matches of an answer in pixels of the small pictures, without those that a picture does not show.

    Args:
        info: of the answer, JSON.
        reference, query: the cameras of both images.
    """
    matches = _stated(info)
    if not len(matches):
        return []
    of_reference, seen = reference.undistort(matches[:, :2], small_camera(reference))
    of_query, also_seen = query.undistort(matches[:, 2:4], small_camera(query))
    pixels = np.hstack([of_reference, of_query]).round(1)[seen & also_seen].tolist()
    agrees = (matches[seen & also_seen, 4] > 0.5).astype(int).tolist()
    return [[*both, one] for both, one in zip(pixels, agrees, strict=True)]


def _stated(info: str) -> Array:
    """(N, 5) the matches of an info; (0, 5) where it holds none that can be read."""
    none = np.zeros((0, 5))
    if KEY not in info:
        return none
    try:
        matches = np.array(json.loads(info).get(KEY, [])[:MOST], dtype=np.float64)
    except (ValueError, TypeError, AttributeError, OverflowError):
        return none
    return matches if matches.shape[1:] == (5,) and np.isfinite(matches).all() else none
