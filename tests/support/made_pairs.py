"""Training pairs made in memory: ``from made_pairs import MadePairs, TINY``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from relocbench.training import PairLabel, TrainingPair

TINY: dict[str, Any] = {
    "steps": 8,
    "batch": 2,
    "crop": 32,
    "points": 64,
    "warm_up": 2,
    "log_every": 2,
    "validate_every": 8,
    "checkpoint_every": 4,
    "learning_rate": 3e-3,
    "network": {"widths": [4, 6, 8], "dim": 4, "levels": 2},
    "loss": {"level_weights": [1.0, 1.0]},
}
"""options of a training that takes a second"""
SETTINGS = [f"--set={key}={value}" for key, value in TINY.items() if not isinstance(value, dict)]
SETTINGS += [f"--set={group}.{key}={value}" for group in ("network", "loss") for key, value in TINY[group].items()]
"""the same on a command line"""


class MadePairs:
    """A smooth random texture and itself, moved by whole pixels and darker; correspondences are exact.

    Args:
        conditions: (reference's, query's) of each pair; a pair's traversals are named by its conditions.
        size: width and height.
        datasets: the name of each pair's dataset; "made" where there are none.
    """

    def __init__(
        self,
        conditions: Sequence[tuple[str, str]] = (("dry", "wet"),) * 4,
        size: tuple[int, int] = (64, 48),
        datasets: Sequence[str] = (),
    ) -> None:
        self._conditions = list(conditions)
        self._datasets = list(datasets) or ["made"] * len(self._conditions)
        self._size = size
        noise = np.random.default_rng(7).normal(size=(size[1] + 8, size[0] + 8, 3)).astype(np.float32)
        smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
        self._world = np.clip(127 + 60 * smooth / smooth.std(), 0, 255).astype(np.uint8)

    def __len__(self) -> int:
        return len(self._conditions)

    def label(self, index: int) -> PairLabel:
        ref, query = self._conditions[index]
        return PairLabel(self._datasets[index], f"{ref}-0", f"{query}-0", "front", ref, query)

    def load(self, index: int) -> TrainingPair:
        width, height = self._size
        shift = np.random.default_rng([1, index]).integers(0, 8, 2)
        u_ref = np.random.default_rng([2, index]).uniform(8, (width - 9, height - 9), (200, 2)).astype(np.float32)
        query = self._world[shift[1] : shift[1] + height, shift[0] : shift[0] + width] // 2 + 20
        return TrainingPair(
            self.label(index), self._world[:height, :width], query, u_ref, (u_ref - shift).astype(np.float32)
        )

    def describe(self) -> Mapping[str, str]:
        return {"made": "0" * 64}
