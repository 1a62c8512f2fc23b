"""What describes trained weights: a model card for people, and the part of it that is stored in the weights file."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import torch

from relocbench import version
from relocbench.pages import render
from relocbench.training import TrainingRun, ValidationScores


class Description(NamedTuple):
    """What the model card of one trainer says besides what all model cards say."""

    title: str
    about: str
    """what the network is, and how it is used: Markdown without headings"""
    data: Sequence[tuple[str, str]]
    """name and fingerprint of each dataset that was learnt from"""
    facts: Mapping[str, str]
    """further rows of the table, below the data"""
    steps: str
    """how many there were, and of what"""
    groups: str
    """heading of the first two columns of the validation table"""
    validated_by: str = ""
    """how the weights were validated, a sentence"""


def model_card(
    described: Description,
    run: TrainingRun,
    device: torch.device,
    seed: int,
    seconds: float,
    best_step: int,
    scores: ValidationScores | None,
) -> str:
    """The text of ``MODEL_CARD.md``, for the weights of ``best_step`` and their scores (None without validation)."""
    rows = metrics = None
    if scores is not None:
        metrics = list(next(iter(scores.by_conditions.values()), scores.together))
        rows = [(group, count, _shares(values, metrics)) for group, count, values in score_rows(scores)]
    return render(
        __name__,
        "model_card.md.j2",
        described=described,
        seed=seed,
        best_step=best_step,
        minutes=f"{seconds / 60:.1f}",
        hardware=_hardware(device),
        versions=_versions(),
        command=run.command,
        metrics=metrics,
        rows=rows,
    )


def weights_card(
    data: Iterable[tuple[str, str]], seed: int, step: int, steps: int, scores: Mapping[str, Any] | None, **more: str
) -> dict[str, str]:
    """What the weights file says of itself.

    Neither times nor hardware are in it, so that the same training writes the same bytes however often it was killed.
    """
    return {
        **more,
        "data": json.dumps(dict(data), sort_keys=True),
        "seed": str(seed),
        "step": str(step),
        "steps": str(steps),
        "validation": json.dumps(scores, sort_keys=True),
        "versions": json.dumps(_versions(), sort_keys=True),
    }


def score_rows(scores: ValidationScores) -> Iterator[tuple[str, int, Mapping[str, float]]]:
    """Group, its number of pairs or queries, and its metrics; first the group ``all``."""
    yield "all", sum(scores.pairs.values()), scores.together
    for group, values in scores.by_conditions.items():
        yield group, scores.pairs[group], values


def _shares(values: Mapping[str, float], metrics: Sequence[str]) -> list[str]:
    return [f"{100 * values[metric]:.1f} %" if metric in values else "" for metric in metrics]


def _versions() -> dict[str, str]:
    known = {name: metadata.version(name) for name in ("torch", "numpy", "opencv-python-headless", "numba")}
    return {"relocbench": version.__version__, "python": platform.python_version(), **known}


def _hardware(device: torch.device) -> str:
    """Processor, number of threads and GPU."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    words = f"{(names or [platform.machine()])[0]}, {torch.get_num_threads()} threads"
    return f"{words}; {torch.cuda.get_device_name(device)}" if device.type == "cuda" else words
