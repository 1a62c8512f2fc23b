"""What comes with trained weights: a model card for people, and its unchanging part inside the file of weights."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import torch

from baselines.lpn.training.options import TrainOptions
from baselines.training.provenance import hardware, versions
from relocbench.retrieval import PlaceData
from relocbench.training import TrainingRun, ValidationScores

_PUBLISHED_SIZE = 256


def weights_card(
    options: TrainOptions, data: PlaceData, step: int, steps: int, scores: Mapping[str, Any] | None
) -> dict[str, str]:
    """What the file of weights says of itself: the same for the same training, however often it was killed."""
    return {
        "data": json.dumps(dict(data.described), sort_keys=True),
        "places": str(data.places),
        "seed": str(options.seed),
        "step": str(step),
        "steps": str(steps),
        "validation": json.dumps(scores, sort_keys=True),
        "versions": json.dumps(versions(), sort_keys=True),
    }


def differences(options: TrainOptions, started: str) -> list[str]:
    """What sets a training apart from those that papers report, in words; empty if nothing does."""
    out = []
    if options.network.backbone != "resnet50":
        out.append(f"backbone {options.network.backbone} instead of resnet50")
    if options.size != _PUBLISHED_SIZE:
        out.append(f"images of {options.size} instead of {_PUBLISHED_SIZE} pixels")
    if "ImageNet: " not in started:
        out.append("backbone not started from known ImageNet weights")
    return out


def model_card(
    options: TrainOptions,
    data: PlaceData,
    run: TrainingRun,
    device: torch.device,
    seconds: float,
    parameters: int,
    best_step: int,
    steps: int,
    scores: ValidationScores | None,
    started: str,
) -> str:
    """``MODEL_CARD.md``."""
    system, network = options.system, options.network
    counts = ", ".join(f"{sum(i.image.view == view for i in data.images)} {view}" for view in options.views)
    stages = ", ".join(f"{stage.name} {stage.epochs} epochs ({', '.join(stage.trained)})" for stage in options.stages)
    apart = differences(options, started)
    lines = [
        f"# {options.configuration}",
        "",
        "## What it is",
        "",
        f"{system.about}. {network.backbone}, {options.size}x{options.size} pixels, {network.parts} "
        f"{'part' if network.parts == 1 else 'parts'} of {network.width} numbers, {parameters} parameters. "
        "Use: `relocbench evaluate-retrieval -m lpn --set lpn.weights=weights.safetensors`.",
        "",
        *([f"**Not to be set beside published numbers: {'; '.join(apart)}.**", ""] if apart else []),
        "## How it was trained",
        "",
        "| | |",
        "|---|---|",
        *(f"| data | {dataset}, fingerprint `{digest}` |" for dataset, digest in data.described),
        f"| places | {data.places}, {counts} images |",
        f"| backbone's first weights | {started} |",
        f"| learning rates | backbone {options.backbone_rate:g}, all else {options.rate:g} |",
        f"| seed | {options.seed} |",
        f"| steps | {steps}, of {options.batch} images a view; {stages} |",
        f"| weights kept | of step {best_step}{', the best in validation' if scores else ', the last'} |",
        f"| time | {seconds / 60:.1f} minutes |",
        f"| hardware | {hardware(device)} |",
        f"| versions | {', '.join(f'{key} {value}' for key, value in versions().items())} |",
        f"| command | `{run.command}` |",
        "| options | `config.yaml`, `--config` takes it |",
        "",
        "## Validation",
        "",
    ]
    if scores is None:
        return "\n".join([*lines, "None: the last weights were kept unseen.", ""])
    metrics = list(next(iter(scores.by_conditions.values()), scores.together))
    groups = {"all": scores.together, **scores.by_conditions}
    queries = {"all": sum(scores.pairs.values()), **scores.pairs}
    lines += [
        "By retrieval among places of the training set that were held out.",
        "",
        f"| query -> gallery | queries | {' | '.join(metrics)} |",
        f"|---|---|{'---|' * len(metrics)}",
    ]
    lines += [
        f"| {group} | {queries[group]} | "
        f"{' | '.join(f'{100 * values[m]:.1f} %' if m in values else '' for m in metrics)} |"
        for group, values in groups.items()
    ]
    return "\n".join([*lines, "", "## Limits", "", "Trained on the data above alone; not tried on anything else.", ""])
