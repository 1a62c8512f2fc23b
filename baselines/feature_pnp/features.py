"""Detection, even distribution and matching of keypoints with descriptors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Image, Indices

FeatureKind = Literal["orb", "sift"]

_OVERSAMPLING = 4  # keypoints detected for each one kept, so that weakly textured cells have some too
_ORB_SCALE, _ORB_LEVELS, _ORB_FAST_THRESHOLD = 1.2, 8, 5
_SIFT_CONTRAST, _SIFT_SIGMA = 0.01, 1.6


@dataclass(frozen=True, eq=False)
class Features:
    """Keypoints of one image with their descriptors."""

    uv: Array
    """(N, 2) pixels, centres at integers"""
    scale: Array
    """(N,) size, in image pixels, of a pixel of the pyramid level that it was found on; the unit of its accuracy"""
    response: Array
    """(N,) strength of the detector's response"""
    descriptors: NDArray[Any]
    """(N, D) float32, or uint8 (ORB)"""
    size: tuple[int, int]
    """width and height of the image, pixels"""

    def __len__(self) -> int:
        return len(self.uv)

    def take(self, indices: Indices) -> Features:
        """The features at ``indices``, in that order."""
        chosen = (self.uv[indices], self.scale[indices], self.response[indices], self.descriptors[indices])
        return Features(*chosen, self.size)


def to_grey(image: Image) -> Image:
    """The grey values (H, W) of a grey (H, W) or (H, W, 1) or an RGB (H, W, 3) image."""
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    if image.shape[2] == 1:
        return np.ascontiguousarray(image[..., 0])
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def detect(image: Image, kind: FeatureKind, budget: int) -> Features:
    """Up to four times ``budget`` features, strongest first, for :func:`spread_evenly` to choose from."""
    grey = to_grey(image)
    if kind == "orb":
        detector: Any = cv2.ORB.create(
            nfeatures=_OVERSAMPLING * budget,
            scaleFactor=_ORB_SCALE,
            nlevels=_ORB_LEVELS,
            fastThreshold=_ORB_FAST_THRESHOLD,
        )
    else:
        detector = cv2.SIFT.create(
            nfeatures=_OVERSAMPLING * budget,
            contrastThreshold=_SIFT_CONTRAST,
            sigma=_SIFT_SIGMA,
            enable_precise_upscale=True,  # without it every keypoint is a quarter of a pixel off
        )
    keypoints, descriptors = detector.detectAndCompute(grey, None)
    image_size = grey.shape[1], grey.shape[0]
    if not keypoints:
        width = detector.descriptorSize()
        dtype = np.uint8 if kind == "orb" else np.float32
        return Features(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, width), dtype), image_size)
    uv = np.array([k.pt for k in keypoints], dtype=np.float64)
    octave = np.array([k.octave for k in keypoints])
    response = np.array([k.response for k in keypoints], dtype=np.float64)
    if kind == "orb":
        scale = _ORB_SCALE ** octave.astype(np.float64)
        # OpenCV multiplies level coordinates by the nominal scale. With pixel centres at integers, it should be
        # (u + 0.5) s - 0.5 with s from the level's rounded size: a difference of a pixel on the coarsest level.
        size = np.array(image_size, dtype=np.float64)
        level_size = np.rint(size / scale[:, None])
        uv = (uv / scale[:, None] + 0.5) * (size / level_size) - 0.5
    else:
        # The size of a SIFT keypoint is the diameter of its blur, 2 sigma_0 at the image's own resolution.
        scale = np.array([k.size for k in keypoints], dtype=np.float64) / (2 * _SIFT_SIGMA)
    features = Features(uv, np.maximum(scale, 1.0), response, descriptors, image_size)
    # The detector's order may depend on its threads, this order does not.
    return features.take(np.lexsort((scale, uv[:, 0], uv[:, 1], -response)))


def spread_evenly(features: Features, cell_px: int, budget: int) -> Indices:
    """The indices of at most ``budget`` features: the strongest of each grid cell, then the second strongest, and so
    on.

    Args:
        features: strongest first, as :func:`detect` returns them.
        cell_px: side of a grid cell in pixels.
        budget: largest number of features.
    """
    if len(features) <= budget:
        return np.arange(len(features))
    column, row = (features.uv // cell_px).astype(int).T
    cell = row * (column.max() + 1) + column
    by_cell = np.argsort(cell, kind="stable")
    sorted_cell = cell[by_cell]
    rank = np.empty(len(cell), dtype=int)
    rank[by_cell] = np.arange(len(cell)) - np.searchsorted(sorted_cell, sorted_cell, side="left")
    chosen = np.argsort(rank, kind="stable")[:budget]
    return np.sort(chosen)


def match(first: Features, second: Features, ratio: float, mutual: bool) -> Indices:
    """Match each descriptor of ``first`` to its nearest neighbour in ``second``, if it is distinctive.

    Args:
        first, second: features of one kind.
        ratio: of Lowe's test (IJCV 2004): the largest ratio of the nearest to the second nearest distance.
        mutual: keep only mutual nearest neighbours.

    Returns:
        Indices (M, 2) into ``first`` and ``second``, the most distinctive match first; each feature of ``second``
        occurs at most once.
    """
    if len(first) == 0 or len(second) < 2:
        return np.zeros((0, 2), dtype=np.intp)
    hamming = first.descriptors.dtype == np.uint8
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING if hamming else cv2.NORM_L2)
    two = matcher.knnMatch(first.descriptors, second.descriptors, k=2)
    best, second_best = np.array([[m.distance, n.distance] for m, n in two]).T
    nearest = np.array([m.trainIdx for m, _ in two])
    accepted = best < ratio * second_best
    index = np.flatnonzero(accepted)
    if mutual and index.size:
        # Only matches that passed the ratio test are checked.
        back = matcher.match(second.descriptors[nearest[index]], first.descriptors)
        index = index[np.array([m.trainIdx for m in back]) == index]
    score = best[index] / np.maximum(second_best[index], 1e-12)
    order = np.lexsort((index, score))
    index = index[order]
    _, once = np.unique(nearest[index], return_index=True)  # the most distinctive match of each feature
    once = np.sort(once)
    return np.stack([index[once], nearest[index[once]]], axis=-1)
