"""Refined part pooling: each column of the map belongs to each part with some probability.

Sun et al., "Beyond Part Models" (PCB + RPP), ECCV 2018, for a column f(u) of C numbers:

    p(part i | f(u)) = softmax over i of W_i . f(u)      part i = mean over u of p(i | f(u)) f(u)

The W_i are learnt by induction: the uniform parts (here the rings) train the heads first, then the W_i alone learn to
give each head the columns that it knows, then all is trained (``stages.INDUCED``). The softmax runs over parts at each
pixel: regions are shared out, not channels.

The authors' code multiplies the mean by the number of parts, which the heads' normalisation takes out again; and it
lets W see columns that were averaged over groups of channels and freed of their mean, which neither paper nor this
does. First weights N(0, 0.001), as classifiers have in the field: a start close to equal shares.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn

from baselines.lpn.drawing import convolution
from baselines.lpn.pooling import PartMean, Parts, masked_means
from baselines.options import NO_OTHER_KEYS
from relocbench.errors import ConfigError

_SPREAD = 0.001


@dataclass(frozen=True)
class SoftPartitionOptions:
    """How columns are pooled.

    Raises:
        ConfigError: a value that makes no sense.
    """

    mean: PartMean = "all"
    """``all``: mean over all pixels, as in the paper; ``mask``: divided by the sum of the probabilities"""

    __pydantic_config__ = NO_OTHER_KEYS

    def __post_init__(self) -> None:
        if self.mean not in ("all", "mask"):
            raise ConfigError(f"mean of the soft partition is '{self.mean}', expected all or mask")


class SoftPartition(nn.Module):
    """The part classifier and its pooling.

    Args:
        channels: C.
        parts: P.
        options: see there.
        generator: where the first weights are drawn from.
    """

    def __init__(self, channels: int, parts: int, options: SoftPartitionOptions, generator: torch.Generator) -> None:
        super().__init__()
        self.mean: PartMean = options.mean
        self.classifier = convolution(channels, parts, 1, bias=False)
        nn.init.normal_(self.classifier.weight, 0.0, _SPREAD, generator=generator)

    def probabilities(self, x: Tensor) -> Tensor:
        """(B, P, H, W), sum over P is 1, of (B, C, H, W)."""
        return cast(Tensor, self.classifier(x)).softmax(1)

    def forward(self, x: Tensor) -> Parts:
        """(B, P, C) and the probabilities, of (B, C, H, W)."""
        masks = self.probabilities(x)
        return Parts(masked_means(x, masks, self.mean), masks)
