"""Images as networks take them: of a limited size, as tensors of floats."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
import torch

from baselines.feature_pnp.features import to_grey
from relocbench.arrays import Array, Image
from relocbench.errors import MethodError

_LEAST_SIDE_PX = 64
"""a smaller image has nothing but borders"""


def network_input(
    image: Image, channels: Literal[1, 3], longest_px: int, network: str, device: str, multiple: int = 1
) -> tuple[torch.Tensor, Array]:
    """An image for a network.

    Args:
        image: grey (H, W) or (H, W, 1), or RGB (H, W, 3).
        channels: that the network takes, 1 for grey.
        longest_px: larger images are shrunk to this size of the longer side.
        network: its name, for the message.
        multiple: both sides are shrunk to multiples of so many pixels.

    Returns:
        The image (1, channels, H', W') in [0, 1], and the width and height of its pixels in those of the original; a
        pixel u is (u + 0.5) width - 0.5 there, since pixel centres are at integers.

    Raises:
        MethodError: the image is smaller than 64 pixels.
    """
    small, factor = _shrunk(to_grey(image) if channels == 1 else _rgb(image), longest_px, multiple)
    height, width = small.shape[:2]
    if min(height, width) < _LEAST_SIDE_PX:
        raise MethodError(f"{network} needs images of {_LEAST_SIDE_PX} pixels or more, this one has {width}x{height}")
    planes = torch.tensor(small).reshape(height, width, channels).permute(2, 0, 1)  # images may be read-only
    return planes[None].to(device, torch.float32) / 255.0, factor


def _rgb(image: Image) -> Image:
    if image.ndim == 3 and image.shape[2] == 3:
        return np.ascontiguousarray(image)
    return np.ascontiguousarray(np.broadcast_to(image.reshape(*image.shape[:2], 1), (*image.shape[:2], 3)))


def _shrunk(image: Image, longest_px: int, multiple: int) -> tuple[Image, Array]:
    """The image with a longer side of at most ``longest_px``, and its pixels' width and height in original ones."""
    height, width = image.shape[:2]
    ratio = min(1.0, longest_px / max(height, width))
    size = _side(width * ratio, multiple), _side(height * ratio, multiple)
    if size == (width, height):
        return image, np.ones(2)
    shrunk = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(shrunk, dtype=np.uint8), np.array([width / size[0], height / size[1]])


def _side(length: float, multiple: int) -> int:
    return max(multiple, round(length) // multiple * multiple)
