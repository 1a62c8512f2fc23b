"""One step of gradient descent, and its end where numbers are not finite any more."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from relocbench.errors import MethodError


def descend(
    loss: Tensor,
    parts: Mapping[str, Tensor],
    parameters: Iterable[nn.Parameter],
    optimiser: torch.optim.Optimizer,
    clip: float,
    *,
    step: int,
    remedy: str,
    out: Path,
) -> dict[str, float]:
    """Follow the gradient of a loss once.

    Args:
        loss: scalar.
        parts: what it is made of, for the log.
        parameters: whose gradient is clipped to norm ``clip``; 0 for no limit.
        step: its number, counted from 1; with ``remedy`` and ``out``, the training's folder, for the message.

    Returns:
        ``loss``, ``gradient_norm`` (before clipping) and the parts, as numbers.

    Raises:
        MethodError: loss or gradient are not finite; the parameters are as they were.
    """
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    norm = torch.nn.utils.clip_grad_norm_(parameters, clip or math.inf)
    names = ["loss", "gradient_norm", *parts]
    numbers = torch.stack([x.detach().double() for x in (loss, norm, *parts.values())]).tolist()  # one wait
    values = dict(zip(names, numbers, strict=True))
    if not (math.isfinite(values["loss"]) and math.isfinite(values["gradient_norm"])):
        wrong = ", ".join(name for name, value in values.items() if not math.isfinite(value))
        raise MethodError(
            f"training broke down at step {step}: not finite: {wrong}; try {remedy} in another --out", out
        )
    optimiser.step()
    return values
