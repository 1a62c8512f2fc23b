"""A sparse model: posed images, points, and which image observes which point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from relocbench.arrays import Array, Indices
from relocbench.geometry import Camera


@dataclass(frozen=True, eq=False)
class ModelImage:
    """An image with a pose."""

    name: str
    """path below the folder of images"""
    camera: int
    T_cam_world: Array
    """(4, 4)"""
    points: Indices
    """(K,) the points that it observes, increasing"""


@dataclass(frozen=True, eq=False)
class SparseModel:
    """A sparse model."""

    cameras: Mapping[int, Camera]
    images: Mapping[int, ModelImage]
    point_ids: Indices
    """(P,) increasing"""
    xyz: Array
    """(P, 3) in units of the model"""
    error_px: Array
    """(P,) mean reprojection error; NaN where the model does not say"""
