"""Refined part pooling: each pixel's feature vector belongs to each part with some probability.

Sun et al., "Beyond Part Models" (PCB + RPP), ECCV 2018, for the feature vector f(u) of C channels at pixel u:

    p(part i | f(u)) = softmax over i of W_i . f(u)      part i = mean over u of p(i | f(u)) f(u)

The W_i are learnt by induction: first the heads are trained on uniform parts (here the rings), then the W_i alone learn
to assign to each head the features that it knows, then everything is trained (``stages.INDUCED``).

The authors' code multiplies the mean by the number of parts, which the heads' normalisation cancels. It also applies W
to features that were averaged over groups of channels and centred, which neither the paper nor this module does.
Initial weights are N(0, 0.001), as usual for classifiers, so that the shares start almost equal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn

from baselines.initialisation import convolution
from baselines.lpn.pooling import PartMean, Parts, masked_means
from baselines.options import Options

_SPREAD = 0.001


@dataclass(frozen=True)
class SoftPartitionOptions(Options):
    """How features are pooled."""

    mean: PartMean = "all"
    """``all``: mean over all pixels, as in the paper; ``mask``: weighted mean, divided by the sum of probabilities"""


class SoftPartition(nn.Module):
    """The classifier of P parts from C channels, and pooling by it."""

    def __init__(self, channels: int, parts: int, options: SoftPartitionOptions, generator: torch.Generator) -> None:
        super().__init__()
        self.mean: PartMean = options.mean
        self.classifier = convolution(channels, parts, 1, bias=False)
        nn.init.normal_(self.classifier.weight, 0.0, _SPREAD, generator=generator)

    def probabilities(self, x: Tensor) -> Tensor:
        """The probabilities (B, P, H, W) of a map (B, C, H, W); they sum to 1 over P."""
        return cast(Tensor, self.classifier(x)).softmax(1)

    def forward(self, x: Tensor) -> Parts:
        """The features (B, P, C) and probabilities of the parts of a map (B, C, H, W)."""
        masks = self.probabilities(x)
        return Parts(masked_means(x, masks, self.mean), masks)
