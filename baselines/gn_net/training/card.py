"""What comes with trained weights: a model card for people, and its unchanging part inside the file of weights."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import torch

from baselines.gn_net.training.options import TrainOptions
from baselines.training.provenance import hardware, versions
from relocbench.training import TrainingRun, ValidationScores


def weights_card(
    name: str, options: TrainOptions, data: Mapping[str, str], step: int, scores: Mapping[str, Any] | None
) -> dict[str, str]:
    """What the file of weights says of itself: the same for the same training, however often it was killed."""
    return {
        "name": name,
        "data": json.dumps(dict(data), sort_keys=True),
        "seed": str(options.seed),
        "step": str(step),
        "steps": str(options.steps),
        "validation": json.dumps(scores, sort_keys=True),
        "versions": json.dumps(versions(), sort_keys=True),
    }


def model_card(
    name: str,
    options: TrainOptions,
    data: Mapping[str, str],
    run: TrainingRun,
    device: torch.device,
    seconds: float,
    parameters: int,
    best_step: int,
    scores: ValidationScores | None,
) -> str:
    """``MODEL_CARD.md``."""
    network = options.network
    lines = [
        f"# {name}",
        "",
        "## What it is",
        "",
        f"Feature network for direct relocalization tracking: {network.levels} levels of {network.dim} channels, "
        f"{parameters} parameters. Use: `relocbench evaluate -m {name} --set {name}.weights=weights.safetensors`.",
        "",
        "## How it was trained",
        "",
        "| | |",
        "|---|---|",
        *(f"| data | {dataset}, fingerprint `{digest}` |" for dataset, digest in data.items()),
        f"| seed | {options.seed} |",
        f"| steps | {options.steps}, of {options.batch} pairs of {options.crop}x{options.crop} pixels |",
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
    metrics = list(scores.together)
    groups = {"all": scores.together, **scores.by_conditions}
    counts = {"all": sum(scores.pairs.values()), **scores.pairs}
    lines += [f"| reference -> query | pairs | {' | '.join(metrics)} |", f"|---|---|{'---|' * len(metrics)}"]
    lines += [
        f"| {group} | {counts[group]} | {' | '.join(f'{100 * values[m]:.1f} %' for m in metrics)} |"
        for group, values in groups.items()
    ]
    return "\n".join([*lines, "", "## Limits", "", "Trained on the data above alone; not tried on anything else.", ""])
