"""Clouds in different units: one in millimetres or feet, the other in metres."""

from __future__ import annotations

import numpy as np

_METRES_A_UNIT = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "feet": 0.3048, "kilometres": 1000.0}
_WITHIN = 1.6
"""factor within which the sizes of two clouds of one scene agree"""
HOPELESS = 6.0
"""ratio of sizes from which two clouds have too little in common to be registered: 1/36 of the surfaces"""


def unit_guesses(radius_a_m: float, radius_b_m: float) -> list[tuple[float, str]]:
    """The units that would make the sizes of two clouds agree, if one is in metres; none if they agree as they are.

    Returns:
        for each, the factor by which B's coordinates are multiplied to have A's unit, and words.
    """
    ratio = radius_a_m / radius_b_m
    if 1 / _WITHIN < ratio < _WITHIN:
        return []
    out = []
    for unit, metres in _METRES_A_UNIT.items():
        for factor, words in ((metres, f"B in {unit}, A in metres"), (1 / metres, f"A in {unit}, B in metres")):
            if abs(np.log(ratio / factor)) < np.log(_WITHIN):
                out.append((factor, words))
    return sorted(out, key=lambda guess: abs(float(np.log(ratio / guess[0]))))
