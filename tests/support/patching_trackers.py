"""A tracker whose module, when it is imported, makes every answer right that is scored in the same process."""

from __future__ import annotations

from typing import Any

import numpy as np

import relocbench.evaluation.tracking.score as scoring
from relocbench.tracking import Query, Reference, TrackResult


def _right(*anything: Any) -> Any:
    raise AssertionError("scored by the method's own code")


for _name, _value in list(vars(scoring).items()):
    if callable(_value) and getattr(_value, "__module__", "").startswith("relocbench"):
        setattr(scoring, _name, _right)


class Patcher:
    """Stays where it is."""

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        return TrackResult(np.eye(4))
