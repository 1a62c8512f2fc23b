"""The device and the precision of a training."""

from __future__ import annotations

import torch

from relocbench.errors import MethodError


def device_named(name: str) -> torch.device:
    """The device of a name.

    Raises:
        MethodError: there is no such device, or it cannot be used.
    """
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as bad:  # no such device, or no driver
        raise MethodError(f"device '{name}' cannot be used: {str(bad).splitlines()[0]}") from bad
    return device


def half_precision(chosen: bool | None, device: torch.device) -> bool:
    """Whether a network computes in bfloat16: as chosen, or if None, only on a GPU."""
    return device.type == "cuda" if chosen is None else chosen
