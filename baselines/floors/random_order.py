"""Random rankings, which show the level of chance."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array
from relocbench.retrieval import ImageView

_NUMBERS = 64
"""size of a descriptor; dot products are then practically never equal"""


class RandomOrder:
    """A random direction for each image, determined by its view, its key and the seed.

    Args:
        seed: of the directions.
    """

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed

    def describe(self, images: Sequence[ImageView]) -> NDArray[np.floating]:
        """The descriptors (N, 64) of images, float64 of norm 1; independent of the other images."""
        rows = np.stack([self._direction(f"{image.view}/{image.key}") for image in images])
        return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))

    def _direction(self, name: str) -> Array:
        digest = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")
        return np.random.default_rng([self._seed, digest]).standard_normal(_NUMBERS)
