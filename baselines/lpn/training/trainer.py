"""LPN's trainer in the sense of ``relocbench.training``: options, folder and end; the steps are in ``loop``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
import yaml

from baselines.gn_net.options import options_from_dict
from baselines.gn_net.training.files import write_whole
from baselines.lpn.configurations import CONFIGURATIONS
from baselines.lpn.training.loop import Training
from baselines.lpn.training.options import TrainOptions, plain, usual_options
from relocbench.errors import MethodError
from relocbench.retrieval import PlaceData
from relocbench.training import TrainingReport, TrainingRun, ValidateRetriever


class LpnTrainer:
    """Trains any of the configurations of ``baselines.lpn.configurations``."""

    configurations: tuple[str, ...] = tuple(CONFIGURATIONS)

    def default_options(self) -> dict[str, Any]:
        """Of LPN itself."""
        return self.options_of("lpn")

    def options_of(self, configuration: str) -> dict[str, Any]:
        """Of a configuration. Raises ConfigError: there is none of that name."""
        return plain(usual_options(configuration))

    def train_places(
        self, data: PlaceData, validate: ValidateRetriever | None, options: Mapping[str, Any], run: TrainingRun
    ) -> TrainingReport:
        """See ``relocbench.training.PlaceTrainer``."""
        usual = self.options_of(str(options.get("configuration", "lpn")))
        chosen = options_from_dict(TrainOptions, _filled(usual, options)).with_rates()
        training = Training(data, validate, chosen, run, _device(run.device))
        write_whole(run.out / "config.yaml", yaml.safe_dump(plain(chosen), sort_keys=False))
        return training.run_to_end()


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
