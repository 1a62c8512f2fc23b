"""The total loss of a batch and its parts.

    instance     sum over views and parts of the mean cross-entropy of the building's number
    total        (1 - g) instance + g decorrelation + w partition

with g and w the weights of ``decorrelation`` and ``partition_loss``. All views share the classifier (Zheng et al.,
instance loss), which aligns their embeddings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from baselines.lpn.decorrelation import DecorrelationOptions, decorrelation_loss
from baselines.lpn.network import View, ViewOutput
from baselines.lpn.partition_loss import PartitionLossOptions, partition_loss
from baselines.options import Options


@dataclass(frozen=True)
class LossOptions(Options):
    """The losses besides the instance loss; a weight of 0 disables a loss."""

    decorrelation: DecorrelationOptions = field(default_factory=DecorrelationOptions)
    """between drone and satellite, whose batches must then show the same building in each row"""
    partition: PartitionLossOptions = field(default_factory=PartitionLossOptions)


class LossValue(NamedTuple):
    """The loss to be minimised, and its parts for the log."""

    total: Tensor
    """scalar"""
    parts: dict[str, Tensor]
    """scalars without derivatives and before weighting: ``instance``, ``instance/VIEW``, ``right/VIEW`` (share of the
    images whose building has the largest sum of probabilities over the parts), ``decorrelation``, ``partition``"""


def instance_loss(logits: Tensor, labels: Tensor) -> Tensor:
    """The sum over parts of the mean cross-entropy, from logits (B, P, classes) and labels (B,) int64."""
    parts = logits.shape[1]
    return parts * functional.cross_entropy(logits.flatten(0, 1), labels.repeat_interleave(parts))


def total_loss(
    outputs: Mapping[View, ViewOutput], labels: Mapping[View, Tensor], options: LossOptions | None = None
) -> LossValue:
    """The loss of one batch.

    Args:
        outputs: of the network in training mode, by view.
        labels: (B,) int64 buildings, by view.
        options: the other losses.

    Raises:
        ValueError: there is no view, the labels are of other views, the partition loss has no masks, or the
            decorrelation gets no pairs.
    """
    options = options or LossOptions()
    if not outputs or outputs.keys() != labels.keys():
        raise ValueError(f"outputs of {sorted(outputs)}, labels of {sorted(labels)}: expected the same views")
    of_view = {view: instance_loss(output.logits, labels[view]) for view, output in outputs.items()}
    instance = torch.stack(list(of_view.values())).sum()
    parts = {"instance": instance}
    for view, output in outputs.items():
        parts[f"instance/{view}"] = of_view[view]
        parts[f"right/{view}"] = (output.logits.softmax(-1).sum(1).argmax(-1) == labels[view]).double().mean()
    total = instance
    if options.decorrelation.weight > 0:
        parts["decorrelation"] = _decorrelation(outputs, labels, options.decorrelation)
        g = options.decorrelation.weight
        total = (1.0 - g) * instance + g * parts["decorrelation"]
    if options.partition.weight > 0:
        parts["partition"] = _partition(outputs, options.partition)
        total = total + options.partition.weight * parts["partition"]
    return LossValue(total, {name: value.detach() for name, value in parts.items()})


def _decorrelation(
    outputs: Mapping[View, ViewOutput], labels: Mapping[View, Tensor], options: DecorrelationOptions
) -> Tensor:
    if not {"drone", "satellite"} <= outputs.keys() or not torch.equal(labels["drone"], labels["satellite"]):
        raise ValueError("the decorrelation needs drone and satellite batches that show the same building in each row")
    return decorrelation_loss(outputs["satellite"].pooled, outputs["drone"].pooled, options)


def _partition(outputs: Mapping[View, ViewOutput], options: PartitionLossOptions) -> Tensor:
    """The mean over the views."""
    masks = [output.masks for output in outputs.values()]
    found = [mask for mask in masks if mask is not None]
    if len(found) < len(masks):
        raise ValueError("the partition loss needs a partition with masks, rings have none")
    return torch.stack([partition_loss(mask, options) for mask in found]).mean()
