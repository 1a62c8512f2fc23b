"""Means over masked values."""

from __future__ import annotations

import torch
from torch import Tensor


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """The mean of ``values`` where ``mask`` is true; zero, with zero derivative, if it is true nowhere.

    Args:
        values: (...); need not be finite where masked out.
        mask: (...) bool.
    """
    kept = torch.where(mask, values, torch.zeros_like(values))
    return kept.sum() / mask.sum().clamp(min=1)
