"""What changes smoothly along a drive, as automatic exposure and white balance do."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

_PERIODS_S = (7.0, 45.0)
_WAVES = 3


class Drifting(IntEnum):
    """What drifts; each has its own course."""

    EXPOSURE = 1
    WHITE_BALANCE = 2


def drift(seed: int, what: Drifting, time_s: float) -> float:
    """A value within [-1, 1] that depends smoothly on time: the mean of waves with drawn periods of 7 to 45 s.

    It changes by less than 0.9 in a second.
    """
    rng = np.random.default_rng([seed, 42, int(what)])
    period, phase = rng.uniform(*_PERIODS_S, _WAVES), rng.uniform(0, 2 * np.pi, _WAVES)
    return float(np.sin(2 * np.pi * time_s / period + phase).mean())
