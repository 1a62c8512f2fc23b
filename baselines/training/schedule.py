"""The learning rate over a training."""

from __future__ import annotations

import math


def warmed_cosine(step: int, steps: int, warm_up: int, rate: float, final_rate: float) -> float:
    """The learning rate of a step, counted from 0: a linear rise, then half a cosine (SGDR, ICLR 2017).

    Args:
        steps: of the whole training.
        warm_up: steps of the rise.
        rate: the highest one.
        final_rate: the last one as a share of the highest.
    """
    if step < warm_up:
        return rate * (step + 1) / warm_up
    done = (step - warm_up) / max(steps - 1 - warm_up, 1)
    return rate * (final_rate + (1 - final_rate) * 0.5 * (1 + math.cos(math.pi * done)))
