"""One descriptor for each image from the embeddings of its parts.

    f = sum of embed(image) and embed(mirror image)          (P, D)
    descriptor = concatenation over p of f_p / (||f_p|| sqrt(P))

as in the evaluation of LPN's authors (Wang et al., TCSVT 2021). With quarter turns, f is the sum over the image and its
mirror image in each of four directions: a drone may head in any. The norm of a descriptor is 1, and the dot product of
two descriptors is the mean cosine of corresponding parts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor

Turns = Literal[1, 4]
"""in how many directions an image is described: as it is, or turned by each multiple of 90 degrees"""


def over_symmetries(embed: Callable[[Tensor], Tensor], images: Tensor, turns: Turns = 1) -> Tensor:
    """The sum of the embeddings of images and of their mirror images, in each direction.

    Args:
        embed: maps images to embeddings.
        images: (B, 3, H, W), which are mirrored left to right; square ones if they are turned.
        turns: 1 for the images as they are, 4 for all quarter turns.
    """
    turned = (images.rot90(quarters, (-2, -1)) for quarters in range(turns))
    return sum((embed(each) + embed(each.flip(-1)) for each in turned), start=images.new_zeros(()))


def descriptors(embeddings: Tensor) -> Tensor:
    """The descriptors (..., P * D), part after part, of embeddings (..., P, D); a part that is zero stays zero."""
    parts = embeddings.shape[-2]
    out: Tensor = (unit_parts(embeddings) / parts**0.5).flatten(-2)
    return out


def unit_parts(embeddings: Tensor) -> Tensor:
    """Each part of embeddings (..., P, D) divided by its norm; a part that is zero stays zero."""
    norms = torch.linalg.vector_norm(embeddings, dim=-1, keepdim=True)
    out: Tensor = embeddings / norms.clamp(min=torch.finfo(embeddings.dtype).tiny)
    return out


def parts_of(descriptor: Tensor, parts: int) -> Tensor:
    """The parts (..., P, D), of unit norm, of a descriptor (..., P * D).

    Raises:
        ValueError: the descriptor's size is no multiple of ``parts``.
    """
    size = descriptor.shape[-1]
    if parts < 1 or size % parts:
        raise ValueError(f"a descriptor of {size} numbers does not consist of {parts} parts")
    out: Tensor = descriptor.unflatten(-1, (parts, size // parts)) * parts**0.5
    return out
