"""Feature maps of an image, level by level, as feature alignment reads them.

A level's map is (H, W, D) float32 with the channels innermost. Gradients are not stored: the kernel takes central
differences where it samples. It then reads twelve pixels of D values, which is as much memory as four pixels of 3 D
values with stored gradients, and no query has to write maps three times the size, which takes longer than the whole
alignment (``benchmarks/speed/feature_alignment.py`` prints both).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.shared.pyramid import Level, Map, level_camera, require_pinhole, with_gradients
from relocbench.arrays import Array, Floats
from relocbench.errors import MethodError
from relocbench.geometry import Camera


@dataclass(frozen=True, eq=False)
class FeatureLevel:
    """The map and the pinhole camera of one level."""

    map: Map
    """(H, W, D) C-contiguous"""
    camera: Camera
    confidence: Map | None = None
    """(H, W, 1) C-contiguous, positive: how much a point of a reference counts, where the network tells"""

    @property
    def channels(self) -> int:
        """D, the number of channels."""
        return int(self.map.shape[2])


@dataclass(frozen=True, eq=False)
class FeaturePyramid:
    """All levels of one image, finest first."""

    levels: tuple[FeatureLevel, ...]

    @classmethod
    def from_maps(
        cls, maps: Sequence[NDArray[Any]], camera: Camera, confidences: Sequence[NDArray[Any]] = ()
    ) -> FeaturePyramid:
        """The pyramid of a network's feature maps.

        Level l has W >> l times H >> l pixels, as in the intensity pyramid; where a map is one row or column larger,
        because it was rounded up, that row or column is left out. C-contiguous float32 arrays of the right size are
        used without a copy, which is what a network gives that keeps its channels last.

        Args:
            maps: (H_l, W_l, D) each, finest first; pixel (u, v) of level l is at
                ((u + 0.5) 2^l - 0.5, (v + 0.5) 2^l - 0.5) of level 0.
            camera: of level 0, pinhole.
            confidences: (H_l, W_l, 1) for each map, or none.

        Raises:
            MethodError: the camera is not pinhole, there is no map, or one has a wrong shape.
        """
        require_pinhole(camera)
        if not maps:
            raise MethodError("a feature pyramid needs at least one map")
        if confidences and len(confidences) != len(maps):
            raise MethodError(f"{len(confidences)} maps of confidence, {len(maps)} of features")
        levels = []
        for number, values in enumerate(maps):
            of_level = level_camera(camera, number)
            confidence = _cropped(confidences[number], camera, number) if confidences else None
            levels.append(FeatureLevel(_cropped(values, camera, number), of_level, confidence))
        return cls(tuple(levels))

    def __len__(self) -> int:
        return len(self.levels)

    def with_gradients(self) -> list[Level]:
        """The levels with stored gradients, (H, W, 3 D), as the matching of single pixels reads them."""
        return [Level(with_gradients(level.map), level.camera) for level in self.levels]


def _cropped(values: NDArray[Any], camera: Camera, level: int) -> Map:
    """A map in the size of its level."""
    of_level = level_camera(camera, level)
    if np.ndim(values) != 3 or not _covers(values.shape[:2], camera, level):
        raise MethodError(
            f"the feature map of level {level} is {np.shape(values)}, "
            f"expected ({of_level.height}, {of_level.width}, channels)"
        )
    return np.ascontiguousarray(values[: of_level.height, : of_level.width], dtype=np.float32)


def _covers(shape: Sequence[int], camera: Camera, level: int) -> bool:
    """Whether the shape is the level's size, rounded down or up."""
    return all(
        side >> level <= have <= -(-side >> level)
        for have, side in zip(shape, (camera.height, camera.width), strict=True)
    )


def level_coordinates(uv: Array, level: int) -> Array:
    """Pixels (N, 2) of level 0 in the coordinates of a level: (u + 0.5) / 2^l - 0.5."""
    return np.asarray((uv + 0.5) / (1 << level) - 0.5, dtype=np.float64)


def sample(level_map: Map, uv: Array) -> Floats:
    """A map (H, W, D) interpolated bilinearly at (N, 2) pixels within it -> (N, D)."""
    height, width = level_map.shape[:2]
    iu = np.clip(np.floor(uv[:, 0]).astype(int), 0, max(width - 2, 0))
    iv = np.clip(np.floor(uv[:, 1]).astype(int), 0, max(height - 2, 0))
    ju, jv = np.minimum(iu + 1, width - 1), np.minimum(iv + 1, height - 1)
    au, av = (uv[:, 0] - iu)[:, None], (uv[:, 1] - iv)[:, None]
    above = (1 - au) * level_map[iv, iu] + au * level_map[iv, ju]
    below = (1 - au) * level_map[jv, iu] + au * level_map[jv, ju]
    return np.asarray((1 - av) * above + av * below, dtype=np.float32)
