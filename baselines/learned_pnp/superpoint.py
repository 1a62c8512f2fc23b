"""SuperPoint (DeTone et al., CVPR Workshops 2018): keypoints from 65 classes of each 8 x 8 cell, and descriptors."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.learned_pnp.detector import NetworkDetector
from baselines.published_weights import fill, read_weights

_CELL_PX = 8
_THRESHOLD = 0.005
"""of a keypoint's probability"""
_RADIUS_PX = 4
"""within which a keypoint suppresses weaker ones, and width of the border without keypoints"""
_HIDDEN, _DESCRIPTOR = 256, 256


class SuperPointNetwork(nn.Module):
    """The shared encoder and the two heads of the paper; layers are named as in the authors' file of weights."""

    def __init__(self) -> None:
        super().__init__()
        width = 1
        for stage, wider in enumerate((64, 64, 128, 128), 1):
            self.add_module(f"conv{stage}a", nn.Conv2d(width, wider, 3, padding=1))
            self.add_module(f"conv{stage}b", nn.Conv2d(wider, wider, 3, padding=1))
            width = wider
        self.convPa = nn.Conv2d(width, _HIDDEN, 3, padding=1)
        self.convPb = nn.Conv2d(_HIDDEN, _CELL_PX**2 + 1, 1)
        self.convDa = nn.Conv2d(width, _HIDDEN, 3, padding=1)
        self.convDb = nn.Conv2d(_HIDDEN, _DESCRIPTOR, 1)

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Probabilities of keypoints (B, 8 h, 8 w) and descriptors of norm 1 of cells (B, 256, h, w) of grey images
        (B, 1, H, W), with h and w an eighth of H and W, rounded down."""
        x = image
        for stage in range(1, 5):
            x = x if stage == 1 else functional.max_pool2d(x, 2)
            for half in "ab":
                x = functional.relu(self.get_submodule(f"conv{stage}{half}")(x))
        classes = self.convPb(functional.relu(self.convPa(x))).softmax(dim=1)
        # The last class is "no keypoint in this cell".
        scores = functional.pixel_shuffle(classes[:, :-1], _CELL_PX)[:, 0]
        descriptors = self.convDb(functional.relu(self.convDa(x)))
        return scores, functional.normalize(descriptors, dim=1)


class SuperPoint(NetworkDetector):
    """The detector with its weights; see :class:`NetworkDetector`. Keypoints are whole pixels of the shrunk image."""

    name: ClassVar[str] = "SuperPoint"
    channels: ClassVar[Literal[1, 3]] = 1

    def load(self, weights: Path) -> nn.Module:
        net = SuperPointNetwork()
        fill(net, read_weights(weights), weights)
        return net

    def find(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        scores, cells = self.net(image)
        strongest = _local_maxima(scores)[0]
        inside = torch.zeros_like(strongest, dtype=torch.bool)
        inside[_RADIUS_PX:-_RADIUS_PX, _RADIUS_PX:-_RADIUS_PX] = True
        v, u = torch.nonzero(inside & (strongest > _THRESHOLD), as_tuple=True)
        response = strongest[v, u]
        kept = torch.argsort(response, descending=True, stable=True)[: self.features]
        keypoints = torch.stack([u, v], dim=-1)[kept].to(scores.dtype)
        return keypoints, response[kept], _sample(cells, keypoints)


def _local_maxima(scores: Tensor) -> Tensor:
    """Scores (B, H, W) where they are the largest of their neighbourhood, else 0.

    What a maximum suppresses is then left out, twice, so that a maximum of what remains counts as well.
    """

    def largest(values: Tensor) -> Tensor:
        return functional.max_pool2d(values[:, None], 2 * _RADIUS_PX + 1, stride=1, padding=_RADIUS_PX)[:, 0]

    maxima = scores == largest(scores)
    for _ in range(2):
        suppressed = largest(maxima.to(scores.dtype)) > 0
        rest = scores.masked_fill(suppressed, 0.0)
        maxima = maxima | ((rest == largest(rest)) & ~suppressed)
    return scores.masked_fill(~maxima, 0.0)


def _sample(cells: Tensor, keypoints: Tensor) -> Tensor:
    """Descriptors (N, D) of norm 1 at keypoints (N, 2), interpolated between those of cells (1, D, h, w).

    The centre of cell i is pixel 8 i + 3.5. The authors divide by 8 n - 4.5 where n cells span 8 n - 8 pixels, which
    moves samples by up to half a cell at the far sides; weights of matchers were trained with it.
    """
    height, width = cells.shape[-2:]
    half = _CELL_PX / 2 - 0.5
    span = torch.tensor([width, height], device=cells.device) * _CELL_PX - half - 1.0
    at = (keypoints - half) / span * 2.0 - 1.0
    found = functional.grid_sample(cells, at[None, None].to(cells.dtype), mode="bilinear", align_corners=True)
    return functional.normalize(found[0, :, 0].T, dim=-1)
