"""Batches of pairs as maps of their views, the same whatever the number of background processes that make them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from baselines.gn_net.training.drawing import EvenDraw
from baselines.lm_reloc.euler import numbers_of
from baselines.lm_reloc.network import PoseNetwork
from baselines.lm_reloc.training.options import TrainOptions
from baselines.lm_reloc.training.views import Views
from relocbench.geometry import invert
from relocbench.training import PosedTrainingData


class Batch(NamedTuple):
    """The B pairs of one step; index 0 of each tensor's second dimension is the keyframe, 1 the query."""

    maps: Tensor
    """(B, 2, C, G, G) float16"""
    seen: Tensor
    """(B, 2, G, G) bool"""
    depth: Tensor
    """(B, 2, 2, G, G) inverse depth in 1/m and whether it is known"""
    true: Tensor
    """(B, 2, 6) the pose from keyframe to query, and its inverse, as Euler angles and translation"""

    def to(self, device: torch.device) -> Batch:
        """The batch on another device."""
        return Batch(*(tensor.to(device, non_blocking=True) for tensor in self))


class Batches(Dataset[Batch]):
    """The batch of each step, a function of the step and the seed alone.

    Args:
        data: pairs to learn from.
        options: see there.
        network: whose encoder makes the maps.
    """

    def __init__(self, data: PosedTrainingData, options: TrainOptions, network: PoseNetwork) -> None:
        self._data, self._options = data, options
        self._draw = EvenDraw(data, options.seed, options.shares)
        self._views = Views(data, options, network)

    def __len__(self) -> int:
        return self._options.steps

    def __getitem__(self, step: int) -> Batch:
        parts = [self._sample(step, place) for place in range(self._options.batch)]
        return Batch(*(torch.stack(tensors) for tensors in zip(*parts, strict=True)))

    def _sample(self, step: int, place: int) -> tuple[Tensor, ...]:
        options = self._options
        rng = np.random.default_rng([options.seed, step, place])
        pair = self._data.posed(self._draw[step * options.batch + place])
        mirrored = bool(rng.random() < options.mirror)
        ref, query = ((name, int(rng.integers(options.turns))) for name in (pair.image_ref, pair.image_query))
        T_query_ref = self._views.relative(pair.T_query_ref, ref, query, mirrored)
        true = np.stack([numbers_of(T_query_ref), numbers_of(invert(T_query_ref))]).astype(np.float32)
        views = [self._views(*which, mirrored) for which in (ref, query)]
        return *(torch.stack(tensors) for tensors in zip(*views, strict=True)), torch.from_numpy(true)
