"""Square crops of both images of a pair that show about the same part of the world, and their correspondences.

Pixel centres are at integers, so that scaling an image by s maps pixel u to (u + 0.5) s - 0.5.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Floats, Image, Indices, Mask

Pixels = Floats


class Cut(NamedTuple):
    """The crops of a pair."""

    image_ref: Image
    """(S, S, 3)"""
    image_query: Image
    """(S, S, 3)"""
    u_ref: Pixels
    """(N, 2) pixels of the crop, between its first and last pixel centres"""
    u_query: Pixels
    """(N, 2)"""
    u_still: Pixels
    """(N, 2) pixels of the query's crop, or beside it, that are at the place of ``u_ref`` in the whole image"""
    kept: Mask
    """(M,) bool: which of the given correspondences both crops hold"""
    scale_query: Array
    """(2,) by which the query was scaled along u and v"""
    corner_query: Indices
    """(2,) pixel of the scaled query at the crop's first pixel"""


def cut_pair(
    image_ref: Image,
    image_query: Image,
    u_ref: Pixels,
    u_query: Pixels,
    side: int,
    scale: tuple[float, float],
    apart: float,
    rng: np.random.Generator,
) -> Cut:
    """Scale both images by one factor, crop a square from each, and keep the correspondences that both hold.

    The reference's square contains a random correspondence. The query's square follows the median shift of the
    correspondences in the reference's, and is then moved by a random offset. Without the offset a point would be at
    about the same place in both squares; as padding tells a network where in its image a pixel is, features of the
    place alone would then distinguish all points. An image smaller than the square is continued at the right and below
    by repeating its last column and row.

    Args:
        image_ref, image_query: (H, W, 3).
        u_ref, u_query: (N, 2) pixels that see the same points.
        side: S, pixels.
        scale: smallest and largest factor.
        apart: the largest offset of the query's square along u and v, as a share of the side.
        rng: source of the factor and the positions.
    """
    factor = float(rng.uniform(*scale))
    size_query = np.array(image_query.shape[1::-1])
    image_ref, u_ref = scaled(image_ref, u_ref, factor)
    image_query, u_query = scaled(image_query, u_query, factor)
    centre = u_ref[rng.integers(len(u_ref))] if len(u_ref) else np.array(image_ref.shape[1::-1]) / 2
    corner_ref = _inside(np.floor(centre - rng.uniform(0, side, 2)), image_ref, side)
    shift = np.median((u_query - u_ref)[_within(u_ref - corner_ref, side)], axis=0) if len(u_ref) else np.zeros(2)
    corner_query = _inside(np.rint(corner_ref + shift + apart * side * rng.uniform(-1, 1, 2)), image_query, side)
    in_ref, in_query = u_ref - corner_ref.astype(np.float32), u_query - corner_query.astype(np.float32)
    kept = _within(in_ref, side) & _within(in_query, side)
    return Cut(
        _cut(image_ref, corner_ref, side),
        _cut(image_query, corner_query, side),
        in_ref[kept].astype(np.float32),
        in_query[kept].astype(np.float32),
        (u_ref[kept] - corner_query).astype(np.float32),
        kept,
        np.array(image_query.shape[1::-1]) / size_query,
        corner_query,
    )


def scaled(image: Image, u: Pixels, factor: float) -> tuple[Image, Pixels]:
    """An image scaled by about ``factor``, to a size of whole pixels, and the scaled positions of pixels (N, 2)."""
    height, width = image.shape[:2]
    size = max(round(width * factor), 1), max(round(height * factor), 1)
    if size == (width, height):
        return image, u
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR)
    exact = np.array([size[0] / width, size[1] / height])
    return np.asarray(small, dtype=np.uint8), ((u + 0.5) * exact - 0.5).astype(np.float32)


def mirrored(image: Image, u: Pixels) -> tuple[Image, Pixels]:
    """An image mirrored left to right, and the mirrored positions of pixels (N, 2)."""
    uv_mirrored = np.stack([image.shape[1] - 1 - u[:, 0], u[:, 1]], axis=1)
    return np.ascontiguousarray(image[:, ::-1]), uv_mirrored.astype(np.float32)


def _inside(corner: NDArray[np.floating], image: Image, side: int) -> Indices:
    """The corner (u, v) moved so that the square lies in the image, or at the corner of an image that is smaller."""
    height, width = image.shape[:2]
    last = np.maximum([width - side, height - side], 0)
    out: Indices = np.clip(corner, 0, last).astype(np.int64)
    return out


def _within(u: NDArray[np.floating], side: int) -> Mask:
    return np.asarray(np.all((u >= 0) & (u <= side - 1), axis=1), dtype=bool)


def _cut(image: Image, corner: Indices, side: int) -> Image:
    u, v = corner
    part = image[v : v + side, u : u + side]
    missing = side - part.shape[0], side - part.shape[1]
    return np.pad(part, ((0, missing[0]), (0, missing[1]), (0, 0)), mode="edge") if any(missing) else part
