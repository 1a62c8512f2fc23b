"""Bags of visual words (Sivic and Zisserman, "Video Google", ICCV 2003) over ORB features.

    word of a feature     the nearest of K centres of k-means over features of the gallery, bits taken as numbers
    t_i = n_i / n · log(N / N_i)      descriptor = t / ||t||

Of an image's n features n_i are word i, which N_i of the gallery's N images contain. The dot product of descriptors is
their cosine. No labels are used; the vocabulary is that of the gallery, which corresponds to a map.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.cluster.vq import kmeans2

from relocbench.arrays import Array, Floats
from relocbench.errors import MethodError
from relocbench.retrieval import ImageView

_BITS = 256
_ROUNDS = 10
"""iterations of k-means, after which the words hardly change"""
_BORDER = 16
"""pixels without features; OpenCV's default of 31 leaves nothing of an image of 64"""
_FAST_THRESHOLD = 5
"""lower than OpenCV's default of 20, so that features are found in small and dark images"""


class OrbBagOfWords:
    """Tf-idf vectors of ORB words with a vocabulary made from the gallery.

    An image without features, or only with words that all images have, has no descriptor.

    Args:
        words: number of visual words, K.
        features: largest number of features of an image, strongest first.
        sample: largest number of the gallery's features, drawn evenly over its images, that the vocabulary is made
            from.
    """

    def __init__(
        self,
        words: Annotated[int, Field(ge=2)] = 512,
        features: Annotated[int, Field(ge=1)] = 500,
        sample: Annotated[int, Field(ge=2)] = 40_000,
    ) -> None:
        self._words, self._features, self._sample = words, features, sample
        self._centres: Floats | None = None
        self._idf: Array = np.zeros(0)

    def fit(self, gallery: Sequence[ImageView], seed: int) -> None:
        """Make the vocabulary and its weights.

        Raises:
            MethodError: the gallery has fewer than two different features.
        """
        rng = np.random.default_rng(seed)
        each = max(self._sample // max(len(gallery), 1), 1)
        drawn = []
        for number in rng.permutation(len(gallery)):
            found = self._bits(gallery[number])
            drawn.append(found[rng.permutation(len(found))[:each]])
            if sum(map(len, drawn)) >= self._sample:
                break
        features = np.concatenate(drawn) if drawn else np.zeros((0, _BITS), np.float32)
        different = np.unique(features, axis=0)
        if len(different) < 2:
            raise MethodError(f"no vocabulary: ORB finds only {len(different)} different features in the gallery")
        words = min(self._words, len(different))
        start = different[rng.permutation(len(different))[:words]]
        with warnings.catch_warnings(action="ignore"):  # a word without features keeps its place
            self._centres, _ = kmeans2(features, start, iter=_ROUNDS, minit="matrix", missing="warn")
        has = np.zeros(words)
        for image in gallery:
            has += self._counts(image) > 0
        self._idf = np.log(len(gallery) / np.maximum(has, 1.0))

    def describe(self, images: Sequence[ImageView]) -> NDArray[np.floating]:
        """The descriptors (N, K) of images, float64 of norm 1; NaN for an image without one.

        Raises:
            MethodError: ``fit`` was not called.
        """
        if self._centres is None:
            raise MethodError("orb-bow has no vocabulary yet: call fit() before describe()")
        rows = np.stack([self._counts(image) for image in images]) * self._idf
        norms = np.linalg.norm(rows, axis=1, keepdims=True)
        out: NDArray[np.floating] = np.divide(rows, norms, out=np.full_like(rows, np.nan), where=norms > 0)
        return out

    def _counts(self, image: ImageView) -> Array:
        """The share (K,) of an image's features that each word has; zeros if it has no features."""
        assert self._centres is not None
        found, centres = self._bits(image), self._centres
        # The nearest centre c minimises ||f - c||^2 - ||f||^2.
        nearest = np.argmin(np.sum(centres**2, axis=1) - 2.0 * found @ centres.T, axis=1)
        counts = np.bincount(nearest, minlength=len(centres)).astype(np.float64)
        return np.asarray(counts / max(len(found), 1))

    def _bits(self, image: ImageView) -> Floats:
        """The ORB descriptors (n, 256) as bits, in an order that does not depend on the detector's threads."""
        grey = cv2.cvtColor(np.ascontiguousarray(image.image), cv2.COLOR_RGB2GRAY)
        orb = cv2.ORB.create(nfeatures=self._features, edgeThreshold=_BORDER, fastThreshold=_FAST_THRESHOLD)
        keypoints, descriptors = orb.detectAndCompute(grey, None)
        if not keypoints:
            return np.zeros((0, _BITS), np.float32)
        order = np.lexsort(([k.octave for k in keypoints], *np.array([k.pt for k in keypoints]).T,
                            [-k.response for k in keypoints]))  # fmt: skip
        return np.unpackbits(np.asarray(descriptors[order], dtype=np.uint8), axis=1).astype(np.float32)
