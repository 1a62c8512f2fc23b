"""Confidence as a probability: logistic regression on the evidence that an answer leaves.

The constants are those that ``benchmarks/publish/calibration.py`` prints, fitted to the validation districts 51, 52 and
53, those of GN-Net also to districts 1 to 6 of edition 2026.1, that of ``gn-net-pnp`` to 1 and 3. A wrong answer counts
eight times there, so that the confidences are lower estimates.
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


GN_NET = Calibration(-1.864, {"log_agreement": 1.774, "lead": 0.7735, "precision": 1.557})
GN_NET_PNP = Calibration(6.73, {"log_agreement": 2.783})
GN_NET_FROM_PRIOR = Calibration(-1.786, {"log_agreement": 1.914, "lead": 0.7791, "precision": 1.581})
GN_NET_CONTRASTIVE = Calibration(-0.2753, {"log_agreement": 1.951, "lead": 1.161, "precision": 1.053})
LM_NET = Calibration(-4.709, {"agreement": 37.78})
DSO = Calibration(-6.639, {"correlation": 18.77})
DSO_MULTISTART = Calibration(-6.301, {"correlation": 18.18})
ORB_PNP = Calibration(-12.25, {"lead": 1.096, "precision": 2.938, "correlation": 15.07})
SIFT_PNP = Calibration(-4.102, {"lead": 0.3271, "precision": 0.0, "correlation": 18.37})
ALIKED_PNP = Calibration(-8.488, {"lead": 2.197, "precision": 1.03, "correlation": 10.36})
