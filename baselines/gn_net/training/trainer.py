"""GN-Net's trainer in the sense of ``relocbench.training``: options, folder and end; the steps are in ``loop``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
import yaml

from baselines.gn_net.options import options_from_dict, options_to_dict
from baselines.gn_net.tracker import GnNet
from baselines.gn_net.training.files import write_whole
from baselines.gn_net.training.loop import Training
from baselines.gn_net.training.options import TrainOptions
from relocbench.errors import MethodError
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
        chosen = options_from_dict(TrainOptions, _filled(self.default_options(), options))
        training = Training(data, validate, chosen, run, self._tracker, _device(run.device))
        write_whole(run.out / "config.yaml", yaml.safe_dump(plain(chosen), sort_keys=False))
        return training.run_to_end()


def plain(options: TrainOptions) -> dict[str, Any]:
    """Options as YAML and JSON hold them: lists in place of tuples."""

    def of(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: of(inner) for key, inner in value.items()}
        return [of(inner) for inner in value] if isinstance(value, tuple | list) else value

    return {key: of(value) for key, value in options_to_dict(options).items()}


def _filled(usual: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """``usual`` where ``given`` says nothing; keys that do not exist stay, to be refused by name."""
    nested = {key for key, value in usual.items() if isinstance(value, Mapping) and isinstance(given.get(key), Mapping)}
    return {**usual, **given, **{key: _filled(usual[key], given[key]) for key in nested}}


def _device(name: str) -> torch.device:
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as bad:  # torch says which: no such device, or no driver
        raise MethodError(f"device '{name}' cannot be used: {str(bad).splitlines()[0]}") from bad
    return device
