"""What the tracker is given and what it answers, read from the files that the line protocol names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from relocbench.geometry import Camera, camera_from_dict, transform_from_tq

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class View:
    """An image with its camera."""

    key: str
    """a digest of image and camera: equal keys are equal images"""
    image: NDArray[np.uint8]
    """(H, W) grey or (H, W, 3) RGB"""
    camera: Camera

    @property
    def rgb(self) -> NDArray[np.uint8]:
        """(H, W, 3), as most models want it."""
        return self.image if self.image.ndim == 3 else np.repeat(self.image[..., None], 3, axis=2)


@dataclass(frozen=True, eq=False)
class Keyframe(View):
    """An image of the map, with depth in metres where it is known."""

    uv: Array
    """(N, 2) pixels with depth, centres at integers"""
    depth: Array
    """(N,) metres along z"""
    relative_sigma: Array
    """(N,) standard deviation of the depth as a share of it"""

    @cached_property
    def points(self) -> Array:
        """(N, 3) metres in the keyframe's camera; NaN where the lens shows nothing."""
        rays, _ = self.camera.unproject(self.uv)
        with np.errstate(divide="ignore", invalid="ignore"):
            return rays / rays[:, 2:] * self.depth[:, None]


@dataclass(frozen=True, eq=False)
class Answer:
    """A pose, or a stated failure."""

    T_query_ref: Array | None
    """(4, 4) maps points of the keyframe's camera to the query's, metres; None: the model found none"""
    confidence: float | None = None
    """higher is more certain"""
    message: str = ""
    """the reason of a failure"""
    info: Mapping[str, Any] = field(default_factory=dict)
    """further numbers and words for the table of answers"""


def read_keyframe(message: Mapping[str, Any]) -> Keyframe:
    """The keyframe of a ``reference`` message, with dense depth or sparse points."""
    if message["depth"] is not None:
        stored = np.asarray(Image.open(message["depth"])).astype(np.float64) / 256.0
        v, u = np.nonzero(stored)
        depth = stored[v, u]
        a, b, c = message["depth_sigma"]
        uv, relative_sigma = np.stack([u, v], axis=-1).astype(np.float64), a / depth + b + c * depth
    else:
        rows = np.loadtxt(message["points"], delimiter=",", skiprows=1, ndmin=2).reshape(-1, 4)
        uv, depth, relative_sigma = rows[:, :2], 1.0 / rows[:, 2], rows[:, 3] / rows[:, 2]
    view = read_view(message)
    return Keyframe(view.key, view.image, view.camera, uv, depth, np.maximum(relative_sigma, 1e-3))


def read_view(message: Mapping[str, Any]) -> View:
    """The image and camera of a message."""
    image = np.array(Image.open(Path(message["image"])), dtype=np.uint8)
    return View(message["key"], image, camera_from_dict(message["camera"]))


def prior_of(message: Mapping[str, Any]) -> Array | None:
    """(4, 4) initial guess of ``T_query_ref`` that came with a query, if one did."""
    prior = message["prior"]
    return None if prior is None else transform_from_tq(np.array(prior[:3]), np.array(prior[3:]))
