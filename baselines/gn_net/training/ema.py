"""The running mean of a network's weights: steadier than the last ones."""

from __future__ import annotations

import copy

import torch

from baselines.gn_net.network import FeatureNet


class MeanNet:
    """A network whose weights follow another's: mean <- k mean + (1 - k) weights.

    k is the decay, but at most (1 + n) / (10 + n) after n steps, so that the first random weights are soon forgotten.
    What batch normalisation has seen follows in the same way.
    """

    def __init__(self, net: FeatureNet, decay: float) -> None:
        self.net = copy.deepcopy(net).requires_grad_(False)
        self._decay = decay

    @torch.no_grad()
    def follow(self, net: FeatureNet, steps: int) -> None:
        """After ``steps`` steps of ``net``."""
        keep = min(self._decay, (1 + steps) / (10 + steps))
        for mean, value in zip(self.net.state_dict().values(), net.state_dict().values(), strict=True):
            if mean.is_floating_point():
                mean.lerp_(value, 1 - keep)
            else:
                mean.copy_(value)
