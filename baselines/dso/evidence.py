"""Evidence for an answer of direct alignment: how alike keyframe and query look around each point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.alignment import DSO_PATTERN, Level, LevelPoints
from baselines.alignment.features.pyramid import sample
from relocbench.arrays import Array, Mask
from relocbench.geometry import apply

LARGEST_COUNT = 1000
"""points that are looked at, spread evenly over all"""
ALIKE = 0.7
"""correlation from which a point counts as seen again"""


@dataclass(frozen=True)
class Evidence:
    """What speaks for a pose; points out of view count as points that look different."""

    correlation: float
    """mean over all points of the correlation around them, -1 to 1"""
    seen_again: float
    """share of all points whose correlation is at least :data:`ALIKE`"""


def evidence_for(T_query_ref: Array, points: LevelPoints, reference: Level, query: Level) -> Evidence:
    """The evidence for a pose from the points of one level of the keyframe."""
    chosen = np.linspace(0, len(points) - 1, min(len(points), LARGEST_COUNT)).astype(np.intp)
    found = np.nan_to_num(correlations(T_query_ref, points, chosen, reference, query), nan=0.0)
    return Evidence(float(np.mean(found)), float(np.mean(found >= ALIKE)))


def correlations(
    T_query_ref: Array, points: LevelPoints, chosen: NDArray[np.intp], reference: Level, query: Level
) -> Array:
    """The normalised cross-correlation of DSO's residual pattern in keyframe and query, around each chosen point.

    The eight pixels of the pattern have the inverse depth of their point and are warped by the pose. The correlation
    does not depend on gain and offset of the brightness.

    Returns:
        (N,) -1 to 1; 0 where a pattern has no contrast, NaN where it leaves an image.
    """
    offsets = np.array(DSO_PATTERN)
    uv = points.uv[chosen].astype(np.float64)[:, None] + offsets
    camera = reference.camera
    rays = np.stack(
        [(uv[..., 0] - camera.cx) / camera.fx, (uv[..., 1] - camera.cy) / camera.fy, np.ones(uv.shape[:2])], axis=-1
    )
    depth = 1.0 / points.points[2, chosen].astype(np.float64)
    projected, visible = query.camera.project(apply(T_query_ref, (rays * depth[:, None, None]).reshape(-1, 3)))
    seen, in_view = _read(query, np.where(visible[:, None], projected, -1.0))
    kept, in_reference = _read(reference, uv.reshape(-1, 2))
    values = np.stack([kept, seen]).reshape(2, *uv.shape[:2])
    values = values - values.mean(axis=-1, keepdims=True)
    norms = np.sqrt(np.prod(np.sum(values**2, axis=-1), axis=0))
    product = np.sum(values[0] * values[1], axis=-1)
    alike = np.divide(product, norms, out=np.zeros_like(product), where=norms > 0)
    whole = np.all((in_view & in_reference).reshape(uv.shape[:2]), axis=-1)
    return np.where(whole, alike, np.nan)


def _read(level: Level, uv: Array) -> tuple[Array, Mask]:
    """Intensities (N,) at pixels (N, 2), and (N,) which pixels lie inside; the others have values of the border."""
    height, width = level.map.shape[:2]
    inside = np.all((uv >= 0) & (uv < [width - 1, height - 1]), axis=1)
    within = np.clip(uv, 0, [width - 1, height - 1])
    return sample(level.map[..., :1], within)[:, 0].astype(np.float64), inside
