"""Colour histograms in L*a*b*, compared by the Bhattacharyya coefficient."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from relocbench.arrays import Array
from relocbench.retrieval import ImageView


class ColourHistogram:
    """The square roots of L*a*b* histograms, whose dot product is the Bhattacharyya coefficient.

    Args:
        light: number of cells along L*.
        colour: number of cells along a* and along b*.
    """

    def __init__(self, light: Annotated[int, Field(ge=1)] = 8, colour: Annotated[int, Field(ge=1)] = 16) -> None:
        self._cells = (light, colour, colour)

    def describe(self, images: Sequence[ImageView]) -> NDArray[np.floating]:
        """The descriptors (N, light * colour^2) of images, float64 of norm 1."""
        return np.stack([self._histogram(image) for image in images])

    def _histogram(self, image: ImageView) -> Array:
        lab = cv2.cvtColor(np.ascontiguousarray(image.image), cv2.COLOR_RGB2LAB)
        counts = cv2.calcHist([lab], [0, 1, 2], None, list(self._cells), [0, 256] * 3).ravel().astype(np.float64)
        return np.asarray(np.sqrt(counts / counts.sum()))
