"""LoFTR (Sun et al., CVPR 2021): correspondences without keypoints, in kornia's module."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch

from baselines.device import to_device
from baselines.learned_pnp.images import network_input
from baselines.learned_pnp.kornia_networks import from_kornia
from baselines.published_weights import fill, read_weights
from relocbench.arrays import Array, Image

LoftrModel = Literal["outdoor", "indoor_new"]
_ENTRY = "state_dict"
"""of the authors' files"""
_PREFIX = "matcher."
"""of the names of tensors there"""


@dataclass(frozen=True, eq=False)
class LoftrImage:
    """What LoFTR computes of one image alone."""

    maps: dict[str, torch.Tensor]
    factor: Array
    """(2,) width and height, in pixels of the image, of those of the shrunk one"""


class Loftr:
    """The network with its weights.

    Args:
        weights: file of its authors, or the same tensors as safetensors.
        model: what the weights were trained on, MegaDepth (``outdoor``) or ScanNet (``indoor_new``).
        threshold: least probability of a match of 8 x 8 cells.
        longest_px: larger images are shrunk to this size of the longer side first.
        device: where the network runs.

    Raises:
        MethodError: kornia is not installed, or the weights are missing or of another network.
    """

    def __init__(self, weights: Path, model: LoftrModel, threshold: float, longest_px: int, device: str) -> None:
        made = from_kornia("LoFTR", "LoFTR")
        net = made(pretrained=None, config=_configuration(model, threshold))
        tensors = read_weights(weights, _ENTRY)
        fill(net, {name.removeprefix(_PREFIX): tensor for name, tensor in tensors.items()}, weights)
        self.net: Any = to_device(net, device)
        self.longest_px = longest_px
        self.device = device

    @torch.inference_mode()
    def encode(self, image: Image) -> LoftrImage:
        """What is computed of a grey (H, W) or RGB (H, W, 3) image alone.

        Raises:
            MethodError: the image is smaller than 64 pixels.
        """
        tensor, factor = network_input(image, 1, self.longest_px, "LoFTR", self.device)
        return LoftrImage(self.net.extract_features(tensor), factor)

    @torch.inference_mode()
    def __call__(self, first: LoftrImage, second: LoftrImage) -> tuple[Array, Array]:
        """Corresponding pixels (N, 2) and (N, 2) of two images, centres at integers.

        Those of the first are on a grid of 8 pixels of the shrunk image; each cell of the second occurs at most once.
        """
        found = self.net({"features0": first.maps, "features1": second.maps})
        # kornia keeps the authors' frame, in which the centre of the first pixel is at 0.5.
        uv_ref, uv_query = (
            found[key].double().cpu().numpy() * image.factor - 0.5
            for key, image in (("keypoints0", first), ("keypoints1", second))
        )
        return uv_ref, uv_query


def _configuration(model: LoftrModel, threshold: float) -> dict[str, Any]:
    from kornia.feature.loftr.loftr import default_cfg

    chosen: dict[str, Any] = copy.deepcopy(default_cfg)
    # The first weights were trained with a fault in the encoding of positions, those of indoor_new without.
    chosen["coarse"]["temp_bug_fix"] = model == "indoor_new"
    chosen["match_coarse"]["thr"] = threshold
    return chosen
