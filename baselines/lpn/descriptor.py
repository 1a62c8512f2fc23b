"""One descriptor for each image from the embeddings of its parts.

    f = sum of embed(image) and embed(mirror image)          (P, D)
    descriptor = concatenation over p of f_p / (||f_p|| sqrt(P))

as in the evaluation of LPN's authors (Wang et al., TCSVT 2021). The norm of a descriptor is 1, and the dot product of
two descriptors is the mean cosine of corresponding parts.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor


def with_mirror_image(embed: Callable[[Tensor], Tensor], images: Tensor) -> Tensor:
    """The sum of the embeddings of images and of their mirror images.

    Args:
        embed: maps images to embeddings.
        images: (B, 3, H, W), which are mirrored left to right.
    """
    return embed(images) + embed(images.flip(-1))


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
