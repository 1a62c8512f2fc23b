"""Bags of visual words (Sivic and Zisserman, "Video Google", ICCV 2003) over ORB features.

    word of a feature     nearest of K centres of k-means over features of the gallery, bits as numbers
    t_i = n_i / n · log(N / N_i)      descriptor = t / ||t||

n_i of an image's n features are word i, which N_i of the gallery's N images have. The dot product is the cosine. No
label is used: the vocabulary is of the gallery, as a map would be made.
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

from relocbench.errors import MethodError
from relocbench.retrieval import ImageView

Words = NDArray[np.float32]
_BITS = 256
_ROUNDS = 10
"""of k-means: words hardly move after them"""
_BORDER = 16
"""pixels without features; OpenCV's 31 leave nothing of an image of 64"""
_FAST_THRESHOLD = 5
"""lower than OpenCV's 20: small and dim images have corners too"""


class OrbBagOfWords:
    """Tf-idf vectors of ORB words; the vocabulary is made of the gallery.

    An image without any feature, or with none but words that all images have, is not described.

    Args:
        words: K.
        features: at most so many of an image, strongest first.
        sample: at most so many features of the whole gallery, drawn evenly over its images, make the vocabulary.
    """

    def __init__(
        self,
        words: Annotated[int, Field(ge=2)] = 512,
        features: Annotated[int, Field(ge=1)] = 500,
        sample: Annotated[int, Field(ge=2)] = 40_000,
    ) -> None:
        self._words, self._features, self._sample = words, features, sample
        self._centres: Words | None = None
        self._idf: NDArray[np.float64] = np.zeros(0)

    def fit(self, gallery: Sequence[ImageView], seed: int) -> None:
        """Make vocabulary and weights.

        Raises:
            MethodError: the gallery's images have no features.
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
            raise MethodError(f"no vocabulary: ORB finds {len(different)} different features in the whole gallery")
        words = min(self._words, len(different))
        start = different[rng.permutation(len(different))[:words]]
        with warnings.catch_warnings(action="ignore"):  # a word that nothing is nearest to stays where it was
            self._centres, _ = kmeans2(features, start, iter=_ROUNDS, minit="matrix", missing="warn")
        has = np.zeros(words)
        for image in gallery:
            has += self._counts(image) > 0
        self._idf = np.log(len(gallery) / np.maximum(has, 1.0))

    def describe(self, images: Sequence[ImageView]) -> NDArray[np.floating]:
        """(N, K) float64, norm 1; NaN for an image that has nothing to be described by.

        Raises:
            MethodError: there is no vocabulary yet.
        """
        if self._centres is None:
            raise MethodError("orb-bow has no vocabulary yet: fit() comes before describe()")
        rows = np.stack([self._counts(image) for image in images]) * self._idf
        norms = np.linalg.norm(rows, axis=1, keepdims=True)
        return np.divide(rows, norms, out=np.full_like(rows, np.nan), where=norms > 0)

    def _counts(self, image: ImageView) -> NDArray[np.float64]:
        """(K,) share of an image's features that are each word; zeros where it has none."""
        assert self._centres is not None
        found, centres = self._bits(image), self._centres
        # ||f - c||^2 less ||f||^2, which is the same for all words.
        nearest = np.argmin(np.sum(centres**2, axis=1) - 2.0 * found @ centres.T, axis=1)
        counts = np.bincount(nearest, minlength=len(centres)).astype(np.float64)
        return np.asarray(counts / max(len(found), 1))

    def _bits(self, image: ImageView) -> Words:
        """(n, 256) descriptors, strongest first and then by place: the detector's order may depend on its threads."""
        grey = cv2.cvtColor(np.ascontiguousarray(image.image), cv2.COLOR_RGB2GRAY)
        orb = cv2.ORB.create(nfeatures=self._features, edgeThreshold=_BORDER, fastThreshold=_FAST_THRESHOLD)
        keypoints, descriptors = orb.detectAndCompute(grey, None)
        if not keypoints:
            return np.zeros((0, _BITS), np.float32)
        order = np.lexsort(([k.octave for k in keypoints], *np.array([k.pt for k in keypoints]).T,
                            [-k.response for k in keypoints]))  # fmt: skip
        return np.unpackbits(np.asarray(descriptors[order], dtype=np.uint8), axis=1).astype(np.float32)
