"""GN-Net's trainer in the sense of ``relocbench.training``: options, folder and end; the steps are in ``loop``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from baselines.files import write_whole
from baselines.gn_net.tracker import GnNet
from baselines.gn_net.training.loop import Training
from baselines.gn_net.training.options import TrainOptions
from baselines.options import filled, options_from_dict, plain
from baselines.training.device import device_named
from relocbench.training import TrainingData, TrainingReport, TrainingRun, Validate


class GnNetTrainer:
    """Trains the network of a tracker.

    Args:
        tracker: what the weights are validated as.
        usual: its options where none are given.
    """

    def __init__(self, tracker: type[GnNet], usual: TrainOptions) -> None:
        self._tracker = tracker
        self._usual = usual

    def default_options(self) -> dict[str, Any]:
        """See ``relocbench.training.Trainer``."""
        return plain(self._usual)

    def train(
        self, data: TrainingData, validate: Validate | None, options: Mapping[str, Any], run: TrainingRun
    ) -> TrainingReport:
        """See ``relocbench.training.Trainer``."""
        chosen = options_from_dict(TrainOptions, filled(self.default_options(), options))
        training = Training(data, validate, chosen, run, self._tracker, device_named(run.device))
        write_whole(run.out / "config.yaml", yaml.safe_dump(plain(chosen), sort_keys=False))
        return training.run_to_end()
