"""Contrastive loss: features of the same point shall agree, features of different points shall differ.

With d = ||F_a(u_a) - F_b(u_b)||_2, GN-Net (von Stumberg et al., RA-L 2020, section III):

    positives  mean d^2                negatives  mean max(0, M - d)^2

LM-Reloc (von Stumberg et al., 3DV 2020) has max(0, M - d^2) for negatives.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from baselines.options import Options, above_0, at_least

Form = Literal["distance", "squared"]


@dataclass(frozen=True)
class ContrastiveOptions(Options):
    """Form, weights, margins and negatives."""

    weight: float = 1.0
    """weight of positives and negatives together; 0 disables the loss"""
    negative_weight: float = 1.0
    """weight of negatives relative to positives"""
    form: Form = "distance"
    """``distance``: max(0, M - d)^2 (GN-Net); ``squared``: max(0, M - d^2) (LM-Reloc)"""
    margin: float = 1.0
    """M; negatives farther apart than this cost nothing"""
    negatives: Literal["random", "hard", "both"] = "both"
    """which wrong pixels of the query a feature is compared with"""
    away: float = 4.0
    """pixels of the level; pixels within this distance of the true one are no negatives"""
    candidates: int = 1024
    """number of pixels drawn in each image, of which the hardest negative of each point is chosen"""

    def __post_init__(self) -> None:
        at_least(self, 0, "weight negative_weight away")
        at_least(self, 1, "candidates")
        above_0(self, "margin")


def negative_terms(f_a: Tensor, f_b: Tensor, form: Form = "distance", margin: float = 1.0) -> Tensor:
    """The cost (...) of features (..., D) of different points: max(0, M - d)^2 or max(0, M - d^2)."""
    if form == "squared":
        return (margin - ((f_a - f_b) ** 2).sum(-1)).clamp(min=0)
    out: Tensor = (margin - torch.linalg.vector_norm(f_a - f_b, dim=-1)).clamp(min=0) ** 2
    return out
