"""The correlation layer: how alike each place of one map is to each place of another.

Rocco, Arandjelović and Sivic, Convolutional neural network architecture for geometric matching, CVPR 2017.
"""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional


def descriptors(features: Tensor, seen: Tensor) -> Tensor:
    """Features (B, D, H, W) of unit norm; zero where ``seen`` (B, H, W) is false."""
    return functional.normalize(features, dim=1) * seen[:, None]


def correlate(first: Tensor, second: Tensor) -> Tensor:
    """The scalar products ``c(i, j) = <first(i), second(j)>`` of all places, normalised for each i.

    Negative products become zero, and the products of a place with all candidates are divided by their norm, so that a
    place that is like many others has small values everywhere.

    Args:
        first: descriptors (B, D, H, W).
        second: descriptors (B, D, H', W').

    Returns:
        (B, H' W', H, W): channel j is the candidate j of the second map, row by row.
    """
    batch, _, height, width = first.shape
    products = second.flatten(2).transpose(1, 2) @ first.flatten(2)
    return functional.normalize(functional.relu(products), dim=1).reshape(batch, -1, height, width)
