"""Probing single pixels: whether the method's per-pixel Gauss-Newton converges to the true pixel, and from how far.

Each pixel is started once, 0 to 16 px from the true pixel of a ground-truth correspondence, in a random direction. A
method that uses an image pyramid is asked again for each level alone, from the same starts. A coarse level cannot
locate a pixel of the image to 1 px, so that ends within 1 px *of the level* are counted there as well.

Most pixels of a street are road, wall and sky, while trackers select pixels with structure. ``with_structure`` keeps
those alone: they depend on the keyframe's image, so that they are the same for every method.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Image
from relocbench.datasets.core.pairfile import PairKey
from relocbench.datasets.pairs.correspondences import Correspondences
from relocbench.evaluation.isolation.handles import TrackerHandle
from relocbench.evaluation.probe.tally import Tally
from relocbench.evaluation.tracking.matching import Starts, draw_starts
from relocbench.tracking import Query

OFFSETS_PX = (0, 1, 2, 4, 8, 16)
NEAR = "match@1px"
NEAR_ON_LEVEL = "match@1levelpx"
_WITHIN_PX = {NEAR: 1.0, "match@3px": 3.0}
_DIGITS = 6
"""Distances are rounded to 1e-6 px, so that a start drawn 1 px from the truth counts as within 1 px."""


def probe_pixels(
    tracker: TrackerHandle | None, query: Query, known: Correspondences, key: PairKey, per_pair: int, seed: int
) -> tuple[list[Tally], str]:
    """Probe the pixels of one pair.

    Args:
        tracker: prepared for the keyframe; None if it crashed on it, in which case it is not run.

    Returns:
        the tallies, none with fewer visible correspondences than there are offsets; and how the method crashed, empty
        if it did not. A method that crashes has found nothing.
    """
    starts = draw_starts(known, query.camera, key, per_pair, OFFSETS_PX, seed)
    if len(starts) < len(OFFSETS_PX):
        return [], ""
    if tracker is None:
        return [_tally(None, starts, None)], ""
    ends, crash = tracker.match(query, starts.uv_ref, starts.uv_start)
    tallies = [_tally(None, starts, ends)]
    if not tracker.declared.levels:
        return tallies, crash or ""
    levels, crash_too = tracker.match_levels(query, starts.uv_ref, starts.uv_start)
    tallies += [_tally(level, starts, e) for level, e in enumerate(levels)]
    return tallies, crash or crash_too or ""


def with_structure(known: Correspondences, image: Image, share: float) -> Correspondences:
    """Keep the given share of the visible correspondences, those whose keyframe pixel has the most structure.

    Structure is the smaller eigenvalue of the image's structure tensor over 5 x 5 pixels (Shi and Tomasi, 1994). The
    other correspondences remain in the result as not visible.
    """
    rows = np.nonzero(known.visible)[0]
    if share >= 1 or not len(rows):
        return known
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    structure = np.asarray(cv2.cornerMinEigenVal(grey, blockSize=5, ksize=3))
    u, v = np.rint(known.uv_ref[rows]).astype(int).T
    found = structure[np.clip(v, 0, grey.shape[0] - 1), np.clip(u, 0, grey.shape[1] - 1)]
    kept = np.zeros(len(known), dtype=np.bool_)
    kept[rows[np.argsort(-found, kind="stable")[: max(1, round(share * len(rows)))]]] = True
    return replace(known, visible=kept)


def level_names() -> tuple[str, ...]:
    """The criteria that are counted on a single level."""
    return (*_WITHIN_PX, NEAR_ON_LEVEL)


def _tally(level: int | None, starts: Starts, ends: Array | None) -> Tally:
    where = np.full((len(starts), 2), np.nan) if ends is None else ends
    distance = np.round(np.linalg.norm(where - starts.uv_query, axis=1), _DIGITS)  # NaN is near nothing
    within = dict(_WITHIN_PX) if level is None else {**_WITHIN_PX, NEAR_ON_LEVEL: float(1 << level)}

    def by_offset(lengths: NDArray[Any], px: float) -> tuple[int, ...]:
        return tuple(int(np.sum(lengths[starts.offset_px == offset] <= px)) for offset in OFFSETS_PX)

    return Tally(
        "pixels",
        level,
        OFFSETS_PX,
        by_offset(starts.offset_px, np.inf),
        by_offset(distance, np.inf),
        {name: by_offset(distance, px) for name, px in within.items()},
        {name: by_offset(starts.offset_px, px) for name, px in within.items()},
    )
