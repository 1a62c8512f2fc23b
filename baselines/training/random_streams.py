"""Random choices as functions of a seed and of what is chosen, so that a resumed training repeats them exactly."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch

from relocbench.arrays import Indices


def derived_seed(seed: int, *path: int) -> int:
    """A 63-bit seed for one purpose; different paths give independent streams."""
    return int(np.random.SeedSequence([seed, *path]).generate_state(1, np.uint64)[0] >> np.uint64(1))


def generator(seed: int, *path: int) -> torch.Generator:
    """A CPU generator for one purpose; different paths give independent streams."""
    return torch.Generator().manual_seed(derived_seed(seed, *path))


def shuffled_round(seed: int, path: tuple[int, ...], draw: int, count: int) -> tuple[int, int]:
    """The item of the ``draw``-th draw when ``count`` items are gone through round after round.

    Each round has a random order of its own, and every item occurs once in it.

    Args:
        seed: together with ``path``, determines the orders.
        path: numbers that tell this sequence of draws from others.
        draw: counted from 0.
        count: number of items.

    Returns:
        The number of the round, and the index of the item.
    """
    round_number, place = divmod(draw, count)
    return round_number, int(_order(seed, path, round_number, count)[place])


@lru_cache(maxsize=64)
def _order(seed: int, path: tuple[int, ...], round_number: int, count: int) -> Indices:
    return np.random.default_rng([seed, *path, round_number]).permutation(count)
