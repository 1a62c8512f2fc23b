"""Which pairs and queries the pages show with pictures, and of which they hold more than the errors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

MOST_ROWS = 100_000
"""answers of all methods up to which the pages hold the details of all pairs or queries, not only of chosen ones"""
_SEED = 0


def worst_and_drawn(how_bad: Iterable[ArrayLike], rows: int, count: int) -> list[int]:
    """The rows that are shown with pictures, in ascending order.

    They are the ``count`` worst by each of ``how_bad`` (N,), which says of each row how bad a method's answer is, and
    ``count`` drawn at random, the same for the same number of rows.
    """
    chosen = set(np.random.default_rng(_SEED).choice(rows, min(count, rows), replace=False).tolist())
    for values in how_bad:
        chosen.update(np.argsort(-np.asarray(values), kind="stable")[:count].tolist())
    return sorted(chosen)


def kept_rows(chosen: Sequence[int], rows: int, answers: int) -> list[int]:
    """The rows whose details a page holds: all, or only the chosen ones where there are too many answers."""
    return list(chosen) if answers > MOST_ROWS else list(range(rows))
