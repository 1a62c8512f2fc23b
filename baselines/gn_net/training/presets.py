"""The trainers by name; they differ only in their options."""

from __future__ import annotations

from dataclasses import replace

from baselines.gn_net.tracker import GnNet, GnNetContrastive, LmNet
from baselines.gn_net.training.options import TrainOptions
from baselines.gn_net.training.trainer import GnNetTrainer

_DESCENT_WEIGHT = 0.1


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
