"""The encoder's maps of views of training images, computed once and kept.

A view is an image as the network's camera sees it, turned against the camera that took it, or of its mirror image. What
a view is depends on the image's name, the seed and the number of the view alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from baselines.gn_net.network import image_tensor
from baselines.lm_reloc.euler import pose_of
from baselines.lm_reloc.network import PoseNetwork
from baselines.lm_reloc.training.options import TrainOptions
from baselines.lm_reloc.view import inverse_depth_of_places, network_camera, seen_places, view_of
from relocbench.arrays import Array
from relocbench.errors import MethodError
from relocbench.tracking import KeyframePoints
from relocbench.training import PosedTrainingData, TrainingView

_MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
_MB = 2**20


class MapsOfView(NamedTuple):
    """What the trained part of the network sees of a view."""

    maps: Tensor
    """(C, G, G) float16: the encoder's"""
    seen: Tensor
    """(G, G) bool: places that lie on the image"""
    depth: Tensor
    """(2, G, G) inverse depth in 1/m and whether it is known; zero unless the network uses it"""


class Views:
    """The views of all images of the data.

    Args:
        data: where images are read.
        options: see there.
        network: whose encoder is used.
    """

    def __init__(self, data: PosedTrainingData, options: TrainOptions, network: PoseNetwork) -> None:
        self._data, self._options, self._network = data, options, network.for_tracking()
        self._camera = network_camera(options.network.side, options.network.focal)
        self._kept: dict[tuple[str, int, bool], MapsOfView] = {}
        self._bytes_left = options.cache_mb * _MB

    def __call__(self, name: str, turn: int, mirrored: bool) -> MapsOfView:
        """The maps of an image in one of its views. Raises DatasetError."""
        key = name, turn, mirrored
        if key in self._kept:
            return self._kept[key]
        made = self._made(name, turn, mirrored)
        size = sum(tensor.element_size() * tensor.nelement() for tensor in made)
        if size <= self._bytes_left:
            self._kept[key] = made
            self._bytes_left -= size
        return made

    def T_view_camera(self, name: str, turn: int, mirrored: bool) -> Array:
        """(4, 4) the turn of a view against the camera that took the image, or against its mirror image.

        With a mirror M = diag(-1, 1, 1), the pose between mirrored images is ``M T M``; :meth:`relative` puts both
        together.
        """
        if turn == 0:
            return np.eye(4)
        digest = hashlib.sha256(f"{self._options.seed} {turn} {mirrored} {name}".encode()).digest()
        rng = np.random.default_rng(int.from_bytes(digest[:8], "little"))
        angles = np.radians(self._options.turn_deg) * rng.uniform(-1, 1, 3)
        return pose_of(np.concatenate([angles, np.zeros(3)]))

    def relative(self, T_query_ref: Array, ref: tuple[str, int], query: tuple[str, int], mirrored: bool) -> Array:
        """(4, 4) the pose between two views of a pair, each given by the image's name and its turn."""
        T = _MIRROR @ T_query_ref @ _MIRROR if mirrored else T_query_ref
        first, second = (self.T_view_camera(*which, mirrored) for which in (ref, query))
        return second @ T @ first.T  # turns alone: the transpose is the inverse

    def _made(self, name: str, turn: int, mirrored: bool) -> MapsOfView:
        options = self._options.network
        taken = self._data.view(name, depth=options.depth)
        taken = _mirrored(taken) if mirrored else taken
        R = self.T_view_camera(name, turn, mirrored)[:3, :3]
        view = view_of(taken.image, taken.camera, self._camera, R)
        with _one_thread(), torch.inference_mode():
            maps = self._network.encode(image_tensor(view.image).to(memory_format=torch.channels_last))[0]
        depth = np.zeros((2, options.places, options.places), dtype=np.float32)
        if options.depth:
            depth = inverse_depth_of_places(taken.points, taken.camera, self._camera, options.places, R)
        seen = torch.from_numpy(seen_places(view.seen, options.places))
        return MapsOfView(maps.contiguous().half().clone(), seen, torch.from_numpy(depth))


def _mirrored(view: TrainingView) -> TrainingView:
    """A view mirrored left to right, with its camera.

    Raises:
        MethodError: the camera is not pinhole: the mirror image of a lens with distortion need not be one of its model.
    """
    camera = view.camera
    if camera.model != "pinhole":
        raise MethodError(f"images of a camera '{camera.model}' cannot be mirrored: undistort them, or set mirror=0")
    last = camera.width - 1
    points = KeyframePoints(
        np.stack([last - view.points.uv[:, 0], view.points.uv[:, 1]], axis=1),
        view.points.inverse_depth,
        view.points.sigma,
    )
    return TrainingView(np.ascontiguousarray(view.image[:, ::-1]), replace(camera, cx=last - camera.cx), points)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Sums are then computed in the same order in every process."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
