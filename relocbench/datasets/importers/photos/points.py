"""Sparse models, and keyframe points from them, with the uncertainty that their observations leave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.geometry import Camera, apply, invert
from relocbench.tracking import KeyframePoints


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


@dataclass(frozen=True, eq=False)
class Observations:
    """Which image of a model observes which point, sorted by the point."""

    image: Indices
    """(K,) the image's number in the model"""
    point: Indices
    """(K,) row of the point in the model's arrays"""
    first: Indices
    """(P + 1,) where the observations of each point begin"""

    @classmethod
    def of(cls, model: SparseModel) -> Observations:
        """The observations of all images of a model."""
        none = np.zeros(0, dtype=np.int64)
        image = np.concatenate([none, *(np.full(len(i.points), number) for number, i in model.images.items())])
        point = np.searchsorted(model.point_ids, np.concatenate([none, *(i.points for i in model.images.values())]))
        order = np.lexsort((image, point))
        first = np.searchsorted(point[order], np.arange(len(model.point_ids) + 1))
        return cls(image[order].astype(np.int64), point[order].astype(np.int64), first.astype(np.int64))

    @property
    def counts(self) -> Indices:
        """(P,) number of images that observe each point."""
        return np.diff(self.first)


def keyframe_points(
    model: SparseModel,
    seen: Observations,
    pinholes: Mapping[int, Camera],
    image: int,
    min_track: int,
    noise_px: float,
    metres_per_unit: float,
) -> KeyframePoints:
    """The points that an image observes, where its pinhole camera sees them.

    The standard deviation of a point's inverse depth rho in the image is that of its triangulation by the other images
    that observe it, their poses taken as exact: ``sigma_rho = sigma_px / sqrt(sum_j |d u_j / d rho|^2)``, with u_j the
    pixel in image j of the point at inverse depth rho on the ray of this image, and sigma_px the point's reprojection
    error but at least ``noise_px``. Where no other image observes a point, the model does not say how exact its depth
    is, and sigma is 0.

    Args:
        seen: the observations of all images.
        pinholes: the pinhole camera of each camera of the model.
        image: number of the image.
        min_track: points that fewer images observe are left out.
        noise_px: least standard deviation of a keypoint, pixels.
        metres_per_unit: length of the model's unit.
    """
    observer = model.images[image]
    rows = np.searchsorted(model.point_ids, observer.points)
    rows = rows[seen.counts[rows] >= min_track]
    camera = pinholes[observer.camera]
    inside_camera = apply(observer.T_cam_world, model.xyz[rows])
    uv, valid = camera.project(inside_camera)
    valid = valid & camera.contains(uv, border=-0.5)
    rows, uv, z = rows[valid], uv[valid], inside_camera[valid][:, 2]
    information = _information(model, seen, pinholes, image, rows, inside_camera[valid])
    error = np.nan_to_num(model.error_px[rows], nan=0.0)
    sigma = np.where(information > 0, np.maximum(error, noise_px) / np.sqrt(np.maximum(information, 1e-300)), 0.0)
    return KeyframePoints(uv, 1.0 / (z * metres_per_unit), sigma / metres_per_unit)


def _information(
    model: SparseModel, seen: Observations, pinholes: Mapping[int, Camera], image: int, rows: Indices, at: Array
) -> Array:
    """``sum_j |d u_j / d rho|^2`` (N,) of the points ``rows`` at (N, 3) in the image, over the other observers j."""
    total = np.zeros(len(rows))
    count = seen.counts[rows]
    which = np.repeat(np.arange(len(rows)), count)
    within = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    observers = seen.image[seen.first[rows][which] + within]
    T_world_image = invert(model.images[image].T_cam_world)
    # X = ray / rho moves by dX / drho = -X z, with the ray's third component 1.
    motion = -at * at[:, 2:]
    for other in np.unique(observers):
        if other == image:
            continue
        of = which[observers == other]
        T_other_image = model.images[int(other)].T_cam_world @ T_world_image
        x, dx = apply(T_other_image, at[of]), motion[of] @ T_other_image[:3, :3].T
        camera = pinholes[model.images[int(other)].camera]
        with np.errstate(divide="ignore", invalid="ignore"):
            du = camera.fx * (dx[:, 0] - x[:, 0] / x[:, 2] * dx[:, 2]) / x[:, 2]
            dv = camera.fy * (dx[:, 1] - x[:, 1] / x[:, 2] * dx[:, 2]) / x[:, 2]
        np.add.at(total, of, np.where(x[:, 2] > 0, du * du + dv * dv, 0.0))
    return total
