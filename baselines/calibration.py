"""Confidence as a probability: logistic regression on the evidence that an answer leaves.

The constants are those that ``benchmarks/publish/calibration.py`` prints, fitted to the validation districts 51, 52 and
53. A wrong answer counts twice there, so that the confidences are lower estimates.
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


GN_NET = Calibration(-3.862, {"agreement": 30.18})
GN_NET_PNP = Calibration(-4.149, {"agreement": 27.58})
GN_NET_FROM_PRIOR = Calibration(-5.182, {"agreement": 22.32})
GN_NET_CONTRASTIVE = Calibration(-4.093, {"agreement": 39.28})
LM_NET = Calibration(-3.854, {"agreement": 30.41})
DSO = Calibration(-6.212, {"correlation": 19.37})
DSO_MULTISTART = Calibration(-5.568, {"correlation": 17.45})
ORB_PNP = Calibration(-6.064, {"lead": 1.399, "precision": 1.652, "correlation": 0.0})
SIFT_PNP = Calibration(-1.03, {"lead": 0.6366, "precision": 0.0, "correlation": 0.0})
