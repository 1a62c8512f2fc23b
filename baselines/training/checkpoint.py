"""Checkpoints: one file with everything that a training needs to resume after it was killed.

No random state is stored, since the random choices of a step are functions of the step and the seed.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import torch
from pydantic import AfterValidator, ConfigDict, Field, Strict, TypeAdapter, ValidationError
from torch import Tensor, nn

from baselines.files import write_whole
from baselines.torch_file import load_torch_file
from relocbench.errors import MethodError
from relocbench.training import ValidationScores

_VERSION = 1

StateDict = dict[str, Tensor]
Number = Annotated[float, Strict()]
Count = Annotated[int, Strict(), Field(ge=0)]
_CONTENT = ConfigDict(extra="forbid", arbitrary_types_allowed=True)


def _whole_scores(scores: dict[str, Any]) -> dict[str, Any]:
    known = {field.name for field in fields(ValidationScores)}
    if scores and not known - {"messages"} <= scores.keys() <= known:
        raise ValueError("expected the scores of a validation")
    return scores


@dataclass
class Best:
    """The best weights so far, and their scores."""

    __pydantic_config__ = _CONTENT

    step: Count
    score: Number
    weights: StateDict
    scores: Annotated[dict[str, Any], AfterValidator(_whole_scores)]
    """``ValidationScores`` as plain values; empty without validation"""

    @classmethod
    def of(cls, step: int, score: float, network: nn.Module, scores: ValidationScores | None) -> Best:
        """The current weights of a network, copied to the CPU."""
        weights = {name: tensor.detach().cpu().clone() for name, tensor in network.state_dict().items()}
        if scores is None:
            return cls(step, score, weights, {})
        by_conditions = {name: dict(values) for name, values in scores.by_conditions.items()}
        values = {"together": dict(scores.together), "by_conditions": by_conditions, "pairs": dict(scores.pairs)}
        return cls(step, score, weights, values)

    @property
    def validation(self) -> ValidationScores | None:
        """The scores, or None without validation."""
        return ValidationScores(**self.scores) if self.scores else None


@dataclass
class Checkpoint:
    """The state of a training after ``step`` steps."""

    __pydantic_config__ = _CONTENT

    identity: dict[str, Any]
    """options and data as plain values; another training must not resume from here"""
    step: Count
    net: StateDict
    optimiser: dict[str, Any]
    mean_net: StateDict | None
    """the averaged weights, if there are any"""
    window: dict[str, Number]
    """sums of the values whose means are the next row of the log"""
    window_steps: Count
    seconds: Annotated[Number, Field(ge=0)]
    """spent so far, over all runs"""
    best: Best | None
    messages: list[str]


def save_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint, whole or not at all."""
    values = {**vars(checkpoint), "version": _VERSION}
    values["best"] = None if checkpoint.best is None else vars(checkpoint.best)
    buffer = io.BytesIO()
    torch.save(values, buffer)
    write_whole(path, buffer.getvalue())


def load_checkpoint(path: Path, identity: Mapping[str, Any]) -> Checkpoint | None:
    """The checkpoint at a path, with tensors on the CPU, or None if there is none.

    Raises:
        MethodError: the file is damaged, or of a training with other options or data, which are named.
    """
    if not path.exists():
        return None
    if not path.is_file():
        raise MethodError("is not a regular file; expected a checkpoint", path)
    try:
        values = load_torch_file(path)
    except ValueError as bad:
        raise MethodError(f"not a whole checkpoint ({bad}); remove it to train from the start", path) from bad
    if not isinstance(values, dict) or values.pop("version", None) != _VERSION:
        raise MethodError(f"a checkpoint of another version, expected version {_VERSION}", path)
    try:
        found = TypeAdapter(Checkpoint).validate_python(values)
    except ValidationError as bad:
        first = bad.errors()[0]
        place = ".".join(map(str, first["loc"]))
        fault = f"not a checkpoint of this program: {place}: {first['msg']}"
        raise MethodError(f"{fault}; remove it to train from the start", path) from bad
    changed = list(_differences(found.identity, identity))
    if changed:
        raise MethodError(
            f"a training with other options or data ({'; '.join(changed[:3])}); choose another --out or remove it", path
        )
    return found


def _differences(before: Mapping[str, Any], now: Mapping[str, Any], prefix: str = "") -> list[str]:
    out = []
    for key in sorted(before.keys() | now.keys()):
        a, b = before.get(key), now.get(key)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            out += _differences(a, b, f"{prefix}{key}.")
        elif a != b:
            out.append(f"{prefix}{key}: {a} there, {b} now")
    return out
