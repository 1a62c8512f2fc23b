"""Evidence for a pose from the images alone: how alike keyframe and query look around points of the keyframe.

It knows no residuals and no matches, so that it also speaks against a pose that most matches agree with because the
street repeats itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.alignment.features.pyramid import sample
from baselines.alignment.matching import DSO_PATTERN
from baselines.alignment.shared.pyramid import halve, level_camera, to_grey
from relocbench.arrays import Array, Floats, Image, Mask
from relocbench.geometry import Camera, apply

LARGEST_COUNT = 1000
"""points that are looked at, spread evenly over all"""
_CELL_PX = 8


@dataclass(frozen=True, eq=False)
class GreyImage:
    """A grey image and its camera."""

    values: Floats
    """(H, W) grey levels"""
    camera: Camera

    @classmethod
    def half_of(cls, image: Image, camera: Camera) -> GreyImage:
        """The image at half its size, whose pixels hold less noise and forgive an error of a pixel.

        Args:
            image: (H, W) grey or (H, W, 3) RGB, uint8.
            camera: of any model, of the image's size.
        """
        return cls(halve(to_grey(image)), level_camera(camera, 1))


def strong_pixels(image: GreyImage) -> Array:
    """The pixel of the largest gradient in each cell of 8x8 pixels, (N, 2), if it has any; row by row.

    Patterns around them have contrast, unlike those around the centres of blobs.
    """
    grey = image.values.astype(np.float64)
    strength: Array = np.gradient(grey, axis=0) ** 2 + np.gradient(grey, axis=1) ** 2
    rows, columns = grey.shape[0] // _CELL_PX, grey.shape[1] // _CELL_PX
    whole = strength[: rows * _CELL_PX, : columns * _CELL_PX].reshape(rows, _CELL_PX, columns, _CELL_PX)
    cells = whole.transpose(0, 2, 1, 3).reshape(rows, columns, _CELL_PX**2)
    v, u = np.divmod(cells.argmax(axis=-1), _CELL_PX)
    v, u = v + _CELL_PX * np.arange(rows)[:, None], u + _CELL_PX * np.arange(columns)
    strong = cells.max(axis=-1) > 0
    return np.stack([u[strong], v[strong]], axis=-1).astype(np.float64)


def correlations(T_query_ref: Array, uv: Array, depth: Array, reference: GreyImage, query: GreyImage) -> Array:
    """The normalised cross-correlation of keyframe and query around each of at most :data:`LARGEST_COUNT` points.

    It is taken over the eight pixels of DSO's residual pattern (Engel, Koltun and Cremers, "Direct sparse odometry",
    TPAMI 2018), which have the depth of their point and are warped by the pose. It does not depend on gain and offset
    of the brightness.

    Args:
        T_query_ref: (4, 4).
        uv: (N, 2) pixels of ``reference``.
        depth: (N,) metres along z.
        reference, query: both images, of any camera model.

    Returns:
        (min(N, LARGEST_COUNT),) -1 to 1; 0 where a pattern has no contrast or leaves an image.
    """
    chosen = np.linspace(0, len(uv) - 1, min(len(uv), LARGEST_COUNT)).astype(np.intp)
    pattern = uv[chosen][:, None] + np.array(DSO_PATTERN)
    flat = pattern.reshape(-1, 2)
    rays, has_ray = reference.camera.unproject(flat)
    points = np.where(has_ray[:, None], rays, 0.0) * np.repeat(depth[chosen], len(DSO_PATTERN))[:, None]
    projected, visible = query.camera.project(apply(T_query_ref, points))
    seen, in_view = _read(query, np.where((visible & has_ray)[:, None], projected, -1.0))
    kept, in_reference = _read(reference, flat)
    values = np.stack([kept, seen]).reshape(2, *pattern.shape[:2])
    values = values - values.mean(axis=-1, keepdims=True)
    norms = np.sqrt(np.prod(np.sum(values**2, axis=-1), axis=0))
    product = np.sum(values[0] * values[1], axis=-1)
    whole = np.all((in_view & in_reference).reshape(pattern.shape[:2]), axis=-1)
    out: Array = np.divide(product, norms, out=np.zeros_like(product), where=whole & (norms > 0))
    return out


def _read(image: GreyImage, uv: Array) -> tuple[Array, Mask]:
    """Grey levels (N,) at pixels (N, 2), and (N,) which pixels lie inside; the others have values of the border."""
    height, width = image.values.shape
    inside = np.all((uv >= 0) & (uv < [width - 1, height - 1]), axis=1)
    within = np.clip(np.where(np.isfinite(uv), uv, 0.0), 0, [width - 1, height - 1])
    return sample(image.values[..., None], within)[:, 0].astype(np.float64), inside
