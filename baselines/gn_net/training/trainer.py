"""GN-Net's trainer in the sense of ``relocbench.training``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from baselines.gn_net.tracker import GnNet
from baselines.gn_net.training.loop import Training
from baselines.gn_net.training.options import TrainOptions
from baselines.options import filled, options_from_dict, plain
from relocbench.training import TrainingData, TrainingReport, TrainingRun, Validate


class GnNetTrainer:
    """Trains the network of a tracker.

    Args:
        tracker: as which the weights are validated.
        defaults: the options where none are given.
    """

    def __init__(self, tracker: type[GnNet], defaults: TrainOptions) -> None:
        self._tracker = tracker
        self._defaults = defaults

    def default_options(self) -> dict[str, Any]:
        """See ``relocbench.training.Trainer``."""
        return plain(self._defaults)

    def train(
        self, data: TrainingData, validate: Validate | None, options: Mapping[str, Any], run: TrainingRun
    ) -> TrainingReport:
        """See ``relocbench.training.Trainer``."""
        chosen = options_from_dict(TrainOptions, filled(self.default_options(), options))
        return Training(data, validate, chosen, run, self._tracker).run_to_end()
