"""ALIKED (Zhao et al., IEEE TIM 2023): keypoints and descriptors by deformable convolutions, in kornia's module."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from baselines.device import to_device
from baselines.feature_pnp.features import Features
from baselines.learned_pnp.weights import fill, read_weights
from relocbench.errors import MethodError

AlikedModel = Literal["n16", "n16rot", "n32", "t16"]
_LEAST_SIDE_PX = 64
"""a smaller image has nothing but borders"""


class Aliked:
    """The detector with its weights.

    Args:
        weights: file of the authors, or the same tensors as safetensors.
        model: variant that the weights are of.
        features: largest number of keypoints.
        longest_px: larger images are shrunk to this size of the longer side first.
        device: where the network runs.

    Raises:
        MethodError: kornia is not installed, or the weights are missing or of another network.
    """

    def __init__(self, weights: Path, model: AlikedModel, features: int, longest_px: int, device: str) -> None:
        try:
            from kornia.feature import ALIKED
        except ModuleNotFoundError as bad:
            if bad.name is None or bad.name.partition(".")[0] != "kornia":
                raise
            raise MethodError("ALIKED needs the package kornia: pip install 'relocbench[learned]'") from bad
        # A threshold of 0 selects the strongest maxima.
        net = ALIKED(f"aliked-{model}", max_num_keypoints=features, detection_threshold=0.0)
        fill(net, read_weights(weights), weights)
        self.net: Any = to_device(net, device)
        self.device = device
        self.longest_px = longest_px

    @torch.inference_mode()
    def __call__(self, image: NDArray[np.uint8]) -> Features:
        """The features of a grey (H, W) or RGB (H, W, 3) image, strongest first.

        Raises:
            MethodError: the image is smaller than 64 pixels.
        """
        shrunk, factor = _shrunk(_rgb(image), self.longest_px)
        height, width = shrunk.shape[:2]
        if min(height, width) < _LEAST_SIDE_PX:
            raise MethodError(f"ALIKED needs images of {_LEAST_SIDE_PX} pixels or more, this one has {width}x{height}")
        tensor = (
            torch.tensor(shrunk).permute(2, 0, 1)[None].to(self.device, torch.float32) / 255.0
        )  # images may be read-only
        (found,) = self.net(tensor)
        # Pixel centres at integers, before and after: u + 0.5 scales.
        uv = (found.keypoints.double().cpu().numpy() + 0.5) * factor - 0.5
        response = found.keypoint_scores.double().cpu().numpy()
        scale = np.full(len(uv), max(float(factor.max()), 1.0))
        size = image.shape[1], image.shape[0]
        features = Features(uv, scale, response, found.descriptors.float().cpu().numpy(), size)
        return features.take(np.lexsort((uv[:, 0], uv[:, 1], -response)))


def _rgb(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    if image.ndim == 3 and image.shape[2] == 3:
        return np.ascontiguousarray(image)
    return np.ascontiguousarray(np.broadcast_to(image.reshape(*image.shape[:2], 1), (*image.shape[:2], 3)))


def _shrunk(image: NDArray[np.uint8], longest_px: int) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """The image with a longer side of at most ``longest_px``, and its pixels' width and height in original ones."""
    height, width = image.shape[:2]
    if max(height, width) <= longest_px:
        return image, np.ones(2)
    ratio = longest_px / max(height, width)
    size = max(1, round(width * ratio)), max(1, round(height * ratio))
    shrunk = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(shrunk, dtype=np.uint8), np.array([width / size[0], height / size[1]])
