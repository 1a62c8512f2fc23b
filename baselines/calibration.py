"""Confidence as a probability: logistic regression on the evidence that an answer leaves.

The constants are those that ``benchmarks/publish/calibration.py`` prints, fitted to the validation districts 51, 52 and
53, those of GN-Net also to odd districts of edition 2026.1. A wrong answer counts eight times there, so that the
confidences are lower estimates.
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


GN_NET = Calibration(7.151, {"log_agreement": 2.2, "lead": 0.7272})
GN_NET_PNP = Calibration(6.73, {"log_agreement": 2.783})
GN_NET_FROM_PRIOR = Calibration(6.937, {"log_agreement": 2.32, "lead": 1.131})
GN_NET_CONTRASTIVE = Calibration(6.353, {"log_agreement": 2.21, "lead": 1.279})
LM_NET = Calibration(-4.709, {"agreement": 37.78})
DSO = Calibration(-6.639, {"correlation": 18.77})
DSO_MULTISTART = Calibration(-6.301, {"correlation": 18.18})
ORB_PNP = Calibration(-12.25, {"lead": 1.096, "precision": 2.938, "correlation": 15.07})
SIFT_PNP = Calibration(-4.102, {"lead": 0.3271, "precision": 0.0, "correlation": 18.37})
ALIKED_PNP = Calibration(-8.488, {"lead": 2.197, "precision": 1.03, "correlation": 10.36})
