"""The trainers by name; they differ in options alone."""

from __future__ import annotations

from dataclasses import replace

from baselines.gn_net.tracker import GnNet, GnNetContrastive, LmNet
from baselines.gn_net.training.options import TrainOptions
from baselines.gn_net.training.trainer import GnNetTrainer

_DESCENT_WEIGHT = 0.1


def gn_net() -> GnNetTrainer:
    """Contrastive and Gauss-Newton loss: GN-Net."""
    return GnNetTrainer(GnNet, TrainOptions())


def gn_net_contrastive() -> GnNetTrainer:
    """Contrastive loss alone: the paper's ablation."""
    usual = TrainOptions()
    loss = replace(usual.loss, gauss_newton=replace(usual.loss.gauss_newton, weight=0.0))
    return GnNetTrainer(GnNetContrastive, replace(usual, loss=loss))


def lm_net() -> GnNetTrainer:
    """Contrastive loss in LM-Reloc's form, Gauss-Newton loss and descent loss."""
    usual = TrainOptions()
    loss = replace(
        usual.loss,
        contrastive=replace(usual.loss.contrastive, form="squared"),
        descent=replace(usual.loss.descent, weight=_DESCENT_WEIGHT),
    )
    return GnNetTrainer(LmNet, replace(usual, loss=loss))
