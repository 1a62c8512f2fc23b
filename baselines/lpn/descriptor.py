"""From embeddings of parts to one descriptor an image.

    f = sum of embed(image) and embed(mirror image)          (P, D)
    descriptor = concatenation over p of f_p / (||f_p|| sqrt(P))

as the authors of LPN test (Wang et al., TCSVT 2021). Its norm is 1, and the dot product of two descriptors is the mean
of the cosines between corresponding parts.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor


def with_mirror_image(embed: Callable[[Tensor], Tensor], images: Tensor) -> Tensor:
    """f(image) + f(mirror image).

    Args:
        embed: from images to embeddings.
        images: (B, 3, H, W); mirrored left to right.
    """
    return embed(images) + embed(images.flip(-1))


def descriptors(embeddings: Tensor) -> Tensor:
    """(..., P * D) part after part, of embeddings (..., P, D); a part that is zero stays zero."""
    parts = embeddings.shape[-2]
    return (unit_parts(embeddings) / parts**0.5).flatten(-2)


def unit_parts(embeddings: Tensor) -> Tensor:
    """(..., P, D): each part divided by its norm; a part that is zero stays zero."""
    norms = torch.linalg.vector_norm(embeddings, dim=-1, keepdim=True)
    return embeddings / norms.clamp(min=torch.finfo(embeddings.dtype).tiny)


def parts_of(descriptor: Tensor, parts: int) -> Tensor:
    """(..., P, D) of unit norm: the parts that a descriptor (..., P * D) is made of.

    Raises:
        ValueError: the descriptor's size is no multiple of ``parts``.
    """
    size = descriptor.shape[-1]
    if parts < 1 or size % parts:
        raise ValueError(f"a descriptor of {size} numbers is not made of {parts} parts")
    return descriptor.unflatten(-1, (parts, size // parts)) * parts**0.5
