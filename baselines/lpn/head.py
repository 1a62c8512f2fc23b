"""Part heads: from the feature of a part to its embedding, and from there to the building.

    embedding = BatchNorm(Linear(x))      logits = Linear(Dropout(embedding))

One head a part, shared by all views: views meet in the classifier's weights (Zheng et al., "instance loss"). At test
the embedding is what is compared, and the last layer is dropped. First weights as in the authors' LPN and DWDR code,
which have them from person re-identification: He et al. 2015 by the outputs (fan-out) for the first layer, batch
normalisation N(1, 0.02), classifier N(0, 0.001), biases zero.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils import skip_init

_NORM_SPREAD, _CLASSIFIER_SPREAD = 0.02, 0.001


class HeadOutput(NamedTuple):
    """What the heads make of the parts."""

    embeddings: Tensor
    """(B, P, D), before dropout"""
    logits: Tensor
    """(B, P, classes)"""


class PartHead(nn.Module):
    """The head of one part.

    Args:
        inputs: C, channels of the part's feature.
        width: D, numbers of the embedding.
        classes: buildings of the training set.
        dropout: share of the embedding that is dropped in training, by torch's global generator.
        generator: where the first weights are drawn from.
    """

    def __init__(self, inputs: int, width: int, classes: int, dropout: float, generator: torch.Generator) -> None:
        super().__init__()
        self.reduce = cast(nn.Linear, skip_init(nn.Linear, inputs, width))
        self.norm = nn.BatchNorm1d(width)
        self.dropout = dropout
        self.classifier = cast(nn.Linear, skip_init(nn.Linear, width, classes))
        nn.init.kaiming_normal_(self.reduce.weight, mode="fan_out", generator=generator)
        nn.init.normal_(self.norm.weight, 1.0, _NORM_SPREAD, generator=generator)
        nn.init.normal_(self.classifier.weight, 0.0, _CLASSIFIER_SPREAD, generator=generator)
        nn.init.zeros_(self.reduce.bias)
        nn.init.zeros_(self.classifier.bias)

    def embed(self, x: Tensor) -> Tensor:
        """(B, D) of (B, C)."""
        return cast(Tensor, self.norm(self.reduce(x)))

    def classify(self, embedding: Tensor) -> Tensor:
        """(B, classes) of (B, D)."""
        return cast(Tensor, self.classifier(functional.dropout(embedding, self.dropout, self.training)))


class PartHeads(nn.Module):
    """One head a part; arguments as of ``PartHead``."""

    def __init__(
        self, parts: int, inputs: int, width: int, classes: int, dropout: float, generator: torch.Generator
    ) -> None:
        super().__init__()
        self.heads = nn.ModuleList(PartHead(inputs, width, classes, dropout, generator) for _ in range(parts))

    def embed(self, features: Tensor) -> Tensor:
        """(B, P, D) of (B, P, C)."""
        return torch.stack([head.embed(features[:, p]) for p, head in enumerate(self._each())], dim=1)

    def forward(self, features: Tensor) -> HeadOutput:
        """Embeddings and logits of the features (B, P, C) of one view's images.

        Batch normalisation takes its statistics from the images of one call: views are not mixed in a batch.
        """
        embeddings = self.embed(features)
        logits = [head.classify(embeddings[:, p]) for p, head in enumerate(self._each())]
        return HeadOutput(embeddings, torch.stack(logits, dim=1))

    def _each(self) -> list[PartHead]:
        return [cast(PartHead, head) for head in self.heads]
