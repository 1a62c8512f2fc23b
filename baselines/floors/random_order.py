"""Chance: a ranking that knows nothing."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from relocbench.retrieval import ImageView

_NUMBERS = 64
"""of a descriptor: dot products of two are as good as never equal"""


class RandomOrder:
    """A random direction for each image, by its key and the seed; no image is looked at.

    Args:
        seed: of the directions.
    """

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed

    def describe(self, images: Sequence[ImageView]) -> NDArray[np.floating]:
        """(N, 64) float64, norm 1; the same whatever else is asked about."""
        rows = np.stack([self._direction(f"{image.view}/{image.key}") for image in images])
        return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))

    def _direction(self, name: str) -> NDArray[np.float64]:
        digest = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")
        return np.random.default_rng([self._seed, digest]).standard_normal(_NUMBERS)
