"""The exponential moving average (EMA) of a network's weights, which is steadier than the latest ones."""

from __future__ import annotations

import copy

import torch
from torch import nn


class EmaNetwork:
    """A copy of a network whose weights follow the original's: average <- k average + (1 - k) weights.

    k is the decay, but at most (1 + n) / (10 + n) after n steps, so that the random initial weights are soon forgotten.
    The statistics of batch normalisation are averaged in the same way.
    """

    def __init__(self, network: nn.Module, decay: float) -> None:
        self.network = copy.deepcopy(network).requires_grad_(False)
        self._decay = decay

    @torch.no_grad()
    def follow(self, network: nn.Module, steps: int) -> None:
        """Take in the weights of ``network`` after its ``steps``-th step."""
        keep = min(self._decay, (1 + steps) / (10 + steps))
        for average, value in zip(self.network.state_dict().values(), network.state_dict().values(), strict=True):
            if average.is_floating_point():
                average.lerp_(value, 1 - keep)
            else:
                average.copy_(value)
