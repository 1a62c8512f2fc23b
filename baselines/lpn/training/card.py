"""What the model card of an LPN training says."""

from __future__ import annotations

from baselines.lpn.network import LpnNetwork
from baselines.lpn.training.options import TrainOptions
from baselines.training.card import Description
from relocbench.pages import render
from relocbench.retrieval import PlaceData

_PUBLISHED_SIZE = 256


def differences(options: TrainOptions, started: str) -> list[str]:
    """What makes a training's numbers incomparable with published ones, in words; empty if nothing does.

    ``started`` says where the backbone's initial weights came from (``initial_weights.Start.text``).
    """
    out = []
    if options.network.backbone != "resnet50":
        out.append(f"backbone {options.network.backbone} instead of resnet50")
    if options.size != _PUBLISHED_SIZE:
        out.append(f"images of {options.size} instead of {_PUBLISHED_SIZE} pixels")
    if "ImageNet: " not in started:
        out.append("backbone not started from known ImageNet weights")
    if options.frozen_part:
        out.append(f"{options.frozen_part} frozen")
    return out


def description(options: TrainOptions, data: PlaceData, trained: LpnNetwork, steps: int, started: str) -> Description:
    """What the model card of a training says; ``started`` as in :func:`differences`."""
    counts = ", ".join(f"{sum(i.image.view == view for i in data.images)} {view}" for view in options.views)
    stages = ", ".join(f"{stage.name} {stage.epochs} epochs ({', '.join(stage.trained)})" for stage in options.stages)
    return Description(
        title=options.configuration,
        about=render(
            __name__,
            "about.md.j2",
            system=options.system.about,
            network=options.network,
            size=options.size,
            parameters=sum(parameter.numel() for parameter in trained.parameters()),
            differences=differences(options, started),
        ),
        data=data.described,
        facts={
            "places": f"{data.places}, {counts} images",
            "backbone's first weights": started,
            "learning rates": _rates(options),
            **_frozen(options),
        },
        steps=f"{steps}, of {options.batch} images a view; {stages}",
        groups="query -> gallery | queries",
        validated_by="By retrieval among places of the training set that were held out.",
    )


def _frozen(options: TrainOptions) -> dict[str, str]:
    if not options.frozen_part:
        return {}
    versions = ", ".join(f"{options.versions[view]} of each {view} image" for view in options.views)
    return {"frozen": f"{options.frozen_part}, with its statistics; augmented versions: {versions}"}


def _rates(options: TrainOptions) -> str:
    masks = "" if options.partition_rate == options.rate else f"partition {options.partition_rate:g}, "
    return f"backbone {options.backbone_rate:g}, {masks}all else {options.rate:g}"
