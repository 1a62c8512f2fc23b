"""The loss of the pose network.

LM-Reloc: ``||r - r_gt||_2 + lambda ||t - t_gt||_2`` with Euler angles r and the translation t. Each pair is asked in
both directions, so that the inverse of its pose is learnt too.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class PoseLoss(NamedTuple):
    """The loss of a batch, and its parts; scalars."""

    total: Tensor
    rotation: Tensor
    """mean norm of the error of the angles, radians"""
    translation: Tensor
    """mean norm of the error of the translation, metres"""


def pose_loss(predicted: Tensor, true: Tensor, translation_weight: float) -> PoseLoss:
    """The mean loss of predictions.

    Args:
        predicted, true: (..., 6) Euler angles in radians and translations in metres; each direction of a pair is one.
        translation_weight: lambda, radians per metre.
    """
    error = predicted - true
    rotation = torch.linalg.vector_norm(error[..., :3], dim=-1).mean()
    translation = torch.linalg.vector_norm(error[..., 3:], dim=-1).mean()
    return PoseLoss(rotation + translation_weight * translation, rotation, translation)
