"""Matching of descriptors of norm 1."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Floats, Indices


def mutual_nearest(first: Floats, second: Floats, ratio: float = 1.0) -> Indices:
    """Match descriptors (N, D) and (M, D) of norm 1 that are each other's nearest neighbour.

    Args:
        ratio: a match is accepted below this ratio of the nearest to the second nearest distance, as seen from
            ``first``; 1 accepts all.

    Returns:
        Indices (K, 2) into both, in the order of ``first``.
    """
    if len(first) == 0 or len(second) == 0:
        return np.zeros((0, 2), dtype=np.intp)
    similarity = first @ second.T
    nearest, back = similarity.argmax(axis=1), similarity.argmax(axis=0)
    here = np.arange(len(first))
    accepted = back[nearest] == here
    if ratio < 1.0 and len(second) > 1:
        two = -np.partition(-similarity, 1, axis=1)[:, :2].astype(np.float64)
        distance = np.sqrt(np.maximum(2.0 - 2.0 * two, 0.0))  # of vectors of norm 1
        accepted &= distance[:, 0] < ratio * distance[:, 1]
    index = np.flatnonzero(accepted)
    return np.stack([index, nearest[index]], axis=-1)
