"""The device and the precision that a network computes with."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

import torch
from torch import nn

from relocbench.errors import MethodError

Network = TypeVar("Network", bound=nn.Module)


def to_device(network: Network, name: str) -> Network:
    """Move a network to a device.

    Raises:
        MethodError: there is no such device, or it cannot be used.
    """
    with _refused_by_name(name):
        return network.to(name)


def device_named(name: str) -> torch.device:
    """The device of a name.

    Raises:
        MethodError: there is no such device, or it cannot be used.
    """
    with _refused_by_name(name):
        torch.zeros(1, device=name)
        return torch.device(name)


@contextmanager
def _refused_by_name(name: str) -> Iterator[None]:
    try:
        yield
    except (RuntimeError, AssertionError) as bad:  # no such device, or no driver
        raise MethodError(f"device '{name}' cannot be used: {str(bad).splitlines()[0]}") from bad
