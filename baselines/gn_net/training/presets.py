"""The trainers by name; they differ only in their options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from baselines.gn_net.tracker import GnNet, GnNetContrastive, LmNet
from baselines.gn_net.training.loop import Training
from baselines.gn_net.training.options import TrainOptions
from baselines.options import filled, options_from_dict, plain
from relocbench.training import TrainingData, TrainingReport, TrainingRun, Validate

_DESCENT_WEIGHT = 0.1


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


def gn_net() -> GnNetTrainer:
    """GN-Net: contrastive and Gauss-Newton loss."""
    return GnNetTrainer(GnNet, TrainOptions())


def gn_net_contrastive() -> GnNetTrainer:
    """The paper's ablation: the contrastive loss alone."""
    defaults = TrainOptions()
    loss = replace(defaults.loss, gauss_newton=replace(defaults.loss.gauss_newton, weight=0.0))
    return GnNetTrainer(GnNetContrastive, replace(defaults, loss=loss))


def lm_net() -> GnNetTrainer:
    """LM-Net: contrastive loss in LM-Reloc's form, Gauss-Newton and descent loss."""
    defaults = TrainOptions()
    loss = replace(
        defaults.loss,
        contrastive=replace(defaults.loss.contrastive, form="squared"),
        descent=replace(defaults.loss.descent, weight=_DESCENT_WEIGHT),
    )
    return GnNetTrainer(LmNet, replace(defaults, loss=loss))
