"""LoFTR (Sun et al., CVPR 2021), correspondences without keypoints in kornia's module, and the tracker that uses it."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import torch
from pydantic import Field

from baselines.device import to_device
from baselines.feature_pnp.keyframe_depth import lift
from baselines.feature_pnp.pnp import Pnp, PreparedKeyframe, StrongPixels
from baselines.feature_pnp.solve import Matches2D3D
from baselines.learned_pnp import published
from baselines.learned_pnp.images import network_input
from baselines.learned_pnp.kornia_networks import from_kornia
from baselines.published_weights import PublishedWeights, fill, read_weights
from relocbench.arrays import Array, Image
from relocbench.tracking import Query, Reference
from relocbench.weights import PublishedFile

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


@dataclass(frozen=True, eq=False)
class PreparedImage(PreparedKeyframe):
    """A keyframe, and what the network computes of its image alone."""

    reference: Reference
    seen: LoftrImage


@dataclass(kw_only=True, eq=False)
class LoftrPnp(PublishedWeights, Pnp[PreparedImage]):
    """LoFTR (Sun et al., CVPR 2021), MAGSAC perspective-n-point, robust refinement.

    Every 8 x 8 cell of the keyframe may have a corresponding pixel in the query; cells without a depth are left out.
    Answers have no confidence: no calibration was fitted yet.

    Args:
        weights: file of the network's weights, as kornia's maintainers publish it or as safetensors; by default the one
            of that name in torch's cache, ``$TORCH_HOME/hub/checkpoints``.
        model: what the weights were trained on, MegaDepth (``outdoor``) or ScanNet (``indoor_new``).
        threshold: least probability of a match of two cells.
        longest_px: images whose longer side has more pixels are shrunk to so many; the authors' is 840. Memory grows
            with its fourth power.
        device: where the network runs; the pose is found on the CPU.

    Raises:
        MethodError: kornia is not installed, or the weights are missing or of another network.
    """

    name: ClassVar[str] = "loftr-pnp"

    weights: Path | None = None
    model: LoftrModel = "outdoor"
    threshold: Annotated[float, Field(ge=0, lt=1)] = 0.2
    longest_px: Annotated[int, Field(ge=64)] = 840
    device: str = "cpu"

    def __post_init__(self) -> None:
        weights = self.files(**vars(self))["weights"]
        self._network = Loftr(weights, self.model, self.threshold, self.longest_px, self.device)

    @classmethod
    def file(cls, model: LoftrModel = "outdoor", **_: Any) -> PublishedFile:
        return published.LOFTR[model]

    def prepare(self, reference: Reference) -> PreparedImage:
        """Compute the features of a keyframe's cells."""
        strong = StrongPixels.of(reference, self.depth_radius_px)
        return PreparedImage(strong, reference, self._network.encode(reference.image))

    def correspond(self, reference: PreparedImage, query: Query) -> Matches2D3D:
        """The points of a keyframe's cells and the pixels that see them in a query."""
        seen = self._network.encode(query.image)
        uv_ref, uv_query = self._network(reference.seen, seen)
        lifted = lift(reference.reference, uv_ref, self.depth_radius_px)
        scale = max(1.0, float(reference.seen.factor.max()), float(seen.factor.max()))
        return Matches2D3D(
            points=lifted.points,
            pixels=uv_query[lifted.index],
            scale=np.full(len(lifted.index), scale),
            depth_direction=lifted.depth_direction,
            reference_pixels=uv_ref[lifted.index],
        )
