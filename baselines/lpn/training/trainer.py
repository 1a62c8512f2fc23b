"""LPN's trainer in the sense of ``relocbench.training``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from baselines.lpn.configurations import CONFIGURATIONS
from baselines.lpn.training.loop import Training
from baselines.lpn.training.options import TrainOptions, usual_options
from baselines.options import filled, options_from_dict, plain
from relocbench.retrieval import PlaceData
from relocbench.training import TrainingReport, TrainingRun, ValidateRetriever


class LpnTrainer:
    """Trains any of the configurations of ``baselines.lpn.configurations``."""

    configurations: tuple[str, ...] = tuple(CONFIGURATIONS)

    def default_options(self) -> dict[str, Any]:
        """The default options of LPN itself."""
        return self.options_of("lpn")

    def options_of(self, configuration: str) -> dict[str, Any]:
        """The default options of a configuration.

        Raises:
            ConfigError: no configuration has that name.
        """
        return plain(usual_options(configuration))

    def train_places(
        self, data: PlaceData, validate: ValidateRetriever | None, options: Mapping[str, Any], run: TrainingRun
    ) -> TrainingReport:
        """See ``relocbench.training.PlaceTrainer``."""
        defaults = self.options_of(str(options.get("configuration", "lpn")))
        chosen = options_from_dict(TrainOptions, filled(defaults, options)).with_rates()
        return Training(data, validate, chosen, run).run_to_end()
