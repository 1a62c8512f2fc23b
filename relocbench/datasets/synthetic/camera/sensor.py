"""The sensor's noise."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Floats


def with_noise(light: Floats, read: float, shot: float, rng: np.random.Generator) -> Floats:
    """Linear light (H, W, 3), on a scale on which 1 is the least light that a linear sensor saturates at, with noise.

    The variance is ``read^2 + shot^2 I`` (Foi et al., "Practical Poissonian-Gaussian noise modeling", 2008). Values
    below 0 are kept, so that the mean stays that of the light.
    """
    if read <= 0 and shot <= 0:
        return light
    deviation = np.sqrt(np.float32(read**2) + np.float32(shot**2) * np.maximum(light, 0))
    return np.asarray(light + deviation * rng.standard_normal(light.shape, dtype=np.float32), dtype=np.float32)
