"""The losses of GN-Net and LM-Reloc, by which the features are trained; each has a module of its own."""

from baselines.gn_net.losses.contrastive import ContrastiveOptions
from baselines.gn_net.losses.descent import DescentOptions
from baselines.gn_net.losses.gauss_newton import GaussNewtonOptions
from baselines.gn_net.losses.total import LossOptions, LossValue, pose_loss, total_loss

__all__ = [
    "ContrastiveOptions",
    "DescentOptions",
    "GaussNewtonOptions",
    "LossOptions",
    "LossValue",
    "pose_loss",
    "total_loss",
]
