"""LPN's trainer in the sense of ``relocbench.training``: options, folder and end; the steps are in ``loop``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from baselines.files import write_whole
from baselines.lpn.configurations import CONFIGURATIONS
from baselines.lpn.training.loop import Training
from baselines.lpn.training.options import TrainOptions, usual_options
from baselines.options import filled, options_from_dict, plain
from baselines.training.device import device_named
from relocbench.retrieval import PlaceData
from relocbench.training import TrainingReport, TrainingRun, ValidateRetriever


class LpnTrainer:
    """Trains any of the configurations of ``baselines.lpn.configurations``."""

    configurations: tuple[str, ...] = tuple(CONFIGURATIONS)

    def default_options(self) -> dict[str, Any]:
        """The options of LPN itself."""
        return self.options_of("lpn")

    def options_of(self, configuration: str) -> dict[str, Any]:
        """The options of a configuration. Raises ConfigError: there is none of that name."""
        return plain(usual_options(configuration))

    def train_places(
        self, data: PlaceData, validate: ValidateRetriever | None, options: Mapping[str, Any], run: TrainingRun
    ) -> TrainingReport:
        """See ``relocbench.training.PlaceTrainer``."""
        usual = self.options_of(str(options.get("configuration", "lpn")))
        chosen = options_from_dict(TrainOptions, filled(usual, options)).with_rates()
        training = Training(data, validate, chosen, run, device_named(run.device))
        write_whole(run.out / "config.yaml", yaml.safe_dump(plain(chosen), sort_keys=False))
        return training.run_to_end()
