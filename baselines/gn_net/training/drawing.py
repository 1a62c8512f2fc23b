"""Which pair is drawn when: evenly over combinations of conditions, then over traversals, then over pairs.

The n-th draw is a function of n and the seed alone. Draws go round the combinations, each round in an order of its own,
so that combinations are drawn equally often and neighbours in a batch show different weather; within a combination the
same holds for pairs of traversals, and within those for pairs.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from relocbench.training import TrainingData

_CONDITIONS, _TRAVERSALS, _PAIRS = range(3)


class EvenDraw:
    """Draws of indices of training pairs."""

    def __init__(self, data: TrainingData, seed: int) -> None:
        groups: dict[tuple[str, ...], dict[tuple[str, ...], list[int]]] = {}
        for index in range(len(data)):
            label = data.label(index)
            drives = (label.dataset, label.traversal_ref, label.traversal_query, label.camera)
            groups.setdefault((label.condition_ref, label.condition_query), {}).setdefault(drives, []).append(index)
        self._groups = [[by_drive[drives] for drives in sorted(by_drive)] for _, by_drive in sorted(groups.items())]
        self._seed = seed

    @property
    def combinations(self) -> int:
        """Number of combinations of a reference's and a query's condition."""
        return len(self._groups)

    def __getitem__(self, draw: int) -> int:
        """Index of the pair of the ``draw``-th draw, counted from 0."""
        turn, group = self._go_round(draw, len(self._groups), (_CONDITIONS,))
        drives = self._groups[group]
        turn, drive = self._go_round(turn, len(drives), (_TRAVERSALS, group))
        _, pair = self._go_round(turn, len(drives[drive]), (_PAIRS, group, drive))
        return drives[drive][pair]

    def _go_round(self, turn: int, count: int, of: tuple[int, ...]) -> tuple[int, int]:
        """Which round it is, and who is next in it."""
        rounds, place = divmod(turn, count)
        return rounds, int(_order(self._seed, of, rounds, count)[place])


@lru_cache(maxsize=1024)
def _order(seed: int, of: tuple[int, ...], rounds: int, count: int) -> NDArray[np.int64]:
    return np.random.default_rng([seed, *of, rounds]).permutation(count)
