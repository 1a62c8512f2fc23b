"""Part heads: the embedding of a part from its feature, and the building from the embedding.

    embedding = BatchNorm(Linear(x))      logits = Linear(Dropout(embedding))

Each part has a head, which all views share: the classifier's weights align the views (Zheng et al., "instance loss").
For retrieval the embeddings are compared, and the classifier is not used. Initial weights are those of the authors' LPN
and DWDR code: He et al., 2015, fan-out, for the first layer, N(1, 0.02) for the batch normalisation, N(0, 0.001) for
the classifier, zero for biases.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.initialisation import UndrawnLinear

_NORM_SPREAD, _CLASSIFIER_SPREAD = 0.02, 0.001


class HeadOutput(NamedTuple):
    """The output of the heads."""

    embeddings: Tensor
    """(B, P, D), before dropout"""
    logits: Tensor
    """(B, P, classes)"""


class PartHead(nn.Module):
    """The head of one part.

    Args:
        inputs: C, channels of the part's feature.
        width: D, size of the embedding.
        classes: number of buildings in the training set.
        dropout: share of the embedding that is dropped in training, by torch's global generator.
        generator: source of the initial weights.
    """

    def __init__(self, inputs: int, width: int, classes: int, dropout: float, generator: torch.Generator) -> None:
        super().__init__()
        self.reduce = UndrawnLinear(inputs, width)
        self.norm = nn.BatchNorm1d(width)
        self.dropout = dropout
        self.classifier = UndrawnLinear(width, classes)
        nn.init.kaiming_normal_(self.reduce.weight, mode="fan_out", generator=generator)
        nn.init.normal_(self.norm.weight, 1.0, _NORM_SPREAD, generator=generator)
        nn.init.normal_(self.classifier.weight, 0.0, _CLASSIFIER_SPREAD, generator=generator)
        nn.init.zeros_(self.reduce.bias)
        nn.init.zeros_(self.classifier.bias)

    def embed(self, x: Tensor) -> Tensor:
        """The embeddings (B, D) of features (B, C)."""
        return cast(Tensor, self.norm(self.reduce(x)))

    def classify(self, embedding: Tensor) -> Tensor:
        """The logits (B, classes) of embeddings (B, D)."""
        return cast(Tensor, self.classifier(functional.dropout(embedding, self.dropout, self.training)))


class PartHeads(nn.Module):
    """A head for each part; arguments are those of ``PartHead``."""

    def __init__(
        self, parts: int, inputs: int, width: int, classes: int, dropout: float, generator: torch.Generator
    ) -> None:
        super().__init__()
        self.heads = nn.ModuleList(PartHead(inputs, width, classes, dropout, generator) for _ in range(parts))

    def embed(self, features: Tensor) -> Tensor:
        """The embeddings (B, P, D) of features (B, P, C)."""
        return torch.stack([head.embed(features[:, p]) for p, head in enumerate(self._each())], dim=1)

    def forward(self, features: Tensor) -> HeadOutput:
        """The embeddings and logits of features (B, P, C) of one view's images.

        In training, the statistics of batch normalisation are those of one call, so that views are not mixed.
        """
        embeddings = self.embed(features)
        logits = [head.classify(embeddings[:, p]) for p, head in enumerate(self._each())]
        return HeadOutput(embeddings, torch.stack(logits, dim=1))

    def _each(self) -> list[PartHead]:
        return [cast(PartHead, head) for head in self.heads]
