"""Confidence as a probability: logistic regression on the evidence that an answer leaves.

The constants are those that ``benchmarks/publish/calibration.py`` prints, fitted to the validation districts 51, 52 and
53. A wrong answer counts four times there, so that the confidences are lower estimates.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Calibration:
    """The probability that an answer is within 0.25 m and 2 degrees, ``1 / (1 + exp(-(offset + sum_i w_i x_i)))``."""

    offset: float
    weights: Mapping[str, float]
    """of each number of the answer's info; never negative, so that more evidence never lowers the confidence"""

    def __post_init__(self) -> None:
        if any(weight < 0 for weight in self.weights.values()):
            raise ValueError(f"weights of a calibration are {dict(self.weights)}, expected none below 0")

    def confidence(self, info: Mapping[str, float]) -> float:
        """The probability for an answer with this evidence; other entries of ``info`` are not looked at."""
        log_odds = self.offset + sum(weight * info[name] for name, weight in self.weights.items())
        return 0.5 * (1.0 + math.tanh(0.5 * log_odds))


GN_NET = Calibration(-4.31, {"agreement": 27.88})
GN_NET_PNP = Calibration(-4.894, {"agreement": 29.01})
GN_NET_FROM_PRIOR = Calibration(-5.578, {"agreement": 20.56})
GN_NET_CONTRASTIVE = Calibration(-4.745, {"agreement": 39.7})
LM_NET = Calibration(-4.176, {"agreement": 26.63})
DSO = Calibration(-6.449, {"correlation": 17.91})
DSO_MULTISTART = Calibration(-5.948, {"correlation": 16.45})
ORB_PNP = Calibration(-6.654, {"lead": 1.403, "precision": 1.456, "correlation": 1.904})
SIFT_PNP = Calibration(-3.149, {"lead": 0.1625, "precision": 0.0, "correlation": 7.934})
